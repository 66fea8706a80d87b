# SPDX-License-Identifier: BSD-3-Clause
"""The report of images in a map: what it says, and in a real browser what it shows and answers."""

import dataclasses
import json
import re

import cv2
import numpy as np
import pytest
from browsers import errors, open_browser, requests_elsewhere, show

from epi360.cameras import Equirectangular
from epi360.estimation.absolute_result import AbsolutePoseResult, no_pose
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.jobs.localization import LocalizationResult
from epi360.poses import Pose, rotation_from_vector
from epi360.report.localize_page import localize_page, write_localize_report
from epi360.report.localize_plan import plan_of

CAMERA = Equirectangular(64, 32)
HOSTILE = "</script><img src=x onerror=window.broken=1>&.jpg"
NAMES = ("a.jpg", HOSTILE, "lost.jpg")
CELLS = "return [...document.querySelectorAll('.localized tbody td.c{}')].map(c => c.innerText)"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


def pose_at(center, heading_deg=0.0):
    rotation = rotation_from_vector([0.0, np.radians(heading_deg), 0.0]).T
    return Pose(rotation, -rotation @ np.array(center))


def result_of(status, pose=None, warnings=()):
    found = no_pose(40, status)
    if pose is not None:
        found = dataclasses.replace(
            found, cam_from_world=pose, inlier_mask=np.arange(40) < 30,
            covariance=np.eye(6) * 1e-4, probability=0.97, warnings=warnings,
        )  # fmt: skip
    values = {each.name: getattr(found, each.name) for each in dataclasses.fields(found)}
    assert isinstance(found, AbsolutePoseResult)
    return LocalizationResult(
        **values, camera=CAMERA, keypoints=np.zeros((40, 2)), points=np.zeros((40, 3)),
        point_ids=np.zeros(40, np.int64), num_matches=55, map_images=("map1.jpg",), same_share=0.5,
    )  # fmt: skip


def model(turn=None):
    """Nine cameras and a cloud, in a world that may be turned."""
    turn = np.eye(3) if turn is None else turn
    points = np.random.default_rng(0).normal(size=(500, 3)) * [4.0, 1.0, 3.0]
    images = tuple(
        PosedImage(f"{k}.jpg", "1", pose_at([k - 4.0, 0.0, 0.0]) @ Pose(turn.T, np.zeros(3)))
        for k in range(9)
    )
    colors = np.full((500, 3), 90, np.uint8)
    return Reconstruction({"1": CAMERA}, images, points @ turn.T, colors)


def results():
    found = (
        result_of("ok", pose_at([2.0, 0.0, 1.0], 90.0)),
        result_of("ambiguous", pose_at([-2.0, 0.0, 1.0]), ("may be a copy",)),
        result_of("too_few_inliers"),
    )
    return dict(zip(NAMES, found, strict=True))


@pytest.fixture
def written(tmp_path):
    files = {}
    for number, name in enumerate(NAMES):
        files[name] = tmp_path / f"{number}.png"
        cv2.imwrite(str(files[name]), np.full((32, 64, 3), 80 * number, np.uint8))
    files["lost.jpg"].unlink()
    path = tmp_path / "report.html"
    write_localize_report(path, "home", model(), results(), files, {"b<b>.jpg": "is <damaged>"})
    return path


def marks(svg):
    """Place and heading of each new image in a plan, by its number."""
    pattern = r'data-image="(\d+)" transform="translate\(([-\d.]+) ([-\d.]+)\) rotate\(([-\d]+)\)"'
    return {int(n): (float(x), float(y), int(turn)) for n, x, y, turn in re.findall(pattern, svg)}


def test_images_lie_in_the_plan_as_seen_from_above():
    found = marks(plan_of(model(), results()))
    assert set(found) == {0, 1}  # the third has no pose
    (x0, y0, heading0), (x1, y1, heading1) = found[0], found[1]
    assert x0 > x1 + 50 and abs(y0 - y1) < 0.2
    assert (heading0, heading1) == (90, 0)  # to the right, and up the page


def test_a_world_that_lies_on_its_side_is_drawn_upright():
    turn = rotation_from_vector([np.pi / 2, 0.0, 0.0])
    turned = {
        name: dataclasses.replace(
            each, cam_from_world=each.cam_from_world @ Pose(turn.T, np.zeros(3))
        )
        for name, each in results().items()
    }
    upright, found = marks(plan_of(model(), results())), marks(plan_of(model(turn), turned))
    np.testing.assert_allclose(
        [found[k] for k in sorted(found)], [upright[k] for k in sorted(upright)], atol=1.1
    )


def test_the_page_says_what_became_of_the_images(written):
    text = written.read_text(encoding="utf-8")
    assert "1 of 3 images have a pose that can be used, in a map of 9 images and 500 points" in text
    assert "<b>ambiguous</b>, 1 image: a pose was found" in text
    assert "b&lt;b&gt;.jpg: is &lt;damaged&gt;" in text
    assert "<img src=x" not in text
    data = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])
    assert data["rows"][0][:4] == ["a.jpg", "ok", 30, 55]
    assert data["rows"][2][4:] == [0.0, None, None, 0.5, None, None, None, None]
    assert data["pictures"][0].startswith("data:image/jpeg") and data["pictures"][2] == ""


def test_a_map_of_one_place_and_no_pose_have_a_page():
    alone = dataclasses.replace(model(), points=np.zeros((1, 3)), colors=np.zeros((1, 3), np.uint8))
    alone = dataclasses.replace(alone, images=(PosedImage("0.jpg", "1", pose_at([0.0, 0, 0])),))
    found = {"lost.jpg": result_of("too_few_matches")}
    page = localize_page("one", alone, found, {"lost.jpg": "nowhere.jpg"}, {})
    assert b"0 of 1 images have" in page.encode()


def test_a_click_on_a_mark_or_a_name_shows_the_image(browser, written):
    show(browser, written)
    assert browser.execute_script(CELLS.format(1)) == ["ambiguous", "ok", "too_few_inliers"]
    caption = "return document.querySelector('.chosen figcaption').textContent"
    assert browser.execute_script(caption) == "a.jpg: ok, 30 inliers."
    mark = "document.querySelector('.plan [data-image=\"1\"] circle').dispatchEvent("
    browser.execute_script(mark + "new MouseEvent('click', {bubbles: true}))")
    assert browser.execute_script(caption) == f"{HOSTILE}: ambiguous; may be a copy."
    selected = "return [...document.querySelectorAll('.plan .selected')].map(m => m.dataset.image)"
    assert browser.execute_script(selected) == ["1"]
    browser.execute_script("document.querySelectorAll('.localized .open')[1].click()")
    assert browser.execute_script(selected) == ["0"]
    assert browser.execute_script("return document.querySelector('.chosen img').naturalWidth") == 64
    status = "const s = document.querySelector('[name=status]'); s.value = 'ambiguous'; "
    browser.execute_script(status + "s.dispatchEvent(new Event('input'))")
    assert browser.execute_script(CELLS.format(0)) == [HOSTILE]
    assert not errors(browser) and not requests_elsewhere(browser)
    assert browser.execute_script("return window.broken") is None


def test_the_page_fits_a_phone(browser, written):
    show(browser, written, width=400)
    width = "return document.documentElement.scrollWidth"
    assert browser.execute_script(width) <= 400
