# SPDX-License-Identifier: BSD-3-Clause
"""The demo in a real browser: files are dropped, sliders moved, and nobody else is asked."""

import base64
import os
import signal
import subprocess
import sys
import time
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest
from box_views import CAM2_FROM_CAM1, box_view
from browsers import errors, open_browser, requests_elsewhere
from browsers import wait_for as wait_for_at_most
from odd_files import TEXT, dual_fisheye, jpeg, png_bomb

from epi360.poses import Pose, rotation_error_deg, translation_error_deg

pytest.importorskip("nicegui", reason="the extra [demo] is not installed")
pytest.importorskip("uvicorn", reason="the extra [demo] is not installed")

START = """
from epi360_demo.limits import Limits
from epi360_demo.server import serve
limits = Limits(num_workers=1, max_gone_s=1.0)
serve("127.0.0.1", 0, limits, opens_browser=False, say=lambda page: print(page, flush=True))
"""
# What the browser does with files that are dragged from a folder.
DROP = """
const [files, slot] = arguments, data = new DataTransfer();
for (const [name, content] of files)
  data.items.add(new File([Uint8Array.from(atob(content), (c) => c.charCodeAt(0))], name));
const element = document.querySelector(`.slot[data-slot="${slot}"]`);
for (const kind of ['dragenter', 'dragover', 'drop'])
  element.dispatchEvent(new DragEvent(kind, {dataTransfer: data, bubbles: true, cancelable: true}));
"""
WORDS = "return document.querySelector('.slot[data-slot=\"%s\"] .words').textContent"
MOVE = """
const [name, key, code, done] = arguments, before = paper.numDrawn, start = performance.now();
const slider = document.getElementById(name), target = slider.querySelector('[tabindex]') || slider;
for (const kind of ['keydown', 'keyup'])
  target.dispatchEvent(new KeyboardEvent(kind, {key, keyCode: code, bubbles: true}));
(function wait() {
  if (paper.numDrawn > before) done(performance.now() - start); else setTimeout(wait, 5);
})();
"""


class Served(NamedTuple):
    address: str
    folder: object


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """The running demo: its address, and the folder in which it may leave things."""
    folder = tmp_path_factory.mktemp("demo")
    process = subprocess.Popen(
        [sys.executable, "-c", START], stdout=subprocess.PIPE, text=True, cwd=folder,
        env=os.environ | {"TMPDIR": str(folder)},
    )  # fmt: skip
    try:
        yield Served(process.stdout.readline().strip(), folder)
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(timeout=30)
        finally:
            process.kill()
    assert list(folder.iterdir()) == []


@pytest.fixture(scope="module")
def driver(demo, tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as driver:
        driver.set_script_timeout(20)
        yield driver


@pytest.fixture
def page(driver, demo):
    """The page, newly opened; nothing may have been asked of anybody else in the end."""
    show(driver, demo)
    yield driver
    assert requests_elsewhere(driver, served_at=demo.address) == []
    assert [message for message in errors(driver) if "422" not in message] == []


def show(driver, demo, *, width=1440, dark=False):
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
    driver.get(demo.address)
    wait_for(driver, "return typeof pictures === 'object' && pictures.token")


wait_for = partial(wait_for_at_most, seconds=30.0)


def drop(driver, *files, slot="1"):
    encoded = [(name, base64.b64encode(content).decode()) for name, content in files]
    driver.execute_script(DROP, encoded, slot)


def words_in(driver, slot, part):
    """Words in the place of a picture once they hold a part."""
    script = WORDS % slot
    return wait_for(driver, f"const words = (() => {{ {script} }})(); "
                            f"return words.includes({part!r}) && words")  # fmt: skip


def press(driver, text):
    script = (
        f"[...document.querySelectorAll('button')].find((b) => b.textContent.includes({text!r}))"
    )
    wait_for(driver, f"const button = {script}; return button && !button.disabled")
    driver.execute_script(f"{script}.click()")


def test_two_files_that_are_dropped_together_give_a_pose_a_report_and_a_record(page):
    views = [("one.jpg", jpeg(box_view(1))), ("two <b>.jpg", jpeg(box_view(2)))]
    drop(page, *views)
    words_in(page, "2", "two <b>.jpg")
    press(page, "Estimate the pose")
    headline = wait_for(
        page, "const h = document.querySelector('.verdict h2'); return h && h.textContent"
    )
    assert headline == "The pose can be used."
    record = page.execute_async_script(
        "fetch([...document.querySelectorAll('.links a')][1].href)"
        ".then((answer) => answer.json()).then(arguments[0])"
    )
    pose = Pose(np.array(record["cam2_from_cam1"]["rotation"]),
                np.array(record["cam2_from_cam1"]["translation"]))  # fmt: skip
    # A pixel is 0.5 degrees; the measured errors are 0.005 and 0.007 degrees.
    assert rotation_error_deg(pose, CAM2_FROM_CAM1) < 0.1
    assert translation_error_deg(pose, CAM2_FROM_CAM1) < 0.1
    report = "document.querySelector('iframe.report')"
    wait_for(page, f"return {report}.contentWindow.pairView !== undefined")
    # All of the report is there, without a scroll bar of its own.
    wait_for(page, f"return {report}.clientHeight > 1500 && {report}.clientHeight + 1 >= "
                   f"{report}.contentDocument.documentElement.scrollHeight")  # fmt: skip
    # The answer is to these pictures: it goes with the first of them.
    drop(page, ("three.jpg", jpeg(box_view(2))), slot="1")
    wait_for(page, f"return !document.querySelector('.verdict') && {report}.clientHeight === 0")


def test_a_text_file_and_a_bomb_are_answered_by_a_sentence_in_their_place(page):
    drop(page, ("notes.txt", TEXT), ("bomb.png", png_bomb()))
    assert words_in(page, "1", "notes.txt is") == (
        "notes.txt is not a JPEG, PNG, TIFF, WebP or BMP image."
    )
    assert "20000x10000 pixels, which are 200 megapixels" in words_in(page, "2", "20000")
    assert page.execute_script("return document.querySelectorAll('.slot.wrong').length") == 2


def test_a_picture_that_is_refused_takes_the_place_of_the_one_before(page):
    drop(page, ("a.jpg", jpeg(box_view(1))), ("b.jpg", jpeg(box_view(2))))
    words_in(page, "2", "b.jpg")
    button = "[...document.querySelectorAll('button')].find((b) => /Estimate/.test(b.textContent))"
    wait_for(page, f"return !{button}.disabled")
    page.execute_script("pictures.largest = 10")  # refused before it is sent
    drop(page, ("large.jpg", TEXT), slot="1")
    assert "large.jpg is larger than" in words_in(page, "1", "large.jpg")
    wait_for(page, f"return {button}.disabled")


def test_a_raw_dual_fisheye_frame_is_answered_by_a_sentence(page):
    raw = jpeg(dual_fisheye())
    drop(page, ("raw.jpg", raw), slot="1")
    drop(page, ("raw2.jpg", raw), slot="2")
    words_in(page, "2", "raw2.jpg")
    press(page, "Estimate the pose")
    status = wait_for(
        page, "const s = document.querySelector('.status.problem'); return s && s.textContent"
    )
    assert status.startswith("raw.jpg looks like a raw dual fisheye frame (two circles on black)")


def test_the_files_of_a_page_go_when_it_is_closed(page, demo):
    drop(page, ("a.jpg", jpeg(dual_fisheye())))
    words_in(page, "1", "a.jpg")
    assert list(demo.folder.rglob("1-*.jpg"))
    page.get("about:blank")
    until = time.monotonic() + 30.0
    while list(demo.folder.rglob("1-*.jpg")):
        assert time.monotonic() < until, "the file is still there"
        time.sleep(0.1)


def test_what_the_sliders_change_is_drawn_again(page):
    page.execute_script("document.querySelectorAll('.q-tab')[1].click()")
    wait_for(page, "return document.querySelector('.paper')?.dataset.drawn")
    rows = "return [...document.querySelectorAll('.errors .method b')].map((b) => b.textContent)"
    picture = "return document.querySelector('.surface').toDataURL()"
    before, surface = page.execute_script(rows), page.execute_script(picture)
    assert len(before) == 32 and "" not in before
    # The aim is 0.3 s on a machine that does nothing else; this one may be busy.
    times_ms = [page.execute_async_script(MOVE, "noise_deg", "ArrowRight", 39) for _ in range(3)]
    assert np.median(times_ms) < 5000
    assert page.execute_script(rows) != before
    assert page.execute_script(picture) != surface
    ovoid = "return document.querySelectorAll('.paper .ball')[1].toDataURL()"
    before = page.execute_script(ovoid)
    page.execute_async_script(MOVE, "K", "ArrowRight", 39)
    assert page.execute_script(ovoid) != before
    wait_for(page, "return document.querySelectorAll('.bar s:not(.old)').length === 32")


@pytest.mark.parametrize(("width", "dark"), [(390, True), (1440, False)])
def test_both_tabs_fit_the_screen_and_follow_its_colours(page, demo, width, dark):
    show(page, demo, width=width, dark=dark)
    for tab in (0, 1):
        page.execute_script(f"document.querySelectorAll('.q-tab')[{tab}].click()")
        wait_for(page, "return document.querySelectorAll('.q-tab-panel').length > 0")
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
    colour = page.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert (int(colour.removeprefix("rgb(").split(",")[0]) < 128) == dark
