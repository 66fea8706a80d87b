# SPDX-License-Identifier: BSD-3-Clause
"""A mirrored image has no pose: many of its matches would lie behind the cameras.

Or they are those of a mirrored turn.
"""

import numpy as np
import pytest
from noisy_problems import noisy_scene

from epi360 import estimate_relative_pose
from epi360.poses import rotation_from_vector


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_a_mirrored_image_has_no_pose_and_is_named(axis, seed):
    scene = noisy_scene(seed, 0.06, 0.3)
    mirror = np.ones(3)
    mirror[axis] = -1.0
    assert estimate_relative_pose(scene.bearings1, scene.bearings2).success
    result = estimate_relative_pose(scene.bearings1, mirror * scene.bearings2)
    assert not result.success and np.isnan(result.cam2_from_cam1.matrix()).any()
    if result.status == "too_few_inliers" and result.warnings:
        assert "may be mirrored" in result.warnings[-1]


def test_most_mirrored_images_are_named():
    scenes = [noisy_scene(seed, 0.06, 0.2) for seed in range(10)]
    found = [estimate_relative_pose(each.bearings1, each.bearings2 * (-1, 1, 1)) for each in scenes]
    named = [each for each in found if any("may be mirrored" in w for w in each.warnings)]
    assert len(named) >= 8


def mirrored_turn(seed, num_other):
    """A turn of which one view is mirrored, seen by matches most of which seem to lie in front.

    Others lie on the same epipolar planes, as those of what repeats itself along the walls do.
    """
    rng = np.random.default_rng(seed)
    normal, turn = np.array([1.0, 0.0, 0.0]), rotation_from_vector([0.0, np.radians(70.0), 0.0])
    mirror = np.eye(3) - 2.0 * np.outer(normal, normal)
    turned = rng.normal(size=(400, 3))
    shares = turned[:, 0] / np.linalg.norm(turned, axis=1)
    turned = np.concatenate([turned[shares > 0.2][:60], turned[shares < -0.2][:30]])
    others = rng.uniform(-3.0, 3.0, (num_other, 3))
    pair = (
        np.concatenate([turned, others]) @ turn,
        np.concatenate([turned @ mirror, others - 0.8 * normal]),
    )
    return tuple(
        view / np.linalg.norm(view, axis=1, keepdims=True)
        + np.radians(0.05) * rng.normal(size=view.shape)
        for view in pair
    )


@pytest.mark.parametrize("num_other", [0, 100, 200])
def test_a_mirrored_turn_is_no_step(num_other):
    for seed in range(6):
        result = estimate_relative_pose(*mirrored_turn(seed, num_other))
        assert not result.success
        if num_other:  # else only one hemisphere has matches
            assert "one of the images is mirrored" in result.warnings[-1]


def noisy_views(points, step, rng, noise_deg):
    for b in (points, points - step):
        b = b / np.linalg.norm(b, axis=1, keepdims=True)
        yield b + np.radians(noise_deg) * rng.normal(size=b.shape)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise_deg", [0.1, 0.3])
def test_a_door_halfway_between_the_cameras_is_no_mirror(noise_deg, seed):
    """What lies on the plane across the translation is where its mirror puts it, too."""
    rng = np.random.default_rng(seed)
    frame = rng.uniform(-1.0, 1.0, (100, 3)) * [0.05, 1.1, 0.5]
    others = rng.uniform(-1.0, 1.0, (100, 3)) * [6.0, 1.5, 3.0]
    points = np.concatenate([frame, others]) + [2.0, 0.0, -0.2]
    assert estimate_relative_pose(*noisy_views(points, [4.0, 0.1, 0.0], rng, noise_deg)).success


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("rise_m", "band_m"), [(0.3, 0.2), (4.0, 0.3)])
def test_a_step_upwards_among_things_at_one_height_is_no_mirrored_turn(rise_m, band_m, seed):
    rng = np.random.default_rng(seed)
    around, away = rng.uniform(0.0, 2.0 * np.pi, 300), rng.uniform(3.0, 30.0, 300)
    heights = rng.uniform(-band_m, band_m, 300) + rise_m / 2.0
    points = np.stack([away * np.cos(around), heights, away * np.sin(around)], axis=1)
    assert estimate_relative_pose(*noisy_views(points, [0.0, rise_m, 0.0], rng, 0.1)).success
