# SPDX-License-Identifier: BSD-3-Clause
"""The pairs on the page of the verdicts get the verdicts that it says."""

from dataclasses import replace

import make_pictures
import pytest
from verdict_pictures import PAIRS, fixed_to_the_camera_masked

import epi360

STATUSES = {
    "pure_rotation": "pure_rotation",
    "planar_ambiguous": "planar_ambiguous",
    "concentrated_inliers": "concentrated_inliers",
    "too_few_inliers": "too_few_inliers",
    "low_probability": "too_few_inliers",
    "too_few_matches": "too_few_matches",
    "fixed_to_the_camera": "ok",
    "little_parallax": "ok",
    "part_of_the_scene": "ok",
    "wrong_calibration": "ok",
    "twin_rooms": "another_place",
    "same_floor": "another_place",
}
WARNINGS = {
    "fixed_to_the_camera": "287 of 378 matches stand still",
    "little_parallax": "the median parallax is only",
    "part_of_the_scene": "inliers cover",
    "same_floor": "inliers cover",
    "wrong_calibration": "do the cameras belong to these images",
}
WRONG = {"wrong_calibration"}


def error_deg(pose, truth):
    return max(epi360.rotation_error_deg(pose, truth), epi360.translation_error_deg(pose, truth))


@pytest.mark.slow  # two pictures are rendered for each: 2 s of processor time
@pytest.mark.parametrize("name", PAIRS)
def test_a_pair_gets_the_verdict_that_the_page_says(name):
    pair = PAIRS[name]()
    result = pair.estimate()
    assert result.status == STATUSES[name]
    assert any(WARNINGS.get(name, "") in sentence for sentence in result.warnings) == (
        name in WARNINGS
    )
    if result.success:
        is_wrong = epi360.rotation_error_deg(result.cam2_from_cam1, pair.cam2_from_cam1) > 5.0
        assert is_wrong == (name in WRONG)
    if result.alternatives and name == "planar_ambiguous":
        assert error_deg(result.cam2_from_cam1, pair.cam2_from_cam1) > 10.0
        assert error_deg(result.alternatives[0], pair.cam2_from_cam1) < 2.0
    if result.status == "another_place":
        assert error_deg(result.alternatives[0], pair.cam2_from_cam1) > 10.0
    if name == "low_probability":
        assert 0.3 < result.probability < 0.85 and result.inlier_mask.mean() > 0.7


@pytest.mark.slow  # renders
def test_a_lens_that_is_taken_for_quite_another_one_gives_the_right_pose():
    pair = PAIRS["wrong_calibration"]()
    result = replace(pair, camera=replace(pair.camera, fx=110.0, fy=110.0)).estimate()
    assert result.success and error_deg(result.cam2_from_cam1, pair.cam2_from_cam1) < 0.3
    (warning,) = result.warnings  # and the surroundings, which would look wrong, are not compared
    assert "26.5% smaller" in warning and "this is the pose that they say then" in warning


@pytest.mark.slow  # renders
def test_a_mask_over_what_is_fixed_to_the_camera_gives_the_pose():
    pair = fixed_to_the_camera_masked()
    result = pair.estimate()
    assert result.status == "ok"
    assert error_deg(result.cam2_from_cam1, pair.cam2_from_cam1) < 1.0


@pytest.mark.slow  # draws twice
def test_a_picture_is_the_same_each_time(tmp_path, monkeypatch):
    monkeypatch.setattr(make_pictures, "FOLDER", tmp_path)
    drawn = []
    for _ in range(2):
        make_pictures.make("verdicts/planar_ambiguous")
        drawn.append((tmp_path / "verdicts" / "planar_ambiguous.webp").read_bytes())
    assert drawn[0] == drawn[1]
    assert len(drawn[0]) > 10_000
