# SPDX-License-Identifier: BSD-3-Clause
"""The page of the paper's experiments, and one picture of their numbers."""

import time

import cv2
import numpy as np
import pytest
from browsers import errors, open_browser, requests_elsewhere, show

from epi360.report.markdown_html import html_of_markdown
from epi360.report.overview import Overview, Panel, draw_overview, write_overview
from epi360.report.reproduction_page import (
    ExperimentShown,
    reproduction_page,
    write_reproduction_report,
)

TABLE = """Protocol `printed`, *all* <b>.

| method | Rot-e: paper | Rot-e: ours |
| --- | ---: | ---: |
| 8-PA | 1.0 | 2.0 |
| GSM | – | 3.0 |"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


def experiment(name="table1", title="Table 1: methods", **others):
    return ExperimentShown(name, title, "Look here.", "It holds.", TABLE, **others)


def picture():
    return cv2.imencode(".png", np.full((40, 90, 3), 200, np.uint8))[1].tobytes()


def test_tables_become_html_and_nothing_in_them_becomes_markup():
    text = html_of_markdown("## A <i>\n\n" + TABLE, lowered=1)
    assert "<h3>A &lt;i&gt;</h3>" in text
    assert "<code>printed</code>, <em>all</em> &lt;b&gt;." in text
    assert '<tr><td>8-PA</td><td>1.0</td><td class="ours">2.0</td></tr>' in text


def test_each_experiment_has_its_words_its_table_and_a_link_to_it():
    shown = [experiment(), experiment("fig1", "Fig. 1: points", figure=picture())]
    body = reproduction_page("All", shown).body
    assert body.index('href="#part2"') < body.index('id="part2"')
    assert body.count("Look here.") == 2 and body.count("It holds.") == 2
    assert body.count("<img") == 1
    assert body.count("<table") == 2


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1440])
def test_the_page_opens_on_any_screen_and_asks_nobody(browser, tmp_path, width, dark):
    requests_elsewhere(browser)
    path = tmp_path / "page.html"
    hostile = "</script><img src=http://example.invalid/x.png onerror=window.broken=1>"
    shown = [experiment(title=hostile, figure=picture(), is_diagram=True)]
    write_reproduction_report(path, "All", shown, picture())
    show(browser, path, width=width, dark=dark)
    time.sleep(0.2)
    loaded = "return [...document.querySelectorAll('img')].map(i => i.naturalWidth)"
    assert browser.execute_script(loaded) == [90, 90]
    assert not browser.execute_script("return window.broken")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert requests_elsewhere(browser) == []
    assert errors(browser) == []


def panel(**others):
    given = {"title": "errors", "axis": "degrees", "rows": ["a", "b"]} | others
    return Panel(series={"ours": [1.0, 20.0], "peer": [3.0, float("nan")]}, **given)


def texts_of(figure):
    """Boxes on the canvas of all texts that are drawn, by the text."""
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    labels = []
    for axes in figure.axes:
        if axes.axison:
            labels += [axes._left_title, axes.xaxis.label]
            for axis in (axes.xaxis, axes.yaxis):
                low, high = sorted(axis.get_view_interval())
                ticks = [tick for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
                labels += [tick.label1 for tick in ticks]  # matplotlib draws no others
    for legend in figure.legends:
        labels += legend.get_texts()
    labels += figure.texts
    return [
        (each.get_text(), each.get_window_extent(renderer)) for each in labels if each.get_text()
    ]


def test_no_text_of_a_picture_hides_another_or_leaves_it():
    long_row = panel(rows=["a very long name of a row that needs two lines at least", "b"])
    overview = Overview(
        "What was measured",
        [panel(), panel(powers=True), long_row, panel(title="more " * 12, powers=True)],
        "How it was measured. " * 20,
    )
    figure = draw_overview(overview)
    boxes = texts_of(figure)
    width, height = figure.canvas.get_width_height()
    for i, (text, box) in enumerate(boxes):
        assert box.x0 >= 0 and box.x1 <= width, text
        assert box.y0 >= 0 and box.y1 <= height, text
        for other, beside in boxes[i + 1 :]:
            overlap = min(box.x1, beside.x1) - max(box.x0, beside.x0)
            covered = min(box.y1, beside.y1) - max(box.y0, beside.y0)
            assert overlap <= 1.0 or covered <= 1.0, f"{text!r} over {other!r}"


def test_dots_stand_at_their_values_and_missing_ones_are_left_out():
    axes = draw_overview(Overview("x", [panel()])).axes[0]
    ours, peer = axes.lines
    np.testing.assert_array_equal(ours.get_xdata(), [1.0, 20.0])
    np.testing.assert_array_equal(peer.get_xdata(), [3.0, np.nan])
    assert not set(ours.get_ydata()) & set(peer.get_ydata())  # beside each other


def test_a_measured_zero_has_a_place_on_a_logarithmic_axis():
    zero = Panel("failures", "%", ["a"], {"ours": [0.0], "peer": [12.0]}, powers=True)
    axes = draw_overview(Overview("x", [zero])).axes[0]
    assert axes.get_xscale() == "symlog"


def test_an_overview_of_nothing_is_refused():
    with pytest.raises(ValueError, match="got none"):
        draw_overview(Overview("x", []))


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_picture_is_written_in_the_format_of_its_name(tmp_path, suffix):
    path = tmp_path / f"overview.{suffix}"
    write_overview(path, Overview("x", [panel()]))
    begin = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[suffix]
    assert path.read_bytes().startswith(begin)
