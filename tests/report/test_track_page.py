# SPDX-License-Identifier: BSD-3-Clause
"""The report of a sequence: what it says, and in a real browser what it shows and answers."""

import json
import re
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from browsers import errors, open_browser, requests_elsewhere, show

from epi360.jobs.tracking.track_files import Written
from epi360.jobs.tracking.track_job import TrackRun
from epi360.odometry.frame_result import FrameResult, MapPoints
from epi360.odometry.key_frames import KeyFrame
from epi360.poses import Pose, rotation_from_vector
from epi360.report import track_page as track_page_module
from epi360.report.track_page import track_page, write_track_report
from epi360.report.track_pictures import TrackPictures
from epi360.report.track_words import stretches_of, track_sentences
from epi360.report.webgl import find_webgl_library

HOSTILE = "</script><img src=x onerror=window.broken=1>&.png"
CELLS = "return [...document.querySelectorAll('.frames tbody td.c{}')].map(c => c.innerText)"
needs_webgl = pytest.mark.skipif(
    find_webgl_library() is None, reason="the extra [report] is not installed"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


def pose_at(index):
    """One unit to the right and a turn of a degree a frame."""
    rotation = rotation_from_vector([0.0, np.radians(index), 0.0])
    return Pose(rotation, -rotation @ np.array([float(index), 0.0, 0.0]))


def result_of(index, status="tracked", **others):
    pose = pose_at(index) if status == "tracked" else Pose.nan()
    return FrameResult(index, 0.5 * index, status, pose, num_inliers=100 + index, **others)


def sequence(count=40, name="view {}.png"):
    """Two frames that stand, key frames every fifth, four lost frames, a loop in the last one."""
    results = []
    for index in range(count):
        if index < 2:
            results.append(result_of(index, "static"))
        elif 20 <= index < 24:
            said = f"frame {index}: shows too little of the map"
            results.append(result_of(index, "lost", message=said))
        elif index == count - 1:
            said = f"frame {index}: closes a loop with frame 5"
            results.append(result_of(index, is_keyframe=True, message=said, loop_frame=5))
        else:
            results.append(result_of(index, is_keyframe=index % 5 == 0))
    names = tuple(name.format(index) for index in range(count))
    messages = tuple(result.message for result in results if result.message)
    keys = [result for result in results if result.is_keyframe]
    return TrackRun(
        None, tuple(results), names, len(keys), 50, 1, 30.0, 1.0, messages, Written()
    )  # fmt: skip


def pictures_of(run, size=(64, 128)):
    """What has watched the run: a picture of each frame, and a map of its key frames."""
    rng = np.random.default_rng(0)
    keys = [result for result in run.results if result.is_keyframe]
    empty = np.zeros(0, np.int64)
    points = MapPoints(
        rng.normal(size=(50, 3)) * 9.0, np.full((50, 3), 90, np.uint8), empty, empty, empty
    )
    key_frames = [
        KeyFrame(each.index, each.cam_from_world.rotation, each.cam_from_world.translation,
                 empty, np.zeros((0, 3)), np.zeros((0, 2)))
        for each in keys
    ]  # fmt: skip
    odometry = SimpleNamespace(key_frames=lambda: key_frames, points=lambda: points)
    pictures = TrackPictures()
    for result in run.results:
        pictures(odometry, result, rng.integers(0, 255, (*size, 3), dtype=np.uint8))
    pictures.close(odometry)
    return pictures


def data_of(page):
    text = page.encode().decode()
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])


def opened(browser, tmp_path, run, **how):
    path = tmp_path / "report.html"
    write_track_report(path, "walk", run, pictures_of(run))
    show(browser, path, **how)
    until = time.monotonic() + 10.0
    drawn = "const s = document.querySelector('.scene'); return !s || s.dataset.drawn"
    while not browser.execute_script(drawn):
        assert time.monotonic() < until, "the way was not drawn"
        time.sleep(0.05)
    return path


def test_the_words_say_where_the_trajectory_starts_what_is_lost_and_where_loops_close():
    sentences = track_sentences(sequence())
    assert sentences[0] == "The camera was followed through 34 of 40 frames, from frame 2 on."
    assert "One loop was closed: frame 39 is where frame 5 was." in sentences
    assert "Frames 0 to 1 are static." in sentences
    assert (
        "Frames 20 to 23 are lost. The log says of frame 20: shows too little of the map."
    ) in sentences
    assert any(text.startswith("The way is 37 units long") for text in sentences)


def test_the_words_tell_joined_parts_from_loops():
    run = sequence()
    results = list(run.results)
    results[30] = replace(
        results[30], loop_frame=4, message="frame 30: joins map 2 to map 1, by frame 4"
    )
    sentences = track_sentences(replace(run, results=tuple(results)))
    assert "One loop was closed: frame 39 is where frame 5 was." in sentences
    assert (
        "The sequence fell into parts that were joined again: frame 30 is where frame 4 was."
    ) in sentences


def test_a_sequence_without_a_trajectory_says_why_and_draws_no_scene():
    still = sequence()
    results = tuple(result_of(index, "static") for index in range(10))
    run = TrackRun(None, results, still.names[:10], 0, 0, 0, 9.0, 1.0, (), Written())
    assert track_sentences(run)[0] == "There is no trajectory: the camera does not move."
    page = track_page("still", run, TrackPictures())
    assert data_of(page)["scene"] is None
    assert '<div class="scene">' not in page.body


@pytest.mark.parametrize("has_pictures", [True, False])
def test_a_sequence_without_a_trajectory_shows_a_picture_if_it_has_one(
    browser, tmp_path, has_pictures
):
    names = tuple(f"view {i}.png" for i in range(4))
    results = tuple(result_of(i, "lost", message=f"frame {i}: is blank") for i in range(4))
    run = TrackRun(None, results, names, 0, 0, 0, 9.0, 1.0, (), Written())
    path = tmp_path / "report.html"
    write_track_report(path, "black", run, pictures_of(run) if has_pictures else TrackPictures())
    show(browser, path)
    script = "const f = document.querySelector('.chosen'); return [f.offsetHeight > 0, f.innerText]"
    is_shown, words = browser.execute_script(script)
    assert is_shown == has_pictures
    assert ("Frame 0 (view 0.png" in words) == has_pictures
    broken = "return [...document.images].filter(i => i.offsetHeight && !i.naturalWidth).length"
    assert browser.execute_script(broken) == 0
    assert errors(browser) == []


def test_frames_in_a_row_with_one_status_are_one_stretch():
    found = [(each.status, each.first, each.last) for each in stretches_of(sequence().results)]
    assert found == [
        ("static", 0, 1), ("tracked", 2, 19), ("lost", 20, 23), ("tracked", 24, 39),
    ]  # fmt: skip


def test_speed_and_turn_are_those_between_a_frame_and_the_one_before():
    run = sequence()
    inliers, speed, turn = (each["values"] for each in data_of(page_of(run))["curves"])
    assert speed[10] == pytest.approx(2.0)  # one unit in half a second
    assert turn[10] == pytest.approx(2.0)
    assert speed[2] is None and speed[20] is None and speed[24] is None
    assert inliers[10] == 110 and inliers[20] is None


def test_frames_without_times_have_speeds_a_frame():
    results = tuple(FrameResult(i, float(i), "tracked", pose_at(i)) for i in range(5))
    names = tuple(f"{i}.png" for i in range(5))
    run = TrackRun(None, results, names, 0, 0, 1, 9.0, 1.0, (), Written())
    assert data_of(page_of(run))["curves"][1]["title"] == "speed (units a frame)"


def page_of(run):
    return track_page("walk", run, pictures_of(run))


def test_key_frames_and_the_first_frame_of_each_lost_stretch_have_pictures():
    frames = [each["frame"] for each in data_of(page_of(sequence()))["pictures"]]
    assert frames == [5, 10, 15, 20, 25, 30, 35, 39]


def test_the_page_of_300_frames_stays_below_10_megabytes():
    run = sequence(300)
    page = track_page("walk", run, pictures_of(run, size=(640, 1280)))  # noise compresses worst
    assert len(page.encode()) < 10_000_000


@needs_webgl
def test_a_click_on_a_camera_shows_its_picture(browser, tmp_path):
    from selenium.webdriver import ActionChains

    opened(browser, tmp_path, sequence())
    caption = "return document.querySelector('.chosen figcaption').textContent"
    assert browser.execute_script(caption).startswith("Frame 5 (view 5.png")
    picked = browser.execute_script(
        "const canvas = document.querySelector('.scene canvas'); window.seen = new Set();"
        "const before = track.select.bind(track);"
        "track.select = (frame) => { seen.add(frame); before(frame); };"
        "canvas.scrollIntoView({block: 'center'});"
        "const b = canvas.getBoundingClientRect(); return [b.width, b.height]"
    )
    canvas = browser.execute_script("return document.querySelector('.scene canvas')")
    for share in np.linspace(-0.45, 0.45, 19):  # the cameras stand in a row: some are hit
        place = (round(share * picked[0]), 0)
        ActionChains(browser).move_to_element_with_offset(canvas, *place).click().perform()
    seen = browser.execute_script("return [...seen]")
    assert seen and set(seen) <= {5, 10, 15, 25, 30, 35, 39}
    assert browser.execute_script(caption).startswith(f"Frame {seen[-1]} (")
    assert errors(browser) == []


def test_without_the_library_the_way_is_drawn_from_above_and_its_cameras_answer(
    browser, tmp_path, monkeypatch
):
    monkeypatch.setattr(track_page_module, "find_webgl_library", lambda: None)
    path = opened(browser, tmp_path, sequence())
    assert "There is no 3D view in this page." in path.read_text(encoding="utf-8")
    browser.execute_script(
        "document.querySelectorAll('.scene circle')[2].dispatchEvent(new MouseEvent('click'))"
    )
    caption = browser.execute_script(
        "return document.querySelector('.chosen figcaption').textContent"
    )
    assert caption.startswith("Frame 15 (view 15.png")
    assert errors(browser) == []


def test_the_plot_says_what_is_under_the_pointer_and_a_click_chooses_the_frame(browser, tmp_path):
    opened(browser, tmp_path, sequence())
    event = (
        "const plot = document.querySelector('.timeline'), box = plot.getBoundingClientRect();"
        "const x = box.left + 56 + arguments[1] / 39 * (box.width - 68);"
        "plot.dispatchEvent(new MouseEvent(arguments[0], {clientX: x, clientY: box.top + 5}))"
    )
    browser.execute_script(event, "pointermove", 21)
    says = browser.execute_script("return document.querySelector('.says').textContent")
    assert says == "Frame 21 (view 21.png, 10.5 s): lost; shows too little of the map."
    browser.execute_script(event, "click", 31)
    assert browser.execute_script("return track.frame") == 31
    caption = "return document.querySelector('.chosen figcaption').textContent"
    assert browser.execute_script(caption).startswith("Frame 30 (")  # the nearest key frame


def test_the_table_of_frames_sorts_and_filters(browser, tmp_path):
    opened(browser, tmp_path, sequence())
    browser.execute_script(
        "document.querySelectorAll('.frames th button')[4].click();"
        "document.querySelectorAll('.frames th button')[4].click();"
    )
    numbers = [int(each) for each in browser.execute_script(CELLS.format(4)) if each != "–"]
    assert numbers == sorted(numbers, reverse=True) and len(numbers) == 34
    choose = (
        "const s = document.querySelector('select[name=status]'); s.value = arguments[0];"
        "s.dispatchEvent(new Event('input'))"
    )
    browser.execute_script(choose, "lost")
    assert set(browser.execute_script(CELLS.format(3))) == {"lost"}
    assert len(browser.execute_script(CELLS.format(0))) == 4
    browser.execute_script(choose, "")
    browser.execute_script("document.querySelector('input[name=keys]').click()")
    assert len(browser.execute_script(CELLS.format(0))) == 7


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1440])
def test_a_page_with_hostile_names_fits_the_screen_and_asks_nobody(browser, tmp_path, width, dark):
    requests_elsewhere(browser)
    opened(browser, tmp_path, sequence(name="{} " + HOSTILE), width=width, dark=dark)
    assert not browser.execute_script("return window.broken")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert requests_elsewhere(browser) == []
    assert errors(browser) == []
