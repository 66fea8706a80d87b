# SPDX-License-Identifier: BSD-3-Clause
"""A pattern that repeats itself on the floor is no step of the camera."""

from functools import partial

import numpy as np
import pytest

from epi360.estimation import estimate_relative_pose
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.seen_through import without_what_is_seen_through
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg

ESTIMATE = partial(estimate_relative_pose, options=IMAGE_OPTIONS, max_noise_deg=0.3)
TURN = Pose(rotation_from_vector([0.02, 2.0, -0.01]), np.zeros(3))
TILE = np.array([0.9, 0.0, 0.5])
HEIGHT = 1.6


def bearings_of(first, second, rng):
    """What two views see of points in their frames, with noise."""
    both = []
    for points in (first, second):
        units = points / np.linalg.norm(points, axis=1, keepdims=True)
        noisy = units + 0.0005 * rng.normal(size=units.shape)
        both.append(noisy / np.linalg.norm(noisy, axis=1, keepdims=True))
    return both


def walls(rng, count, ahead=np.pi):
    """Points of walls around, or ahead by up to so many radians, above the floor."""
    azimuths = rng.uniform(-ahead, ahead, count)
    heights = rng.uniform(-2.0, 1.2, count)
    return np.column_stack([4.0 * np.sin(azimuths), heights, 4.0 * np.cos(azimuths)])


def floor(rng, count, reach=2.0):
    return rng.uniform([-reach, HEIGHT, -reach], [reach, HEIGHT, reach], (count, 3))


def turned_above_tiles(seed, num_right=25, num_shifted=25, ahead=np.pi):
    """A camera that has turned; matches of tiles with the next ones, and right ones."""
    rng = np.random.default_rng(seed)
    right = np.concatenate([walls(rng, num_right - 8, ahead), floor(rng, 8, reach=1.2)])
    shifted = floor(rng, num_shifted)
    first = np.concatenate([right, shifted])
    second = np.concatenate([right, shifted + TILE]) @ TURN.rotation.T
    return bearings_of(first, second, rng)


@pytest.mark.parametrize("seed", range(5))
def test_a_turn_above_tiles_is_a_turn(seed):
    bearings = turned_above_tiles(seed, num_shifted=40, ahead=np.radians(70.0))
    given = ESTIMATE(*bearings)
    assert given.success and given.probability > 0.9  # a step by one tile
    told = without_what_is_seen_through(given, bearings, ESTIMATE)
    assert told.status == "pure_rotation"
    assert rotation_error_deg(told.cam2_from_cam1, TURN) < 0.2
    assert "would be seen through it" in told.warnings[-1]
    assert told.inlier_mask[:25].sum() > 20 and told.inlier_mask.sum() < 28
    assert len(told.residuals_rad) == 65 and np.isnan(told.residuals_rad).sum() > 20


@pytest.mark.parametrize("seed", range(5))
def test_below_walls_all_around_the_tiles_are_what_moves_on_one_side(seed):
    told = ESTIMATE(*turned_above_tiles(seed, num_shifted=40))
    assert told.status == "pure_rotation"
    assert rotation_error_deg(told.cam2_from_cam1, TURN) < 0.2
    assert "on one side of the camera say another motion" in told.warnings[-1]


@pytest.mark.parametrize("seed", range(5))
def test_where_as_many_matches_are_right_the_tiles_are_what_moves(seed):
    told = ESTIMATE(*turned_above_tiles(seed))
    assert told.status == "pure_rotation"
    assert rotation_error_deg(told.cam2_from_cam1, TURN) < 0.2


def test_what_is_left_of_few_right_matches_is_no_pose():
    bearings = turned_above_tiles(0, num_right=13, num_shifted=15)
    given = ESTIMATE(*bearings)
    assert given.success
    told = without_what_is_seen_through(given, bearings, ESTIMATE)
    assert told.status == "too_few_inliers" and len(told.alternatives) >= 1


def test_missing_matches_are_counted_among_all():
    bearings = turned_above_tiles(0)
    bearings = [np.concatenate([np.full((3, 3), np.nan), each]) for each in bearings]
    given = ESTIMATE(*bearings)
    told = without_what_is_seen_through(given, bearings, ESTIMATE)
    assert told.status == "pure_rotation" and len(told.inlier_mask) == 53
    assert not any("of 28 matches" in warning for warning in told.warnings)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_in_a_room_stays(seed):
    rng = np.random.default_rng(seed)
    points = np.concatenate([walls(rng, 60), floor(rng, 40)])
    step = Pose(TURN.rotation, np.array([0.3, 0.0, 0.4]))
    bearings = bearings_of(points, points @ step.rotation.T + step.translation, rng)
    given = ESTIMATE(*bearings)
    assert translation_error_deg(given.cam2_from_cam1, step) < 2.0
    assert without_what_is_seen_through(given, bearings, ESTIMATE) is given


@pytest.mark.parametrize("seed", range(5))
def test_a_step_on_a_roof_stays(seed):
    """The roof is near, and all that is far away is above its edge."""
    rng = np.random.default_rng(seed)
    far = 1000.0 * walls(rng, 25) * [1.0, 0.0, 1.0] - [0.0, 300.0, 0.0]
    points = np.concatenate([far, floor(rng, 60)])
    step = Pose(TURN.rotation, np.array([0.3, 0.0, 0.4]))
    bearings = bearings_of(points, points @ step.rotation.T + step.translation, rng)
    given = ESTIMATE(*bearings)
    assert given.success
    assert without_what_is_seen_through(given, bearings, ESTIMATE) is given


def test_a_refused_pose_stays():
    rng = np.random.default_rng(0)
    bearings = bearings_of(*rng.normal(size=(2, 40, 3)), rng)
    given = ESTIMATE(*bearings)
    assert without_what_is_seen_through(given, bearings, ESTIMATE) is given
