# SPDX-License-Identifier: BSD-3-Clause
"""The report of a folder in a real browser: sorted, filtered, and every pair one click away."""

import base64
import dataclasses
import json
import re
import time

import cv2
import numpy as np
import pytest
from browsers import errors, open_browser, requests_elsewhere, show
from made_up_results import essential, fake_result

from epi360 import estimate_relative_pose
from epi360.cameras import Equirectangular
from epi360.interop import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.jobs.folder.image_set import ImageSet, SourceImage
from epi360.jobs.matching.match_folder import MatchRun, PairVerdict
from epi360.jobs.matching.verify_pairs import GIVEN, VerifiedGraph
from epi360.poses import Pose
from epi360.report import folder_page
from epi360.report.folder_page import (
    NO_PICTURES,
    MapShown,
    match_page,
    summary_sentences,
    write_match_report,
    write_verified_report,
)
from epi360.report.match_table import describe_match
from epi360.report.model_scene import model_scene
from epi360.report.webgl import find_webgl_library
from epi360.synthetic import two_view_scene

CAMERA = Equirectangular(width=512, height=256)
HOSTILE = "<img src=x onerror=window.broken=1>&.png"
ROWS = "return [...document.querySelectorAll('.pairs tbody tr')].map(row => row.innerText)"
INLIERS = (
    "return [...document.querySelectorAll('.pairs td.c5')].map(cell => Number(cell.innerText))"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with open_browser(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.fixture
def make_run(tmp_path, monkeypatch):
    """Factory of a folder with so many images, each paired with those that follow."""

    def make(num_images, num_ahead, name="view {}.png", camera=CAMERA, picture=None):
        names = [name.format(i) for i in range(num_images)]
        sources = tuple(
            SourceImage(each, tmp_path / f"{i}.png", "c") for i, each in enumerate(names)
        )
        for source in sources:
            cv2.imwrite(str(source.path), noise(camera) if picture is None else picture)
        result = fake_result("ok", camera, count=90)
        verdicts = [
            verdict(names[i], names[j], (i + j) % 4, 30 + (7 * i + j) % 60)
            for i in range(num_images)
            for j in range(i + 1, min(i + 1 + num_ahead, num_images))
        ]
        images = {each: MatchedImage(each, "c", keypoints(result)) for each in names}
        pairs = tuple(matched_pair(each, result) for each in verdicts)
        graph = MatchGraph({"c": camera}, images, pairs)
        monkeypatch.setattr(folder_page, "load_matches", lambda folder: graph)
        run = MatchRun(
            folder=tmp_path,
            how="made up",
            images=tuple(names),
            verdicts=tuple(verdicts),
            unreadable={},
            num_found=0,
            cameras={"c": camera},
        )
        return run, ImageSet(tmp_path, {"c": camera}, sources)

    return make


def noise(camera):
    rng = np.random.default_rng(0)
    return rng.integers(0, 255, (camera.height, camera.width, 3), dtype=np.uint8)


def keypoints(result):
    return np.concatenate([result.keypoints1, result.keypoints2])


STATUSES = {0: "too_few_inliers", 1: "refused"}


def verdict(image1, image2, kind, num_inliers):
    """One in four without a pose, one in four contradicted."""
    return PairVerdict(
        image1=image1, image2=image2, status=STATUSES.get(kind, "ok"),
        num_matches=90, num_inliers=num_inliers, noise_deg=0.1, parallax_deg=5.0,
        contradicted=kind == 1, cam2_from_cam1=fake_result("ok", CAMERA).cam2_from_cam1,
    )  # fmt: skip


def matched_pair(each, result):
    count = result.num_matches
    matches = np.column_stack([np.arange(count), np.arange(count, 2 * count)])
    inliers = matches[result.inlier_mask]
    geometry = TwoViewGeometry(each.status, result.cam2_from_cam1, inliers)
    return MatchedPair(each.image1, each.image2, matches, geometry)


def data_of(page):
    text = page.encode().decode()
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])


def opened(browser, tmp_path, made):
    path = tmp_path / "report.html"
    write_match_report(path, *made)
    show(browser, path)
    return path


def test_matches_of_a_pair_keep_their_places(make_run):
    data = data_of(match_page(*make_run(3, 2)))
    pair = data["pairs"][1]
    places = np.frombuffer(base64.b64decode(pair["pixels"][0]), "<u2").reshape(-1, 2) / 65535
    result = fake_result("ok", CAMERA, count=90)
    expected = result.keypoints1[result.inlier_mask] / (CAMERA.width, CAMERA.height)
    np.testing.assert_allclose(places[: pair["agreeing"]], expected, atol=1e-5)
    E = essential(result.cam2_from_cam1.rotation, result.cam2_from_cam1.translation)
    np.testing.assert_allclose(np.reshape(pair["E"], (3, 3)), E, atol=1e-6)


def test_the_summary_says_whether_the_accepted_pairs_join_all_images(make_run):
    run, _ = make_run(4, 3)
    chain = tuple(verdict(f"view {i}.png", f"view {i + 1}.png", 2, 50) for i in range(3))
    whole, broken = (dataclasses.replace(run, verdicts=each) for each in (chain, chain[:2]))
    assert summary_sentences(whole)[1] == "The accepted pairs join all images."
    assert summary_sentences(broken)[1] == (
        "The accepted pairs join one group of 3 images and leave 1 image alone."
    )


def test_the_summary_counts_why_pairs_are_not_used(make_run):
    sentences = summary_sentences(make_run(4, 3)[0])
    assert sentences[0].startswith("4 images gave 6 pairs (made up), and 3 pairs are accepted")
    assert "Of the others, 2 did not fit other pairs." in sentences
    assert "Of the others, 1 had too few matches that agree with one pose." in sentences


def test_the_summary_counts_accepted_pairs_whose_cameras_may_be_wrong(make_run):
    run, _ = make_run(4, 3)
    scene = two_view_scene(3, noise_deg=0.4, noise_in_both_views=True)
    told = estimate_relative_pose(scene.bearings1, scene.bearings2, max_noise_deg=0.2)
    assert len(told.warnings) == 1
    # The first pair is refused, so what its noise says does not count.
    noisy = [dataclasses.replace(each, warnings=told.warnings) for each in run.verdicts]
    assert [each.accepted for each in noisy].count(True) == 3 and not noisy[0].accepted
    for verdicts, line in (
        ((*noisy[:3], *run.verdicts[3:]), "2 of 3 accepted pairs have more noise"),
        (noisy, "3 of 3 accepted pairs have more noise"),
        (noisy[1:2], "1 of 1 accepted pair has more noise"),
    ):
        changed = dataclasses.replace(run, verdicts=tuple(verdicts))
        line += (
            " than SIFT's key points have (their warnings say how much). Learned ones may be as "
            "coarse; if yours are not, do the cameras belong to these images, in this order?"
        )
        assert line in describe_match(changed) and line in summary_sentences(changed)
    quiet = dataclasses.replace(run, verdicts=(noisy[0], *run.verdicts[1:]))
    assert "do the cameras belong" not in describe_match(quiet)


def test_a_refused_pair_is_not_said_to_have_no_pose(make_run):
    run, _ = make_run(4, 3)
    taken = next(each for each in run.verdicts if each.accepted)
    refused = dataclasses.replace(taken, refused="shows another place, 3 of 20 parts")
    verdicts = tuple(refused if each is taken else each for each in run.verdicts)
    run = dataclasses.replace(run, verdicts=verdicts)
    assert "Of the others, 1 was refused: shows another place." in summary_sentences(run)


def test_a_page_of_a_video_is_called_like_the_video(make_run):
    assert match_page(*make_run(3, 2)).title.startswith("Pairs of ")
    assert match_page(*make_run(3, 2), name="walk.mp4").title == "Pairs of walk.mp4"


def test_the_text_says_what_a_verdict_means_and_into_which_groups_a_folder_falls(make_run):
    run, _ = make_run(4, 3)
    text = describe_match(run)
    assert "1 had too few matches that agree with one pose (too_few_inliers)" in text
    assert "Groups" not in text
    ends = (("view 0.png", "view 1.png"), ("view 2.png", "view 3.png"))
    parts = tuple(verdict(*names, 2, 50) for names in ends)
    text = describe_match(dataclasses.replace(run, verdicts=parts))
    assert "Groups        The accepted pairs join 2 groups of 2 and 2 images." in text


def test_the_table_sorts_by_a_column_and_turns_round(browser, make_run, tmp_path):
    opened(browser, tmp_path, make_run(12, 5))
    button = "document.querySelectorAll('.pairs th button')[5].click();"
    browser.execute_script(button)
    rising = browser.execute_script(INLIERS)
    assert rising == sorted(rising) and rising[0] < rising[-1]
    browser.execute_script(button)
    assert browser.execute_script(INLIERS) == rising[::-1]


def test_the_table_filters_by_verdict_and_name(browser, make_run, tmp_path):
    run, images = make_run(12, 5)
    opened(browser, tmp_path, (run, images))
    for kind, expected in (
        ("accepted", sum(each.accepted for each in run.verdicts)),
        ("refused", sum(each.contradicted for each in run.verdicts)),
        ("no pose", sum(each.status not in ("ok", "refused") for each in run.verdicts)),
    ):
        browser.execute_script(
            "const s = document.querySelector('select'); s.value = arguments[0];"
            "s.dispatchEvent(new Event('input'))",
            kind,
        )
        rows = browser.execute_script(ROWS)
        assert len(rows) == expected
        assert all(kind in row for row in rows)
    browser.execute_script("document.querySelector('select').value = ''; folder.filter('view 7')")
    rows = browser.execute_script(ROWS)
    assert rows and all("view 7" in row for row in rows)


def test_a_click_on_an_image_shows_its_pairs_and_not_those_of_longer_names(
    browser, make_run, tmp_path
):
    opened(browser, tmp_path, make_run(12, 2, name="{}.png"))
    browser.execute_script("document.querySelectorAll('.thumbnails button')[1].click()")
    names = [set(row.split()) for row in browser.execute_script(ROWS)]
    assert len(names) == 3  # with 0.png, 2.png and 3.png
    assert all("1.png" in row for row in names)


def test_a_pair_is_one_click_away_with_both_pictures_and_its_curve(browser, make_run, tmp_path):
    from selenium.webdriver.common.by import By

    run, images = make_run(4, 3)
    opened(browser, tmp_path, (run, images))
    browser.find_elements(By.CSS_SELECTOR, ".pairs .open")[1].click()
    assert browser.execute_script("return document.querySelector('dialog').open")
    title = browser.find_element(By.CSS_SELECTOR, ".pair-title").text
    assert title == "view 0.png and view 2.png"
    browser.execute_script("folder.view.point(0, [0, 0, 1], -1)")
    assert browser.execute_script("return folder.view.panels[1].curve !== null")
    browser.find_element(By.CSS_SELECTOR, "button[name=later]").click()
    title = browser.find_element(By.CSS_SELECTOR, ".pair-title").text
    assert title == "view 0.png and view 3.png"
    browser.find_element(By.CSS_SELECTOR, "button[name=close]").click()
    assert not browser.execute_script("return document.querySelector('dialog').open")
    assert errors(browser) == []


@pytest.mark.parametrize("has_pictures", [False, True])
def test_given_matches_have_a_page_with_their_pictures_or_without(
    browser, make_run, tmp_path, has_pictures
):
    run, images = make_run(4, 3, name="{}.png")
    verified = VerifiedGraph(
        images=run.images,
        verdicts=run.verdicts[:-1],
        how=GIVEN,
        kept=(run.images[-2:],),
        graph=folder_page.load_matches(None),
        num_comparable=6,
        looked_around=False,
    )
    pictures = images.folder if has_pictures else None
    path = tmp_path / "report.html"
    write_verified_report(path, verified, pictures, name="m.h5")
    show(browser, path)
    text = path.read_text(encoding="utf-8")
    assert "<h1>Pairs of m.h5</h1>" in text
    assert "4 images gave 5 pairs (matched beforehand)" in text
    assert "1 more pair has the pose that was there before, and no verdict." in text
    assert (NO_PICTURES in text) != has_pictures
    browser.execute_script("folder.open(0)")
    assert browser.execute_script("return document.querySelector('.words').innerText") != ""
    drawn = "return document.querySelector('dialog .picture') !== null"
    assert browser.execute_script(drawn) == has_pictures
    assert "could not be read" not in browser.execute_script("return document.body.innerText")
    assert errors(browser) == []


def test_a_line_of_the_graph_opens_its_pair(browser, make_run, tmp_path):
    opened(browser, tmp_path, make_run(4, 3))
    browser.execute_script(
        "document.querySelector('.graph line').dispatchEvent(new MouseEvent('click'))"
    )
    assert browser.execute_script("return document.querySelector('dialog').open")


@pytest.mark.parametrize("width", [390, 1440])
def test_hostile_names_stay_text_and_nobody_is_asked(browser, make_run, tmp_path, width):
    requests_elsewhere(browser)
    path = tmp_path / "report.html"
    write_match_report(path, *make_run(3, 2, name="{} " + HOSTILE))
    show(browser, path, width=width)
    browser.execute_script("folder.open(0)")
    time.sleep(0.3)
    assert HOSTILE in browser.execute_script(ROWS)[0]
    assert not browser.execute_script("return window.broken")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert requests_elsewhere(browser) == []
    assert errors(browser) == []


@pytest.mark.skipif(find_webgl_library() is None, reason="the extra [report] is not installed")
def test_the_cameras_and_points_of_a_map_are_drawn_in_3d(browser, make_run, tmp_path):
    path = tmp_path / "report.html"
    write_match_report(path, *make_run(3, 2), MapShown([line_of_cameras()], {}))
    show(browser, path)
    assert "The map holds 3 of 3 images and 50 points." in path.read_text(encoding="utf-8")
    until = time.monotonic() + 10.0
    script = "return document.querySelector('.scene').dataset.drawn"
    while browser.execute_script(script) != "yes":
        assert time.monotonic() < until, "the map was not drawn"
        time.sleep(0.05)
    assert errors(browser) == []


def test_the_axes_of_a_camera_in_the_map_stand_at_its_centre():
    (first, _, last) = model_scene(line_of_cameras())["cameras"]
    np.testing.assert_allclose(first["centre"], [0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(last["centre"], [2.0, 0.0, 0.0], atol=1e-12)


def test_a_map_that_was_not_made_is_said(make_run):
    text = match_page(*make_run(3, 2), MapShown([], {})).encode().decode()
    assert "COLMAP could not make a map of these pairs." in text


def line_of_cameras():
    """Three cameras in a row along x, each turned, and points around them."""
    rotation = fake_result("ok", CAMERA).cam2_from_cam1.rotation
    poses = [Pose(rotation, -rotation @ np.array([float(i), 0.0, 0.0])) for i in range(3)]
    images = tuple(PosedImage(f"{i}.png", "c", pose) for i, pose in enumerate(poses))
    points = np.random.default_rng(0).normal(size=(50, 3)) * 5.0
    return Reconstruction({"c": CAMERA}, images, points, np.zeros((50, 3), np.uint8))


@pytest.mark.slow
def test_100_images_and_1000_pairs_stay_below_30_megabytes_and_open_in_3_seconds(
    browser, make_run, tmp_path
):
    camera = Equirectangular(width=1600, height=800)
    picture = cv2.GaussianBlur(noise(camera), (0, 0), 1.0)  # worse to compress than any photograph
    run, images = make_run(100, 10, camera=camera, picture=picture)
    assert len(run.verdicts) > 900
    path = opened(browser, tmp_path, (run, images))
    assert path.stat().st_size < 30_000_000
    # Other programs share the machine: the best of three says what the page itself needs.
    assert min(seconds_to_open(browser, path) for _ in range(3)) < 3.0


def seconds_to_open(browser, path):
    begun = time.monotonic()
    show(browser, path)
    count = "return document.querySelectorAll('.pairs tbody tr').length"
    while browser.execute_script(count) != 100 and time.monotonic() < begun + 60.0:
        time.sleep(0.02)
    assert browser.execute_script(count) == 100
    return time.monotonic() - begun
