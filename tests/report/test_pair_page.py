# SPDX-License-Identifier: BSD-3-Clause
"""The report of a pair as a file: whole for every status, safe for every name, small."""

import dataclasses
import json
import re

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.poses import Pose
from epi360.report import pair_page as pair_page_module
from epi360.report.pair_page import pair_page, write_pair_report
from epi360.report.pair_words import evidence_of, verdict_headline, verdict_sentences
from epi360.report.webgl import find_webgl_library

PANORAMA = Equirectangular(width=256, height=128)
FISHEYE = KannalaBrandt(
    width=200, height=200, fx=57, fy=57, cx=100, cy=100, k1=0.01, k2=0.0, k3=0.0, k4=0.0
)
HOSTILE = "</script><img src=x onerror=alert(1)>\u2028<!--<script>&amp;.jpg"


def picture(camera):
    rng = np.random.default_rng(0)
    return rng.integers(0, 255, (camera.height, camera.width, 3), dtype=np.uint8)


def page_text(result, *, cameras=(PANORAMA, PANORAMA), names=("a.jpg", "b.jpg")):
    images = (picture(cameras[0]), picture(cameras[1]))
    return pair_page(names, images, cameras, result).encode().decode()


def data_of(text):
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])


def test_a_page_says_the_verdict_of_every_status(any_status, make_result):
    text = page_text(make_result(any_status, PANORAMA))
    assert f"<h1>{verdict_headline(any_status)}</h1>" in text
    assert "nan" not in re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL).lower()


def test_a_page_without_any_match_says_so(make_result):
    text = page_text(make_result("too_few_matches", PANORAMA, count=0))
    assert "No matches were found between the images." in text
    assert data_of(text)["pair"]["inliers"] == ""


def test_matches_in_the_page_are_those_of_the_result(make_result):
    result = make_result("ok", PANORAMA)
    pair = data_of(page_text(result))["pair"]
    assert pair["inliers"] == "".join("01"[int(each)] for each in result.inlier_mask)
    np.testing.assert_allclose(pair["E"], result.E.ravel())


def test_a_camera_that_is_no_panorama_brings_its_rays(make_result):
    cameras = (FISHEYE, PANORAMA)
    views = data_of(page_text(make_result("ok", *cameras), cameras=cameras))["pair"]["views"]
    assert "rays" in views[0]["camera"]
    assert "rays" not in views[1]["camera"]


def test_rays_are_those_of_the_camera_that_the_pose_belongs_to(make_result):
    cut = dataclasses.replace(PANORAMA, vertical_fov_deg=171.0, center_latitude_deg=4.5)
    result = dataclasses.replace(make_result("ok", PANORAMA), cameras=(cut, None))
    views = data_of(page_text(result))["pair"]["views"]
    around, high, _, middle = views[0]["camera"]["panorama"]
    np.testing.assert_allclose(np.degrees([around, high, middle]), [360.0, 171.0, 4.5])
    np.testing.assert_allclose(np.degrees(views[1]["camera"]["panorama"]), [360.0, 180.0, 0.0, 0.0])


def test_names_of_files_cannot_become_part_of_the_page(make_result):
    text = page_text(make_result("ok", PANORAMA), names=(HOSTILE, HOSTILE))
    assert "<img src=x" not in text
    assert text.count("</script>") == 3  # those of the page itself
    assert text.count("<!--") == 0


def test_a_name_that_is_no_text_does_not_stop_the_report(make_result, tmp_path):
    path = tmp_path / "report.html"
    images, cameras = (picture(PANORAMA),) * 2, (PANORAMA, PANORAMA)
    write_pair_report(path, ("\udcff.jpg", "b.jpg"), images, cameras, make_result("ok", PANORAMA))
    assert "?.jpg" in path.read_text(encoding="utf-8")


def test_the_page_forbids_the_browser_every_connection(make_result):
    text = page_text(make_result("ok", PANORAMA))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert "default-src &#x27;none&#x27;" in policy
    assert "http" not in policy


def test_the_page_of_large_pictures_stays_below_3_megabytes(make_result, tmp_path):
    camera = Equirectangular(width=4096, height=2048)
    path = tmp_path / "report.html"
    noise = picture(camera)  # nothing compresses worse
    result = make_result("ok", camera, count=3000)
    write_pair_report(path, ("a", "b"), (noise, noise), (camera, camera), result)
    assert path.stat().st_size < 3_000_000


def test_without_the_extra_the_page_says_how_to_get_its_3d_view(make_result, monkeypatch):
    monkeypatch.setattr(pair_page_module, "find_webgl_library", lambda: None)
    text = page_text(make_result("ok", PANORAMA))
    assert "There is no 3D view in this page." in text
    assert 'class="scene"' not in text


def test_what_is_embedded_is_named_with_its_licence(make_result):
    if find_webgl_library() is None:
        pytest.skip("the extra [report] is not installed")
    assert "three.js (MIT licence" in page_text(make_result("ok", PANORAMA))


def test_warnings_and_other_poses_speak_against_a_pose(make_result):
    result = make_result("planar_ambiguous", PANORAMA)
    against = [each.sentence for each in evidence_of(result, 0.3) if not each.speaks_for]
    assert "The scene is nearly flat." in against
    assert any("Another pose fits about as well: a turn by" in sentence for sentence in against)


def test_a_pose_that_was_refused_is_named_as_such(make_result):
    other = make_result("planar_ambiguous", PANORAMA).alternatives
    refused = dataclasses.replace(
        make_result("concentrated_inliers", PANORAMA), alternatives=other, probability=0.9995
    )
    sentences = [each.sentence for each in evidence_of(refused, 0.3)]
    assert any(text.startswith("A pose was found and refused: a turn by") for text in sentences)
    found = "The probability that the pose which was found is right is over 99.9 %."
    assert found in sentences


def test_a_refused_turn_has_no_place_of_camera_2(make_result):
    turn = Pose(make_result("ok", PANORAMA).cam2_from_cam1.rotation, np.full(3, np.nan))
    refused = dataclasses.replace(
        make_result("concentrated_inliers", PANORAMA), alternatives=(turn,)
    )
    sentences = [each.sentence for each in evidence_of(refused, 0.3)]
    assert "A pose was found and refused: a turn by 25.26°." in sentences


def test_few_inliers_speak_against_a_pose_and_many_for_it(make_result):
    result = make_result("ok", PANORAMA)
    few = dataclasses.replace(result, inlier_mask=np.arange(result.num_matches) < 5)
    assert evidence_of(result, 0.3)[0].speaks_for
    assert not evidence_of(few, 0.3)[0].speaks_for


def test_a_pure_rotation_is_said_without_a_place_of_camera_2(make_result):
    words = " ".join(verdict_sentences(make_result("pure_rotation", PANORAMA)))
    assert "the camera turned by" in words
    assert "camera 2 is at" not in words
