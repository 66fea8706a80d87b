# SPDX-License-Identifier: BSD-3-Clause
"""What is fixed to the camera is left out, and a camera that stands still is not misjudged."""

import numpy as np
import pytest

import epi360
from epi360._core import internals
from epi360.poses import Pose, rotation_from_vector

NOISE_RAD = np.radians(0.05)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def seen(bearings, rng):
    """Bearings with noise."""
    return unit(bearings + rng.normal(0.0, NOISE_RAD, bearings.shape))


def anywhere(num, rng):
    return unit(rng.normal(size=(num, 3)))


def around_down(num, rng, radius_deg=40.0):
    """Directions within a cap around straight down: what carries the camera."""
    down = rng.uniform(np.cos(np.radians(radius_deg)), 1.0, num)
    turn = rng.uniform(0.0, 2.0 * np.pi, num)
    across = np.sqrt(1.0 - down**2)
    return np.column_stack([across * np.cos(turn), down, across * np.sin(turn)])


def pose_of_camera(rng, *, moved=True):
    turn = rotation_from_vector(np.radians([rng.normal(), rng.uniform(30.0, 330.0), rng.normal()]))
    where = rng.uniform([-0.7, -0.1, -0.7], [0.7, 0.1, 0.7]) if moved else np.zeros(3)
    return Pose(turn, -turn @ where)


def with_fixed_content(seed, *, num_fixed, moved=True, num_wrong=0, radius_deg=40.0):
    """Matches of a room, 100 of them, and after these what is fixed to the camera; the truth."""
    rng = np.random.default_rng(seed)
    pose = pose_of_camera(rng, moved=moved)
    room = rng.uniform([-4.0, -1.5, -4.0], [4.0, 1.5, 4.0], (100, 3))
    second = unit(room @ pose.rotation.T + pose.translation)
    second[:num_wrong] = anywhere(num_wrong, rng)
    fixed = around_down(num_fixed, rng, radius_deg)
    b1, b2 = np.concatenate([unit(room), fixed]), np.concatenate([second, fixed])
    return seen(b1, rng), seen(b2, rng), pose


def says_fixed(result):
    return any("something is fixed to the camera" in warning for warning in result.warnings)


def errors_deg(result, pose):
    return (
        epi360.rotation_error_deg(result.cam2_from_cam1, pose),
        epi360.translation_error_deg(result.cam2_from_cam1, pose),
    )


@pytest.mark.parametrize("num_fixed", [80, 150, 400])
@pytest.mark.parametrize("num_wrong", [0, 30])
@pytest.mark.parametrize("seed", range(3))
def test_a_car_that_has_more_matches_than_the_scene_is_left_out(seed, num_fixed, num_wrong):
    b1, b2, pose = with_fixed_content(seed, num_fixed=num_fixed, num_wrong=num_wrong)
    result = epi360.estimate_relative_pose(b1, b2)
    assert result.status == "ok"
    assert max(errors_deg(result, pose)) < 1.5
    assert not result.inlier_mask[100:].any()
    assert f"{num_fixed} of {100 + num_fixed} matches stand still" in result.warnings[0]


# Before, all were rotations of 0 degrees.
@pytest.mark.parametrize("moved", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_an_operator_is_left_out_among_as_many_wrong_matches_as_right_ones(seed, moved):
    b1, b2, pose = with_fixed_content(seed, num_fixed=250, moved=moved)
    rng = np.random.default_rng(seed)
    wrong = anywhere(120, rng), anywhere(120, rng)
    b1, b2 = np.concatenate([b1, wrong[0]]), np.concatenate([b2, wrong[1]])
    result = epi360.estimate_relative_pose(b1, b2)
    assert result.status == ("ok" if moved else "pure_rotation") and says_fixed(result)
    assert errors_deg(result, pose)[0] < 0.5


@pytest.mark.parametrize("num_fixed", [200, 400])
@pytest.mark.parametrize("seed", range(3))
def test_in_a_cabin_all_around_the_motion_is_an_alternative(seed, num_fixed):
    """Nothing tells a camera in a car from one that stands still among things that moved."""
    b1, b2, pose = with_fixed_content(seed, num_fixed=1, num_wrong=20)
    cabin = anywhere(num_fixed, np.random.default_rng(seed))
    b1, b2 = np.concatenate([b1, cabin]), np.concatenate([b2, cabin])
    result = epi360.estimate_relative_pose(b1, b2)
    assert result.status == "pure_rotation" and not says_fixed(result)
    (warning,) = (each for each in result.warnings if "the camera has moved" in each)
    assert "stand still in the images: these may be fixed to it" in warning
    moved = result.alternatives[0]
    assert epi360.rotation_error_deg(moved, pose) < 1.5
    assert epi360.translation_error_deg(moved, pose) < 1.5


@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_turns_above_its_car_has_turned(seed):
    b1, b2, pose = with_fixed_content(seed, num_fixed=200, moved=False)
    result = epi360.estimate_relative_pose(b1, b2)
    assert result.status == "pure_rotation"
    assert errors_deg(result, pose)[0] < 0.1
    assert says_fixed(result)


def test_the_answer_is_that_of_the_other_matches():
    b1, b2, _ = with_fixed_content(0, num_fixed=200, num_wrong=20)
    scores = np.linspace(1.0, 0.0, len(b1))
    still = np.linalg.norm(b1 - b2, axis=1) < np.radians(1.0)
    result = epi360.estimate_relative_pose(b1, b2, match_scores=scores)
    alone = epi360.estimate_relative_pose(b1[~still], b2[~still], match_scores=scores[~still])
    assert alone.success and not alone.warnings
    for name in ("rotation", "translation"):
        found, expected = (getattr(each.cam2_from_cam1, name) for each in (result, alone))
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(result.covariance, alone.covariance)
    np.testing.assert_array_equal(result.inlier_mask[~still], alone.inlier_mask)
    np.testing.assert_allclose(result.residuals_rad[~still], alone.residuals_rad, atol=1e-12)
    assert np.isfinite(result.residuals_rad).all()
    assert result.probability == alone.probability
    assert result.num_iterations > alone.num_iterations


@pytest.mark.parametrize("moved", [True, False])
def test_swapped_views_have_the_inverse_answer(moved):
    b1, b2, _ = with_fixed_content(1, num_fixed=200, moved=moved)
    result, swapped = epi360.estimate_relative_pose(b1, b2), epi360.estimate_relative_pose(b2, b1)
    assert result.status == swapped.status
    assert says_fixed(result) and says_fixed(swapped)
    there = result.cam2_from_cam1.rotation
    np.testing.assert_allclose(swapped.cam2_from_cam1.rotation.T, there, atol=2e-3)


def test_missing_matches_are_counted_beside_them():
    b1, b2, _ = with_fixed_content(0, num_fixed=150)
    b1[[3, 120]] = np.nan
    result = epi360.estimate_relative_pose(b1, b2)
    assert result.success
    missing, fixed = result.warnings
    assert "2 of 250 matches are missing" in missing
    assert "149 of 250 matches stand still" in fixed
    assert np.isnan(result.residuals_rad[[3, 120]]).all()


@pytest.mark.parametrize("num_others", [60, 300])
@pytest.mark.parametrize("seed", range(3))
def test_a_camera_that_stands_still_among_wrong_matches_has_not_moved(seed, num_others):
    rng = np.random.default_rng(seed)
    scene, wrong = anywhere(60, rng), anywhere(num_others, rng)
    b1 = np.concatenate([scene, wrong])
    b2 = np.concatenate([scene, anywhere(num_others, rng)])
    result = epi360.estimate_relative_pose(seen(b1, rng), seen(b2, rng))
    assert result.status == "pure_rotation"
    assert epi360.rotation_error_deg(result.cam2_from_cam1, Pose(np.eye(3), np.zeros(3))) < 0.1
    assert not says_fixed(result)
    assert not any("has moved" in warning for warning in result.warnings)


@pytest.mark.parametrize("seed", range(3))
def test_what_moves_before_a_camera_that_stands_still_is_not_the_scene(seed):
    """A car passes: its matches agree on a pose, and lie in a part of what the camera sees."""
    rng = np.random.default_rng(seed)
    scene = anywhere(120, rng)
    car = around_down(80, rng, 30.0)[:, [0, 2, 1]] * rng.uniform(3.0, 5.0, (80, 1))
    turn = rotation_from_vector(np.array([0.0, 0.4, 0.0]))
    later = (car - car.mean(axis=0)) @ turn.T + car.mean(axis=0) + [1.5, 0.0, 0.3]
    b1, b2 = np.concatenate([scene, unit(car)]), np.concatenate([scene, unit(later)])
    result = epi360.estimate_relative_pose(seen(b1, rng), seen(b2, rng))
    assert result.status == "pure_rotation"
    assert not says_fixed(result)


def test_a_stabilised_video_keeps_its_far_scenery():
    """It does not turn: what is far away stands still, is the scene, and says how it turned."""
    rng = np.random.default_rng(0)
    far, near = 50.0 * anywhere(200, rng), rng.uniform(1.0, 3.0, (80, 1)) * anywhere(80, rng)
    points, move = np.concatenate([far, near]), np.array([0.1, 0.0, 0.2])
    b1, b2 = seen(unit(points), rng), seen(unit(points + move), rng)
    result = epi360.estimate_relative_pose(b1, b2)
    assert result.success and result.inlier_mask[:200].mean() > 0.9
    assert not says_fixed(result)


def test_what_hardly_moves_under_a_small_turn_is_not_fixed():
    """Near the axis of a turn by 1.5 degrees nothing moves by more than one."""
    rng = np.random.default_rng(0)
    level = unit(rng.normal(size=(50, 3)) * [1.0, 0.1, 1.0])
    b1 = np.concatenate([around_down(60, rng, 30.0), level])
    turn = Pose(rotation_from_vector(np.radians([0.0, 1.5, 0.0])), np.zeros(3))
    result = epi360.estimate_relative_pose(seen(b1, rng), seen(b1 @ turn.rotation.T, rng))
    assert result.status == "pure_rotation"
    assert epi360.rotation_error_deg(result.cam2_from_cam1, turn) < 0.1
    assert result.inlier_mask.all() and not says_fixed(result)


def test_a_warning_counts_what_is_left_out():
    evidence = internals.Evidence()
    evidence.num_matches, evidence.num_fixed, evidence.num_usable = 300, 120, 170
    warnings = {each.code: (each.value, each.reference) for each in internals.judge(evidence)[1]}
    assert warnings["fixed_content"] == (120.0, 300.0)
    assert warnings["missing_matches"] == (10.0, 300.0)
