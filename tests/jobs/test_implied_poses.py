# SPDX-License-Identifier: BSD-3-Clause
"""The pose that two pairs of three images imply for the third."""

from dataclasses import replace

import numpy as np
import pytest

from epi360 import rotation_error_deg, translation_error_deg
from epi360.jobs.graph.implied_poses import ImpliedPoses, near_matches
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector

# Camera from world, in metres; the baselines are as unlike as 1 to 4.
CAMERAS = [
    Pose(rotation_from_vector(turn), -rotation_from_vector(turn) @ np.array(place))
    for turn, place in [
        ((0.1, 0.8, 0.0), (0.0, 0.0, 0.0)),
        ((0.0, -0.4, 0.2), (0.5, 0.1, 0.3)),
        ((0.3, 2.0, 0.1), (-1.5, 0.2, 1.4)),
        ((0.0, 1.0, 0.0), (0.4, -0.3, -1.2)),
    ]
]
POINTS = np.random.default_rng(0).normal(size=(120, 3)) * 3.0


def truth(first, second):
    pose = CAMERAS[second] @ CAMERAS[first].inverse()
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))


def bearings(camera, rows):
    seen = POINTS[rows] @ CAMERAS[camera].rotation.T + CAMERAS[camera].translation
    return seen / np.linalg.norm(seen, axis=1, keepdims=True)


def pair_of(first, second, rows):
    rows = np.asarray(rows)
    both = bearings(first, rows), bearings(second, rows)
    return PosedPair((first, second), truth(first, second), (rows, rows), both, 0.05, 0.1, 0.2)


@pytest.mark.parametrize("known", [((0, 2), (1, 2)), ((2, 0), (1, 2)), ((0, 2), (2, 1))])
@pytest.mark.parametrize("wanted", [(0, 1), (1, 0)])
def test_the_direction_follows_from_the_scale_that_shared_points_give(known, wanted):
    pairs = [pair_of(*known[0], range(80)), pair_of(*known[1], range(40, 120))]
    (way,) = ImpliedPoses(pairs).ways(*wanted)
    assert rotation_error_deg(way.cam2_from_cam1, truth(*wanted)) < 1e-6
    assert translation_error_deg(way.cam2_from_cam1, truth(*wanted)) < 1e-6
    assert np.linalg.norm(way.cam2_from_cam1.translation) == pytest.approx(1.0)
    assert sorted(way.rows) == [0, 1]


def test_without_a_common_scale_nothing_is_implied():
    front, back = np.flatnonzero(POINTS[:, 2] > 1.5), np.flatnonzero(POINTS[:, 2] < -1.5)
    pairs = [pair_of(0, 2, front), pair_of(1, 2, back)]
    assert ImpliedPoses(pairs).ways(0, 1) == []


def test_without_a_common_image_nothing_is_implied():
    assert ImpliedPoses([pair_of(0, 2, range(80))]).ways(0, 1) == []


def test_the_way_over_most_points_comes_first():
    weak = [pair_of(0, 2, range(30)), pair_of(1, 2, range(80))]
    strong = [pair_of(0, 3, range(60)), pair_of(1, 3, range(60))]
    ways = ImpliedPoses([*weak, *strong]).ways(0, 1)
    assert [way.rows for way in ways] == [(2, 3), (0, 1)]


def test_matches_agree_that_are_near_to_the_epipolar_plane_and_in_front():
    rows = np.arange(60)
    pairs = [pair_of(0, 2, range(80)), pair_of(1, 2, range(80))]
    (way,) = ImpliedPoses(pairs).ways(0, 1)
    first, second = bearings(0, rows), bearings(1, rows)
    assert way.num_agreeing(first, second) == 60
    second[:20] = -second[:20]  # on the plane, but behind
    assert way.num_agreeing(first, second) == 40
    normal = np.cross(way.cam2_from_cam1.translation, second[20])
    second[20:21] = second[20] * np.cos(0.03) + normal / np.linalg.norm(normal) * np.sin(0.03)
    assert way.num_agreeing(first, second) == 39
    near = near_matches(way.cam2_from_cam1, first, second, 2.0)
    assert near.all()  # 0.03 rad are 1.7 degrees


@pytest.mark.parametrize("seed", range(20))
def test_what_agrees_by_chance_is_said_to(seed):
    pairs = [pair_of(0, 2, range(80)), pair_of(1, 2, range(80))]
    (way,) = ImpliedPoses(pairs).ways(0, 1)
    rng = np.random.default_rng(seed)
    first, second = bearings(0, np.arange(100)), bearings(1, rng.permutation(100))
    assert way.is_chance(first, second)
    second[:12] = bearings(1, np.arange(12))
    assert not way.is_chance(first, second)
    assert way.is_chance(first[:2], second[1:3])


def test_images_at_one_place_have_no_direction():
    pairs = [pair_of(0, 2, range(80)), pair_of(0, 2, range(80))]
    pairs[1] = replace(pairs[1], images=(1, 2))  # the same pose: both stand in one place
    assert ImpliedPoses(pairs).ways(0, 1) == []
