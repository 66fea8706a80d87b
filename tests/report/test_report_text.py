# SPDX-License-Identifier: BSD-3-Clause
"""What a person reads about a pair."""

import dataclasses
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from epi360.cameras import Equirectangular
from epi360.estimation import Explanations, SamePlace
from epi360.estimation.result import Status, pose_sigmas_deg
from epi360.poses import Pose
from epi360.report.text import (
    EXPLANATION_WORDS,
    STATUS_SENTENCES,
    describe_direction,
    describe_explanations,
    describe_pair,
    describe_place,
    describe_status,
    rotation_axis_angle,
)

CAMERA = Equirectangular(width=1024, height=512)
TRUTH = Pose(np.eye(3), np.array([0.0, 0.0, 2.0]))


def test_every_explanation_and_status_has_its_words():
    assert set(EXPLANATION_WORDS) == {each.name for each in dataclasses.fields(Explanations)}
    assert set(STATUS_SENTENCES) == set(get_args(Status))


@pytest.mark.parametrize("truth", [None, TRUTH])
def test_no_status_ever_reads_nan(make_result, any_status, truth):
    text = describe_pair(make_result(any_status, CAMERA), truth)
    assert "nan" not in text.lower()
    assert text.startswith(f"Status        {any_status}: ")
    assert all(len(line) <= 100 for line in text.split("\n\n")[0].splitlines())


def test_explanations_are_named_from_the_likeliest_on_where_there_is_doubt(make_result):
    doubtful = Explanations(nothing=0.29, rotation=0.0, surface=1e-5, motion=0.7, rival=0.00999)
    words = "this pose (70.0 %), the images have nothing in common (29.0 %), another pose (1.0 %)"
    assert describe_explanations(doubtful) == words
    result = replace(make_result("too_few_inliers", CAMERA), explanations=doubtful)
    assert " ".join(describe_pair(result).split()).count(words) == 1
    assert describe_explanations(Explanations(0.0, 0.0, 0.0005, 0.9995, 0.0)) == ""
    assert describe_explanations(Explanations()) == ""


def test_surroundings_are_named_where_they_were_compared(make_result):
    result = make_result("ok", CAMERA)
    assert describe_place(result) == ""
    assert "Surroundings" not in describe_pair(result)
    doubtful = replace(result, place=SamePlace(here=0.9, elsewhere=0.0005, copy=0.0995))
    words = "look as the pose says (90.0 %), as in a copy of the place (10.0 %)"
    assert describe_place(doubtful) == words
    assert f"Surroundings  {words}" in describe_pair(doubtful).splitlines()
    sure = replace(result, place=SamePlace(here=0.9999999, elsewhere=0.0, copy=0.0))
    assert describe_place(sure) == "look as the pose says (over 99.9 %)"


def test_every_status_has_a_sentence(any_status):
    assert len(describe_status(any_status)) > 25


def test_an_empty_result_is_described(make_result):
    text = describe_pair(make_result("too_few_matches", CAMERA, count=0))
    assert "0 of 0 matches, gate" in text


def test_the_lines_of_a_good_pose(make_result):
    lines = describe_pair(make_result("ok", CAMERA)).splitlines()
    # Centre of camera 2 in frame 1 is -R^T t; sigmas are sqrt(3) and sqrt(2) times 1 and 2 mrad.
    assert any(
        line.startswith("Rotation      25.2") and "1 sigma 0.099 deg" in line for line in lines
    )
    assert "Translation   (-0.8000, 0.0000, -0.6000), 1 sigma 0.162 deg" in lines
    assert "Inliers       45 of 60 matches (75%), gate 0.300 deg" in lines
    assert "Noise         0.100 deg per axis and view" in lines


def test_pure_rotation_claims_no_translation(make_result):
    lines = describe_pair(make_result("pure_rotation", CAMERA)).splitlines()
    assert "Translation   not determined" in lines
    assert "Camera 2 at   not determined" in lines
    assert any(line.startswith("Rotation      25.2") for line in lines)


def test_alternatives_and_warnings_are_told(make_result):
    text = describe_pair(make_result("planar_ambiguous", CAMERA))
    assert "Also fits     25.2" in text
    assert "Warning       the scene is nearly flat" in text


def test_a_pose_that_is_not_believed_is_not_said_to_fit(make_result):
    other = make_result("planar_ambiguous", CAMERA).alternatives
    refused = dataclasses.replace(make_result("too_few_inliers", CAMERA), alternatives=other)
    text = describe_pair(refused)
    assert "Refused       25.2" in text
    assert "Also fits" not in text


def test_truth_of_any_scale_is_beside_the_estimate_with_the_errors(make_result):
    result = make_result("ok", CAMERA)
    turn = Rotation.from_rotvec(np.radians([0.0, 0.0, 0.5])).as_matrix()
    truth = Pose(turn @ result.cam2_from_cam1.rotation, 3.0 * result.cam2_from_cam1.translation)
    header, rotation, translation = describe_pair(result, truth).splitlines()[-3:]
    assert header.split() == ["estimate", "truth", "error"]
    assert rotation.endswith("0.500 deg")
    assert translation.count("(-0.8000, 0.0000, -0.6000)") == 2
    assert translation.endswith("0.000 deg")


def test_a_truth_without_translation_is_described(make_result):
    text = describe_pair(make_result("pure_rotation", CAMERA), Pose(np.eye(3), np.zeros(3)))
    assert "nan" not in text.lower()


@pytest.mark.parametrize(
    ("direction", "words"),
    [
        ((0, 0, 2), "azimuth 0.0 deg (ahead), elevation 0.0 deg (level)"),
        ((1, 0, 1), "azimuth +45.0 deg (right), elevation 0.0 deg (level)"),
        ((-1, 0, -1), "azimuth -135.0 deg (left, behind), elevation 0.0 deg (level)"),
        ((0, 0, -1), "azimuth +180.0 deg (behind), elevation 0.0 deg (level)"),
        ((0, -1, 1), "azimuth 0.0 deg (ahead), elevation +45.0 deg (up)"),
        ((0, 1, 1), "azimuth 0.0 deg (ahead), elevation -45.0 deg (down)"),
        ((0, -1, 0), "straight up"),
        ((0, 1, 0), "straight down"),
        ((np.nan, 0, 0), "not determined"),
    ],
)
def test_directions_read_as_a_person_standing_there_would_say(direction, words):
    assert describe_direction(np.array(direction, dtype=float)) == words


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        ((0, 1, 0), "azimuth +20.0 deg (right), elevation 0.0 deg (level)"),
        ((1, 0, 0), "azimuth 0.0 deg (ahead), elevation +20.0 deg (up)"),
        (
            (0, 0, 1),
            "azimuth 0.0 deg (ahead), elevation 0.0 deg (level), rolled 20.0 deg clockwise",
        ),
    ],
)
def test_a_turned_camera_looks_where_it_was_turned(make_result, axis, words):
    cam1_from_cam2 = Rotation.from_rotvec(np.radians(20.0) * np.array(axis)).as_matrix()
    result = make_result("ok", CAMERA)
    object.__setattr__(result, "cam2_from_cam1", Pose(cam1_from_cam2.T, np.array([0.0, 0.0, 1.0])))
    assert f"  looking to  {words}" in describe_pair(result).splitlines()


@pytest.mark.parametrize("angle_deg", [0.01, 30.0, 120.0, 180.0])
def test_axis_and_angle_rebuild_the_rotation(angle_deg):
    rotation = Rotation.from_rotvec(np.radians(angle_deg) * np.array([0.6, 0.0, -0.8])).as_matrix()
    axis, angle = rotation_axis_angle(rotation)
    assert angle == pytest.approx(angle_deg, abs=1e-6)
    rebuilt = Rotation.from_rotvec(np.radians(angle) * axis).as_matrix()
    np.testing.assert_allclose(rebuilt, rotation, atol=1e-8)


def test_no_rotation_has_no_axis():
    axis, angle = rotation_axis_angle(np.eye(3))
    assert angle == 0.0
    assert np.isnan(axis).all()


def test_sigmas_are_the_expected_error_angles(make_result):
    rng = np.random.default_rng(0)
    result = make_result("ok", CAMERA)
    factor = 1e-3 * rng.normal(size=(5, 5))
    object.__setattr__(result, "covariance", factor @ factor.T)
    draws = rng.normal(size=(100_000, 5)) @ factor.T
    rms = [np.sqrt((draws[:, part] ** 2).sum(axis=1).mean()) for part in (slice(3), slice(3, 5))]
    # 100,000 draws give the root mean square to about 0.3 %.
    np.testing.assert_allclose(pose_sigmas_deg(result), np.degrees(rms), atol=2e-3)
