# SPDX-License-Identifier: BSD-3-Clause
"""What passes on one side of a camera does not say how the camera moved."""

import numpy as np
import pytest
from made_evidence import made_evidence

from epi360 import (
    Pose,
    RansacOptions,
    _core,
    estimate_relative_pose,
    estimate_relative_poses,
    rotation_error_deg,
    translation_error_deg,
)
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.one_side_reference import sides_that_say_most
from epi360.estimation.result import MISSING_MATCHES
from epi360.poses import rotation_from_vector

NOISE_RAD = np.radians(0.056)
TURN = rotation_from_vector([0.02, 0.3, -0.01])
NUM_STILL = 300
ONE_SIDE = "on one side of the camera say another motion than all others"


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def seen(still, moving, by, step, rng, num_wrong):
    """Bearings in both views, with noise and wrong matches, and the pose."""
    second = np.concatenate([still - step, moving + by - step]) @ TURN.T
    views = []
    for points in (np.concatenate([still, moving]), second):
        bearings = np.concatenate([unit(points), unit(rng.normal(size=(num_wrong, 3)))])
        views.append(unit(bearings + rng.normal(0.0, NOISE_RAD, bearings.shape)))
    return *views, Pose(TURN, -TURN @ step)


def past_a_tram(seed, num_tram, step_m=0.04):
    """Still things of a hall all around, and a tram, which passes by."""
    rng = np.random.default_rng(seed)
    directions = unit(rng.normal(size=(NUM_STILL, 3)))
    walls = np.min([8.0, 2.5, 10.0] / np.abs(directions), axis=1, keepdims=True)
    still = directions * walls * rng.uniform(0.6, 1.0, (NUM_STILL, 1))
    tram = rng.uniform([-6.0, -2.0, 4.0], [6.0, 1.5, 4.3], (num_tram, 3))
    return seen(still, tram, [0.6, 0.0, 0.0], np.array([0.0, 0.0, step_m]), rng, num_wrong=40)


def past_a_car(seed, num_car, step_m):
    """A street within 25 m, and a car that drives by 3 m away."""
    rng = np.random.default_rng(seed)
    street = rng.uniform([-25.0, -4.0, -25.0], [25.0, 1.6, 25.0], (3 * NUM_STILL, 3))
    street = street[np.hypot(street[:, 0], street[:, 2]) > 3.0][:NUM_STILL]
    car = rng.uniform([-2.0, -0.2, 3.0], [2.0, 1.2, 4.0], (num_car, 3))
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    step = step_m * np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    return seen(street, car, [1.5, 0.0, 0.0], step, rng, num_wrong=80)


def past_a_long_tram(seed):
    """A street, and a tram as long as half of the horizon, a little faster than the camera."""
    rng = np.random.default_rng(seed)
    street = rng.uniform([-30.0, -8.0, -30.0], [30.0, 1.6, 30.0], (1000, 3))
    street = street[np.hypot(street[:, 0], street[:, 2]) > 3.0][:150]
    tram = rng.uniform([-4.0, -1.0, 3.9], [4.0, 2.0, 4.1], (200, 3))
    step = 3.0 * unit(rng.normal([[1.0, 0.0, 0.0]], [[0.0, 0.03, 0.1]]))[0]
    return seen(street, tram, [3.3, 0.0, 0.0], step, rng, num_wrong=45)


def is_right(pose, truth, within_deg=10.0):
    return rotation_error_deg(pose, truth) < 3.0 and translation_error_deg(pose, truth) < within_deg


@pytest.mark.parametrize("options", [RansacOptions(), IMAGE_OPTIONS])
@pytest.mark.parametrize("seed", range(6))
def test_a_small_step_past_a_tram_has_not_its_direction(options, seed):
    b1, b2, pose = past_a_tram(seed, 220)
    result = estimate_relative_pose(b1, b2, options=options, seed=seed)
    assert rotation_error_deg(result.cam2_from_cam1, pose) < 1.0
    assert len(result.residuals_rad) == len(b1)
    assert not any(MISSING_MATCHES in each for each in result.warnings)
    if result.status == "pure_rotation":  # a step of five times the noise
        return
    assert result.status == "planar_ambiguous" and result.probability < 0.6
    named = [result.cam2_from_cam1, *result.alternatives]
    within = max(10.0, 4.0 * result.translation_sigma_deg)
    assert any(is_right(each, pose, within) for each in named)
    assert any(translation_error_deg(each, pose) > 60.0 for each in named)


def statuses_and_rightness(problems):
    results = estimate_relative_poses([each[:2] for each in problems], options=IMAGE_OPTIONS)
    poses = [pose for *_, pose in problems]
    return [
        (result.status, is_right(result.cam2_from_cam1, pose))
        for result, pose in zip(results, poses, strict=True)
    ]


# Before, 3, 12, 2 and 15 of 20 were ok and wrong, at a stated error of half a degree.
@pytest.mark.parametrize(
    ("num_car", "step_m", "most"), [(100, 0.3, 1), (250, 0.3, 5), (100, 1.0, 0), (250, 1.0, 5)]
)
def test_a_step_past_a_car_is_rarely_taken_for_that_of_the_car(num_car, step_m, most):
    told = statuses_and_rightness([past_a_car(seed, num_car, step_m) for seed in range(20)])
    assert told.count(("ok", False)) <= most
    assert sum(right for _, right in told) >= 8


def test_the_motion_of_what_is_all_around_is_named_first():
    named = []
    for seed in range(60):
        b1, b2, pose = past_a_car(seed, 100, 0.3)
        result = estimate_relative_pose(b1, b2, options=IMAGE_OPTIONS)
        if not any(ONE_SIDE in each for each in result.warnings):
            continue
        assert result.status == "planar_ambiguous" and result.probability <= 0.5
        assert result.inlier_mask[NUM_STILL : NUM_STILL + 100].sum() < 20
        assert not any(MISSING_MATCHES in each for each in result.warnings)
        assert not is_right(result.alternatives[0], pose)
        named.append(is_right(result.cam2_from_cam1, pose))
    assert len(named) >= 4 and np.mean(named) > 0.7


def test_beside_a_turn_what_moved_far_more_is_said_to_be_beside_it():
    """A step of 4 cm in a street is as good as none, and a car that moves 1.5 m no step."""
    named = 0
    for seed in range(6):
        b1, b2, pose = past_a_car(seed, 250, 0.04)
        result = estimate_relative_pose(b1, b2, options=IMAGE_OPTIONS)
        assert rotation_error_deg(result.cam2_from_cam1, pose) < 0.3
        assert result.status != "ok"
        named += any(ONE_SIDE in each for each in result.warnings)
    assert named >= 4


def test_what_is_all_around_is_asked_where_the_inliers_cover_little():
    """The tram has most of the matches and of the regions, but not of the sphere."""
    wrong = named = 0
    for seed in range(20):
        b1, b2, pose = past_a_long_tram(seed)
        result = estimate_relative_pose(b1, b2, options=IMAGE_OPTIONS)
        wrong += result.status == "ok" and not is_right(result.cam2_from_cam1, pose)
        if any(ONE_SIDE in each for each in result.warnings):
            assert result.status == "planar_ambiguous" and result.probability <= 0.5
            named += is_right(result.cam2_from_cam1, pose)
    assert named >= 3 and wrong <= 7  # before, 0 and 10


@pytest.mark.parametrize(("num_tram", "step_m"), [(60, 0.06), (0, 0.06), (0, 0.4)])
def test_a_smaller_tram_leaves_the_pose_alone(num_tram, step_m):
    for seed in range(4):
        b1, b2, pose = past_a_tram(seed, num_tram, step_m)
        result = estimate_relative_pose(b1, b2, seed=seed)
        assert result.status == "ok"
        error = translation_error_deg(result.cam2_from_cam1, pose)
        assert error < max(2.0, 4.0 * result.translation_sigma_deg)


@pytest.mark.parametrize("seed", range(4))
def test_a_table_that_stands_still_beside_the_camera_is_believed(seed):
    """It says most of the direction as well, and nothing around it contradicts it."""
    rng = np.random.default_rng(seed)
    directions = unit(rng.normal(size=(NUM_STILL, 3)))
    room = directions * rng.uniform(6.0, 12.0, (NUM_STILL, 1))
    table = rng.uniform([-0.6, 0.2, 0.6], [0.6, 0.5, 1.2], (200, 3))
    b1, b2, pose = seen(room, table, np.zeros(3), np.array([0.3, 0.0, 0.1]), rng, num_wrong=60)
    result = estimate_relative_pose(b1, b2, options=IMAGE_OPTIONS, seed=seed)
    assert result.status == "ok" and is_right(result.cam2_from_cam1, pose, 2.0)


def test_many_pairs_are_told_the_same():
    made = [past_a_car(seed, 100, 0.3)[:2] for seed in range(6)]
    together = estimate_relative_poses(made, seed=3, num_threads=2)
    for pair, result in zip(made, together, strict=True):
        alone = estimate_relative_pose(*pair, seed=3)
        assert alone.status == result.status and alone.warnings == result.warnings
        np.testing.assert_array_equal(alone.cam2_from_cam1.matrix(), result.cam2_from_cam1.matrix())


def test_a_side_that_contradicts_makes_both_poses_equally_probable():
    evidence = made_evidence(num_contradicting=25)
    status, warnings = _core.internals.judge(evidence)
    assert status == "planar_ambiguous" and "one_side" in [each.code for each in warnings]
    assert _core.internals.explain(evidence).rival == pytest.approx(0.5, abs=1e-6)


def test_by_hand_the_car_is_the_side_that_says_most():
    b1, b2, pose = past_a_car(0, 100, 0.3)
    is_car = np.arange(len(b1)) // 100 == 3
    inlier = np.arange(len(b1)) < 400
    unit_pose = Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))
    sides = sides_that_say_most(unit_pose, b1, b2, inlier)
    assert sides
    for side in sides:
        assert side[is_car].mean() > 0.9 and not side[~inlier].any()
        assert side[~is_car].sum() < 60


def test_by_hand_no_side_says_most_in_a_room_of_points_all_around():
    b1, b2, pose = past_a_tram(0, 0, 0.4)
    unit_pose = Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))
    assert sides_that_say_most(unit_pose, b1, b2, np.arange(len(b1)) < NUM_STILL) == []
    assert sides_that_say_most(unit_pose, b1, b2, np.zeros(len(b1), dtype=bool)) == []


def test_the_core_finds_the_sides_of_its_twin():
    found = 0
    for seed in range(12):
        b1, b2, _ = past_a_car(seed, (60, 150)[seed % 2], (0.1, 0.3, 1.0)[seed % 3])
        result = estimate_relative_pose(b1, b2, options=IMAGE_OPTIONS)
        if not result.success:
            continue
        pose, inlier = result.cam2_from_cam1, result.inlier_mask
        twins = [np.flatnonzero(each) for each in sides_that_say_most(pose, b1, b2, inlier)]
        core = _core.internals.sides_that_say_most(
            b1, b2, pose.rotation, pose.translation, inlier.tolist()
        )
        assert len(core) == len(twins)
        for mine, its in zip(twins, core, strict=True):
            np.testing.assert_array_equal(mine, its)
        found += len(core)
    assert found > 5
