# SPDX-License-Identifier: BSD-3-Clause
"""The reports in a real browser: they draw, answer to the pointer and ask nothing of anybody."""

import time

import cv2
import numpy as np
import pytest
from browsers import errors, open_browser, requests_elsewhere, show, wait_for

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.report.pair_page import write_pair_report
from epi360.report.webgl import find_webgl_library

PANORAMA = Equirectangular(width=1024, height=512)
FISHEYE = KannalaBrandt(
    width=600, height=600, fx=170, fy=170, cx=300, cy=300, k1=0.01, k2=0.0, k3=0.0, k4=0.0
)
HOSTILE = "</script><img src=https://example.org/x onerror=window.broken=1>.jpg"
YELLOW = """
const canvas = document.querySelectorAll('.overlay')[arguments[0]];
const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
const places = [];
for (let i = 0; i < data.length; i += 4)
  if (data[i] === 255 && data[i + 1] === 210 && data[i + 2] === 31 && data[i + 3] === 255)
    places.push([((i / 4) % canvas.width) / canvas.width,
                 Math.floor(i / 4 / canvas.width) / canvas.height]);
return places;
"""
POINT = """
const canvas = document.querySelectorAll('.overlay')[arguments[0]];
const box = canvas.getBoundingClientRect();
canvas.dispatchEvent(new PointerEvent('pointermove', {
  clientX: box.left + arguments[1] * box.width, clientY: box.top + arguments[2] * box.height}));
"""
# Points again where a pointer that the browser moved itself has taken the curve away.
YELLOW_OF_POINT = f"""
const found = (function () {{ {YELLOW} }})(1);
if (!found.length) (function () {{ {POINT} }})(0, arguments[0], arguments[1]);
return found;
"""
needs_webgl = pytest.mark.skipif(
    find_webgl_library() is None, reason="the extra [report] is not installed"
)
IMAGE_OF_GLOBE = "return document.querySelectorAll('.globe')[0].toDataURL()"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


def rendered(camera):
    """A picture with edges everywhere."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    squares = (((rows // 32 + columns // 32) % 2) * 160 + 40).astype(np.uint8)
    return cv2.merge([squares, squares, squares])


def write_report(path, result, cameras=(PANORAMA, PANORAMA), names=("a.jpg", "b.jpg")):
    images = (rendered(cameras[0]), rendered(cameras[1]))
    write_pair_report(path, names, images, cameras, result)
    return path


@pytest.mark.parametrize("cameras", [(PANORAMA, PANORAMA), (FISHEYE, PANORAMA)])
def test_the_curve_of_a_pixel_in_view_1_passes_the_epipole_and_the_match_in_view_2(
    browser, make_result, tmp_path, cameras
):
    result = make_result("ok", *cameras, noise_deg=0.0)
    show(browser, write_report(tmp_path / "report.html", result, cameras))
    index = int(np.flatnonzero(result.inlier_mask)[3])
    u, v = result.keypoints1[index] / (cameras[0].width, cameras[0].height)
    curve = np.array(wait_for(browser, YELLOW_OF_POINT, u, v))
    epipole = cameras[1].pixels_from_bearings(result.cam2_from_cam1.translation[None])[0]
    for pixel in (epipole, result.keypoints2[index]):
        place = pixel / (cameras[1].width, cameras[1].height)
        # A pixel of the screen is 1/650 of the width; the mark of the match is a ring of 8 px.
        assert np.linalg.norm(curve - place, axis=1).min() < 0.02
    assert "agrees with the pose" in browser.execute_script(
        "return document.querySelector('.says').textContent"
    )
    assert errors(browser) == []


def test_the_sphere_turns_when_it_is_dragged(browser, make_result, tmp_path):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    show(browser, write_report(tmp_path / "report.html", make_result("ok", PANORAMA)))
    browser.find_element(By.CSS_SELECTOR, "input[name=sphere]").click()
    wait_for(browser, "return document.querySelectorAll('.on-sphere').length == 2")
    time.sleep(0.3)
    before = browser.execute_script(IMAGE_OF_GLOBE)
    overlay = browser.find_element(By.CSS_SELECTOR, ".overlay")
    ActionChains(browser).drag_and_drop_by_offset(overlay, 120, 20).perform()
    wait_for(browser, "return window.pairView.panels[0].sphere.yaw < -0.1")
    time.sleep(0.3)
    assert browser.execute_script(IMAGE_OF_GLOBE) != before
    assert browser.execute_script("return window.pairView.panels[1].sphere.yaw") == 0.0


@needs_webgl
def test_points_and_cameras_are_drawn_in_3d(browser, make_result, tmp_path):
    show(browser, write_report(tmp_path / "report.html", make_result("ok", PANORAMA)))
    assert wait_for(browser, "return document.querySelector('.scene').dataset.drawn") == "yes"
    assert errors(browser) == []


@needs_webgl
def test_the_cost_over_s_and_k_is_a_surface_that_turns(browser, make_result, tmp_path):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.by import By

    show(browser, write_report(tmp_path / "report.html", make_result("ok", PANORAMA)))
    wait_for(browser, "return document.querySelector('.surface').dataset.drawn == 'yes'")
    canvas = browser.find_element(By.CSS_SELECTOR, ".surface canvas")
    image = "return document.querySelector('.surface canvas').toDataURL()"
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    time.sleep(0.3)
    before = browser.execute_script(image)
    ActionChains(browser).drag_and_drop_by_offset(canvas, 60, 10).perform()
    time.sleep(0.3)
    assert browser.execute_script(image) != before
    assert errors(browser) == []


def test_without_webgl_the_flat_map_of_the_cost_stays(browser, make_result, tmp_path):
    path = write_report(tmp_path / "report.html", make_result("ok", PANORAMA))
    text = path.read_text(encoding="utf-8")
    # As in a browser that has it switched off.
    off = "<script>HTMLCanvasElement.prototype.getContext = new Proxy(HTMLCanvasElement.prototype"
    off += ".getContext, {apply: (f, canvas, [kind, ...rest]) => kind.includes('webgl') ? null"
    off += " : f.call(canvas, kind, ...rest)});</script>"
    path.write_text(text.replace("<body>", f"<body>{off}"), encoding="utf-8")
    show(browser, path)
    said = "return document.querySelector('.scene')?.textContent.includes('no WebGL') ?? true"
    wait_for(browser, said)
    time.sleep(0.3)
    assert browser.execute_script("return document.querySelector('.surface .found') !== null")
    assert not browser.execute_script("return document.querySelector('.surface').dataset.drawn")


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1440])
def test_the_page_fits_the_screen_and_follows_its_colours(
    browser, make_result, tmp_path, width, dark
):
    show(
        browser,
        write_report(tmp_path / "report.html", make_result("ok", PANORAMA)),
        width=width,
        dark=dark,
    )
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    colour = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert (int(colour.removeprefix("rgb(").split(",")[0]) < 128) == dark


def test_a_page_with_hostile_names_of_any_status_asks_nobody_and_runs_without_an_error(
    browser, make_result, tmp_path, any_status
):
    result = make_result(any_status, PANORAMA)
    requests_elsewhere(browser)
    path = write_report(tmp_path / "report.html", result, names=(HOSTILE, HOSTILE))
    show(browser, path)
    wait_for(browser, "return window.pairView !== undefined")
    time.sleep(0.2)
    assert HOSTILE in browser.execute_script("return document.querySelector('.names').textContent")
    assert not browser.execute_script("return window.broken")
    assert requests_elsewhere(browser) == []
    assert errors(browser) == []


def test_a_request_that_a_page_makes_is_noticed(browser, tmp_path):
    path = tmp_path / "asks.html"
    path.write_text("<img src='http://example.invalid/x.png'>", encoding="utf-8")
    show(browser, path)
    time.sleep(0.3)
    assert requests_elsewhere(browser) == ["http://example.invalid/x.png"]
