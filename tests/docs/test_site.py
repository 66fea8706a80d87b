# SPDX-License-Identifier: BSD-3-Clause
"""The built site opens from the disk: it searches, and asks for nothing elsewhere."""

import time

import pytest
from browsers import errors, open_browser, requests_elsewhere, show
from build_site import build
from check_site import mistakes
from public_names import public_names


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder of the site, built once."""
    pytest.importorskip("zensical", reason="make docs installs it: pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("built") / "site"
    build(folder)
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


SEARCH_LINKS = """
    const hosts = [...document.querySelectorAll("div")].filter(host => host.shadowRoot);
    return hosts.flatMap(host => [...host.shadowRoot.querySelectorAll("a")].map(a => a.href));
"""


def found_in(browser, words):
    """Addresses of the results of a search, as soon as there are any."""
    browser.find_element("css selector", ".md-search__button").click()
    for _ in range(100):
        time.sleep(0.1)
        if browser.execute_script(SEARCH_LINKS):
            return browser.execute_script(SEARCH_LINKS)
        field = browser.switch_to.active_element  # the field comes when the index is there
        if words and field.get_attribute("class") is not None:
            field.send_keys(words)
            words = ""
    return []


@pytest.mark.slow  # builds the site: 6 s of processor time
def test_search_works_from_the_disk_and_no_request_leaves(site, browser):
    show(browser, site / "index.html")
    assert "epi360" in browser.title
    links = found_in(browser, "parallax")
    assert links
    assert all(link.startswith(site.as_uri()) for link in links)
    assert requests_elsewhere(browser) == []
    assert errors(browser) == []


@pytest.mark.slow  # builds the site
@pytest.mark.parametrize(
    "page", ["verdicts.html", "api/epi360.estimation.html", "reproduction.html"]
)
def test_a_page_fits_a_phone_and_asks_for_nothing(site, browser, page):
    show(browser, site / page, width=390)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 390
    broken = "return [...document.images].filter(i => i.complete && !i.naturalWidth).length"
    assert browser.execute_script(broken) == 0
    assert requests_elsewhere(browser) == []


@pytest.mark.slow  # builds the site
def test_a_function_is_not_taken_for_the_module_of_its_name(site):
    page = (site / "api" / "epi360.epipolar.html").read_text(encoding="utf-8")
    assert 'id="epi360.stability"' in page
    assert 'id="epi360.stability.Stability"' not in page


@pytest.mark.slow  # builds the site
def test_a_mistake_in_a_site_is_found(site, tmp_path):
    assert list(mistakes(site)) == []
    page = tmp_path / "index.html"
    page.write_text(
        '<a href="nothing.html">a</a> <a href="#nowhere">b</a><img src="https://example.org/a.png">',
        encoding="utf-8",
    )
    found = " ".join(mistakes(tmp_path))
    assert "nothing.html, which is not there" in found
    assert "#nowhere, but there is no such place" in found
    assert "loads https://example.org/a.png from elsewhere" in found
    first = next(iter(public_names().values()))[0]
    assert f"no page explains {first.called}" in found
