# SPDX-License-Identifier: BSD-3-Clause
"""Residuals are worth what chance makes of a displacement; a sharp pose beside a blurred one."""

import numpy as np
import pytest
from noisy_problems import errors_deg, unit_pose
from scipy.spatial.transform import Rotation

from epi360 import _core, estimate_relative_pose
from epi360.epipolar.residuals import pose_residuals
from epi360.estimation.displacement_reference import displacements, log_odds_over_chance
from epi360.estimation.testimony_reference import in_front
from epi360.poses import Pose
from epi360.synthetic import two_view_scene

internals = _core.internals
TYPICAL_DENSITY = 0.35  # of random partners in front of both cameras, per radian


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def displaced(bearings, angle_rad, rng):
    """Bearings so far off in directions of which each is as likely as any other."""
    aside = unit(np.cross(bearings, rng.normal(size=bearings.shape)))
    return np.cos(angle_rad) * bearings + np.sin(angle_rad) * aside


def somebody_walks_ahead(seed, num_right=180, num_wrong=240):
    """A room, and matches of what goes along with a camera that turns: each a few degrees off."""
    scene = two_view_scene(seed, num_matches=num_right, noise_deg=0.08, noise_in_both_views=True)
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-1.5, 1.5, num_wrong), rng.uniform(-0.5, 0.9, num_wrong)
    level = np.cos(elevation)
    ahead = np.column_stack([np.sin(azimuth) * level, np.sin(elevation), np.cos(azimuth) * level])
    turn = Rotation.from_rotvec([0.0, np.radians(6.0), 0.0]).as_matrix()
    off = Rotation.from_rotvec(np.radians(2.5) * rng.normal(size=(num_wrong, 3)))
    after = off.apply(ahead @ (turn @ scene.cam2_from_cam1.rotation).T)
    return np.vstack([scene.bearings1, ahead]), np.vstack([scene.bearings2, after]), scene


def test_a_partner_displaced_in_a_random_direction_has_the_density_that_chance_is_given():
    rng = np.random.default_rng(0)
    pose = Pose(Rotation.random(random_state=1).as_matrix(), unit(rng.normal(size=3)))
    b1 = unit(rng.normal(size=(200_000, 3)))
    for angle_deg in (3.0, 10.0, 20.0):
        angle = np.radians(angle_deg)
        b2 = displaced(b1 @ pose.rotation.T, angle, rng)
        near = np.abs(pose_residuals(pose, b1, b2)) < angle / 20.0
        density = (near & in_front(pose, b1, b2, 0.0)).mean() / (angle / 10.0)
        # At 40 degrees, where residuals are no longer small beside the sphere, it is 7 % less.
        assert density == pytest.approx(1.0 / (np.sqrt(2.0) * np.pi * np.sin(angle)), rel=0.06)


def test_partners_from_anywhere_have_the_typical_density():
    # The mean of 1 / sin over the sphere is half of pi.
    assert 0.5 * np.pi / (np.sqrt(2.0) * np.pi) == pytest.approx(TYPICAL_DENSITY, rel=0.02)


@pytest.mark.parametrize("num_matches", [5, 33, 400, 3000])
def test_displacements_are_those_of_the_twin_in_numpy(num_matches):
    scene = two_view_scene(4, num_matches=num_matches, outlier_ratio=0.4, noise_deg=0.5)
    np.testing.assert_allclose(
        internals.displacements(scene.bearings1, scene.bearings2),
        displacements(scene.bearings1, scene.bearings2),
        atol=1e-9,
    )


def test_displacements_are_from_the_rotation_that_most_matches_are_near():
    rng = np.random.default_rng(2)
    R = Rotation.random(random_state=3).as_matrix()
    b1 = unit(rng.normal(size=(300, 3)))
    b2 = unit(rng.normal(size=(300, 3)))
    angles = np.radians(rng.uniform(0.0, 4.0, 180))
    b2[:180] = displaced(b1[:180] @ R.T, angles[:, None], rng)
    found = internals.displacements(b1, b2)
    np.testing.assert_allclose(found[:180], np.sin(angles), atol=np.radians(0.7))


@pytest.mark.parametrize("noise_deg", [0.05, 0.5, 2.0])
def test_log_odds_are_those_of_the_twin_in_numpy(noise_deg):
    scene = two_view_scene(5, num_matches=333, outlier_ratio=0.4, noise_deg=noise_deg)
    pose = unit_pose(scene)
    options = {
        "scale": np.radians(noise_deg),
        "shares": np.array([0.4, 0.1, 0.1, 0.1]),
        "outlier_density": TYPICAL_DENSITY,
        "depth_tolerance": 0.02,
    }
    native = internals.log_odds_over_chance(
        scene.bearings1,
        scene.bearings2,
        np.ascontiguousarray(pose.rotation),
        np.ascontiguousarray(pose.translation),
        **options | {"shares": list(options["shares"])},
    )
    expected = log_odds_over_chance(pose, scene.bearings1, scene.bearings2, **options)
    assert native == pytest.approx(expected, rel=1e-9)


def test_matches_that_chance_makes_say_nothing_for_a_pose_with_as_much_noise():
    # All partners lie a degree off, in random directions: any pose with this rotation agrees.
    rng = np.random.default_rng(6)
    pose = Pose(np.eye(3), unit(rng.normal(size=3)))
    b1 = unit(rng.normal(size=(400, 3)))
    b2 = displaced(b1, np.radians(1.0), rng)
    options = {"shares": np.array([0.9, 0.0, 0.0, 0.0]), "outlier_density": TYPICAL_DENSITY}
    log_odds = log_odds_over_chance(
        pose, b1, b2, scale=np.radians(0.7), depth_tolerance=0.05, **options
    )
    assert log_odds < 0.8 * len(b1)  # one density for all would say 4.3 a match


@pytest.mark.parametrize("max_noise_deg", [None, 0.5])
def test_a_sharp_pose_is_found_beside_a_blurred_one_that_agrees_with_more(max_noise_deg):
    num_right = 0
    for seed in range(24):
        b1, b2, scene = somebody_walks_ahead(seed)
        result = estimate_relative_pose(b1, b2, seed=seed, max_noise_deg=max_noise_deg)
        if not result.success:
            continue
        error_deg = max(errors_deg(result.cam2_from_cam1, unit_pose(scene)))
        assert error_deg < 5.0  # of one that is blurred 3.6
        num_right += error_deg < 0.5
    # It is 18 and 24; where wrong matches have one density, and the search ends with what most
    # agree with, none is.
    assert num_right >= (16 if max_noise_deg is None else 23)


def test_a_pose_with_more_noise_than_key_points_have_does_not_end_the_search():
    num_right, most = 0, 0
    for seed in range(12):
        b1, b2, scene = somebody_walks_ahead(seed, num_right=150, num_wrong=300)
        told = estimate_relative_pose(b1, b2, seed=seed, max_noise_deg=0.5)
        num_right += told.success and max(errors_deg(told.cam2_from_cam1, unit_pose(scene))) < 2.0
        most = max(most, told.num_iterations)
    assert num_right >= 11  # none where the search ends with what it believes by then
    assert most > 200
