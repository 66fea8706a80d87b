# SPDX-License-Identifier: BSD-3-Clause
"""Points that pairs share put them into one scale."""

import numpy as np
import pytest

from epi360.places.shared_points import PosedPair, cloud_of, scale_between
from epi360.poses import Pose, rotation_from_vector


def pair_of(points, keypoints, turn, place, *, noise_deg=0.0, seed=0):
    """Pair of a camera at the origin and one elsewhere, with the unit translation of a pair."""
    rotation = rotation_from_vector(turn)
    translation = -rotation @ np.asarray(place)
    rng = np.random.default_rng(seed)
    seen = [points, points @ rotation.T + translation]
    bearings = []
    for each in seen:
        noisy = each / np.linalg.norm(each, axis=1, keepdims=True)
        noisy = noisy + rng.normal(0, np.radians(noise_deg), noisy.shape)
        bearings.append(noisy / np.linalg.norm(noisy, axis=1, keepdims=True))
    pose = Pose(rotation, translation / np.linalg.norm(translation))
    numbers = (keypoints, keypoints)
    return PosedPair((0, 1), pose, numbers, tuple(bearings), noise_deg, 0.1, 0.1)


def scattered(count, seed=0):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions * rng.uniform(2, 5, (count, 1))


@pytest.mark.parametrize("side", [0, 1])
def test_points_lie_where_they_are_in_the_frame_of_either_camera(side):
    points = scattered(80)
    pair = pair_of(points, np.arange(80), (0.1, 0.8, 0.0), (0.6, 0.1, 0.4))
    cloud = cloud_of(pair, side, 0.0)
    base = np.linalg.norm([0.6, 0.1, 0.4])
    pose = pair.cam2_from_cam1
    truth = points / base if side == 0 else points / base @ pose.rotation.T + pose.translation
    np.testing.assert_allclose(cloud.points, truth[cloud.keypoints], atol=1e-9)


def test_points_without_parallax_are_left_out():
    pair = pair_of(scattered(80), np.arange(80), (0.0, 0.3, 0.0), (0.05, 0.0, 0.0))
    assert len(cloud_of(pair, 0, 3.0).points) == 0


def test_shared_key_points_say_the_scale():
    points = scattered(60)
    first = pair_of(points, np.arange(60), (0.0, 0.3, 0.0), (0.5, 0.0, 0.0), noise_deg=0.05)
    second = pair_of(points[30:], np.arange(30, 60), (0.0, 1.0, 0.0), (0.0, 0.1, 1.5))
    scale, sigma = scale_between(cloud_of(first, 0, 0.5), cloud_of(second, 0, 0.5))
    assert abs(np.log(scale / (np.hypot(0.1, 1.5) / 0.5))) < 4 * sigma < 0.1


def test_so_do_points_in_about_one_direction():
    points = scattered(60)
    points *= 3.0 / np.linalg.norm(points, axis=1, keepdims=True)
    first = pair_of(points, np.arange(60), (0.0, 0.3, 0.0), (0.5, 0.0, 0.0))
    beside = points + [0.0, 0.02, 0.02]
    second = pair_of(beside, np.arange(100, 160), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    scale, _ = scale_between(cloud_of(first, 0, 0.5), cloud_of(second, 0, 0.5))
    assert scale == pytest.approx(2.0, rel=0.02)


def test_points_in_other_directions_say_nothing():
    points = scattered(60)
    ahead, behind = np.abs(points), -np.abs(points)
    first = pair_of(ahead, np.arange(60), (0.0, 0.3, 0.0), (0.5, 0.0, 0.0))
    second = pair_of(behind, np.arange(60, 120), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert scale_between(cloud_of(first, 0, 0.5), cloud_of(second, 0, 0.5)) is None
