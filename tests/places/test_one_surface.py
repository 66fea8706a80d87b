# SPDX-License-Identifier: BSD-3-Clause
"""Which pairs lie on the floor or on one wall, by made points."""

from dataclasses import replace

import numpy as np
import pytest

from epi360.places.one_surface import on_floor, on_one_wall, plane_share
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector

POSE = Pose(rotation_from_vector([0.1, 0.7, -0.2]), np.array([0.6, 0.2, -0.7]))


def unit(points):
    return points / np.linalg.norm(points, axis=1)[:, None]


def pair_of(points, *, noise_deg=0.02, seed=0):
    """A pair that sees points (N, 3) of the first camera, as well as that."""
    rng = np.random.default_rng(seed)
    seen = points @ POSE.rotation.T + POSE.translation
    sigma = np.radians(noise_deg)
    bearings = tuple(
        unit(unit(each) + sigma * rng.normal(size=each.shape)) for each in (points, seen)
    )
    rows = np.arange(len(points))
    return PosedPair((0, 1), POSE, (rows, rows), bearings, noise_deg, 0.1, 0.1)


def wall(num, *, seed=0, depth_m=2.5):
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(-2, 2, num), rng.uniform(-2, 1, num), np.full(num, depth_m)]
    )


def all_around(num, *, seed=1):
    rng = np.random.default_rng(seed)
    return unit(rng.normal(size=(num, 3))) * rng.uniform(1.5, 5.0, (num, 1))


def swapped(pair):
    return replace(
        pair,
        cam2_from_cam1=pair.cam2_from_cam1.inverse(),
        bearings=pair.bearings[::-1],
        keypoints=pair.keypoints[::-1],
    )


@pytest.mark.parametrize("num_off", [0, 40, 100, 300])
def test_the_share_on_a_plane_is_found(num_off):
    pair = pair_of(np.concatenate([wall(300), all_around(num_off)]))
    expected = 300 / (300 + num_off)
    assert expected - 0.02 <= plane_share(pair) <= expected + 0.08  # some others are near to it
    assert on_one_wall(pair) == (num_off == 0)
    assert plane_share(swapped(pair)) == pytest.approx(plane_share(pair), abs=0.01)
    assert plane_share(pair) == plane_share(pair)


def test_a_wavy_wall_is_one_and_a_corner_of_two_is_not():
    points = wall(400)
    waves = points * (1 + 0.02 * np.sin(5 * points[:, :1]))
    assert on_one_wall(pair_of(waves))
    corner = np.concatenate([points, points[:200] @ rotation_from_vector([0.0, 1.5, 0.0]).T])
    assert not on_one_wall(pair_of(corner))


def test_of_distances_that_are_not_known_nothing_is_said():
    assert plane_share(pair_of(1000.0 * wall(300))) == 0.0
    assert plane_share(pair_of(wall(2))) == 0.0
    assert plane_share(pair_of(np.zeros((0, 3)))) == 0.0


def test_what_lies_on_the_floor_is_not_on_a_wall():
    floor = wall(300)[:, [0, 2, 1]]
    floor[:, 1] = 1.5
    level = replace(pair_of(floor), cam2_from_cam1=Pose(np.eye(3), POSE.translation))
    seen = floor + POSE.translation
    pair = replace(level, bearings=(unit(floor), unit(seen)))
    assert plane_share(pair) > 0.95
    assert on_floor(pair) and not on_one_wall(pair)
    assert not on_floor(pair_of(wall(300)))
