# SPDX-License-Identifier: BSD-3-Clause
"""Which pairs lie on the floor or on one wall, by made points."""

from dataclasses import replace

import numpy as np
import pytest

from epi360.places.one_surface import main_plane, on_floor, on_one_wall
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector

# Upright cameras; the baseline is 0.94.
POSE = Pose(rotation_from_vector([0.0, 0.7, 0.0]), np.array([0.6, 0.2, -0.7]))
TILT = rotation_from_vector([0.0, 0.0, 0.35])  # 20 degrees


def unit(points):
    return points / np.linalg.norm(points, axis=1)[:, None]


def pair_of(points, pose=POSE, *, noise_deg=0.02, seed=0):
    """A pair that sees points (N, 3) of the first camera, as well as that."""
    rng = np.random.default_rng(seed)
    both = points, points @ pose.rotation.T + pose.translation
    sigma = np.radians(noise_deg)
    first, second = (unit(unit(each) + sigma * rng.normal(size=each.shape)) for each in both)
    rows = np.arange(len(points))
    return PosedPair((0, 1), pose, (rows, rows), (first, second), noise_deg, 0.1, 0.1)


def wall(num, *, seed=0, depth_m=2.5):
    """Points in front of the first camera."""
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(-2, 2, num), rng.uniform(-2, 1, num), np.full(num, depth_m)]
    )


def floor(num, *, height_m=1.5):
    points = wall(num)[:, [0, 2, 1]]
    return np.column_stack([points[:, 0], np.full(num, height_m), points[:, 2]])


def all_around(num, *, seed=1, most_m=5.0):
    rng = np.random.default_rng(seed)
    return unit(rng.normal(size=(num, 3))) * rng.uniform(1.5, most_m, (num, 1))


def swapped(pair):
    return replace(
        pair,
        cam2_from_cam1=pair.cam2_from_cam1.inverse(),
        bearings=pair.bearings[::-1],
        keypoints=pair.keypoints[::-1],
    )


@pytest.mark.parametrize("num_off", [0, 60, 100, 300])
@pytest.mark.parametrize("noise_deg", [0.02, 0.1])
def test_the_plane_that_most_points_lie_on_is_found(num_off, noise_deg):
    pair = pair_of(np.concatenate([wall(300), all_around(num_off)]), noise_deg=noise_deg)
    expected = 300 / (300 + num_off)
    plane = main_plane(pair, 0)
    assert expected - 0.03 <= plane.share <= expected + 0.06  # some others are near to it
    np.testing.assert_allclose(plane.normal, [0.0, 0.0, 1 / 2.5], atol=0.02)
    assert on_one_wall(pair) == on_one_wall(swapped(pair)) == (num_off == 0)
    other = main_plane(swapped(pair), 1)
    np.testing.assert_allclose(other.normal, plane.normal, atol=1e-9)
    assert other.share == pytest.approx(plane.share, abs=0.01)


def test_a_wall_may_be_wavy_and_noisy_but_has_no_corner():
    points = wall(400)
    waves = points * (1 + 0.04 * np.sin(5 * points[:, :1]))
    assert on_one_wall(pair_of(waves))
    assert on_one_wall(pair_of(wall(400, depth_m=4.0), noise_deg=0.3))
    assert not on_one_wall(pair_of(points * (1 + 0.2 * np.sin(5 * points[:, :1]))))
    corner = np.concatenate([points, points[:200] @ rotation_from_vector([0.0, 1.5, 0.0]).T])
    assert not on_one_wall(pair_of(corner))


def test_points_whose_distance_is_not_known_are_not_on_the_wall():
    far = 200.0 * all_around(140)
    assert main_plane(pair_of(np.concatenate([wall(160), far])), 0).share < 0.6
    assert main_plane(pair_of(1000.0 * wall(300)), 0).share == 0.0
    assert not on_one_wall(pair_of(np.concatenate([wall(300), far[:60]])))


def test_of_many_points_some_are_asked():
    points = np.concatenate([wall(6000), all_around(2000)])
    assert main_plane(pair_of(points), 0).share == pytest.approx(0.77, abs=0.03)


def test_floors_and_ceilings_are_no_walls_however_the_cameras_are_tilted():
    below, above = floor(300), floor(300, height_m=-1.2)
    level = pair_of(below, Pose(np.eye(3), np.array([0.7, 0.0, 0.3])))
    assert on_floor(level) and not on_one_wall(level)
    assert not on_floor(pair_of(wall(300)))
    for points in (below, above):
        for tilt in (np.eye(3), TILT):
            pair = pair_of(points @ tilt.T)
            assert main_plane(pair, 0).share > 0.95
            assert not on_one_wall(pair)
    assert on_one_wall(pair_of(wall(300) @ TILT.T))


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        wall(2),
        np.tile([[0.3, 0.2, 1.0]], (30, 1)),
        np.outer(np.linspace(1.0, 2.0, 30), [0.3, 0.2, 1.0]),
        np.column_stack([wall(30)[:, :2], wall(30)[:, 0]]),
    ],
    ids=["none", "two", "one, again and again", "one ray", "a plane through the camera"],
)
def test_degenerate_points_make_no_wall(points):
    pair = pair_of(points, noise_deg=0.0)
    for side in (0, 1):
        plane = main_plane(pair, side)
        assert np.isfinite(plane.normal).all() and 0.0 <= plane.share <= 1.0
    assert not on_one_wall(pair)
