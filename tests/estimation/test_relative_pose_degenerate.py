# SPDX-License-Identifier: BSD-3-Clause
"""Inputs at the edge of what two views can say: exact status, finite numbers, no claims."""

import numpy as np
import pytest

from epi360 import Pose, RansacOptions, estimate_relative_pose, refine_pose
from epi360.cameras import Equirectangular
from epi360.features import extract_features


@pytest.mark.parametrize("eps", [0.0, 1e-12, 1e-8, 1e-6])
@pytest.mark.parametrize("seed", range(20))
def test_bearings_of_a_hundredth_degree_claim_no_translation(seed, eps):
    rng = np.random.default_rng(seed)
    b = np.array([0.0, 0.0, 1.0]) + rng.normal(size=(40, 3)) * [1e-4, 1e-4, 0.0]
    result = estimate_relative_pose(b, b + eps * rng.normal(size=b.shape))
    assert not result.success
    assert np.isnan(result.cam2_from_cam1.translation).all()


@pytest.mark.parametrize("residual", ["sampson", "angular", "paper"])
@pytest.mark.parametrize("num_matches", [31, 32, 33, 100])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_motion_along_an_axis_without_turning_is_like_any_other(residual, num_matches, axis, sign):
    t = sign * np.eye(3)[axis]
    points = 3.0 * np.random.default_rng(num_matches).normal(size=(num_matches, 3))
    result = estimate_relative_pose(points, points + t, residual=residual)
    assert result.success and np.isfinite(result.covariance).all()
    np.testing.assert_allclose(result.cam2_from_cam1.translation, t, atol=1e-6)
    noise = 1e-3 * np.random.default_rng(0).normal(size=points.shape)
    refined = refine_pose(points, points + t + noise, Pose(np.eye(3), t), residual)
    assert refined.converged and np.isfinite(refined.covariance).all()


@pytest.mark.parametrize("seed", range(20))
def test_a_match_at_the_epipole_changes_nothing(seed):
    t = np.array([0.0, 0.6, 0.8])
    points = 3.0 * np.random.default_rng(seed).normal(size=(50, 3))
    b1, b2 = np.vstack([points, t]), np.vstack([points + t, t])
    result = estimate_relative_pose(b1, b2)
    assert result.success and np.isfinite(result.covariance).all()
    assert result.noise_deg < 1e-6
    np.testing.assert_allclose(result.cam2_from_cam1.translation, t, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_a_logo_at_the_nadir_is_no_pure_rotation(seed):
    rng = np.random.default_rng(seed)
    logo = np.array([0.0, 1.0, 0.0]) + 0.05 * rng.normal(size=(60, 3))
    b1, b2 = (np.vstack([logo, rng.normal(size=(200, 3))]) for _ in range(2))
    result = estimate_relative_pose(b1, b2)
    assert result.status == "concentrated_inliers"
    assert np.isnan(result.cam2_from_cam1.rotation).all()


@pytest.mark.parametrize("half_angle_deg", [5.0, 15.0, 30.0])
def test_random_matches_of_a_narrow_lens_are_refused(half_angle_deg):
    width = np.tan(np.radians(half_angle_deg))
    for seed in range(6):
        rng = np.random.default_rng(seed)
        b1, b2 = (np.c_[rng.uniform(-width, width, (300, 2)), np.ones(300)] for _ in range(2))
        assert estimate_relative_pose(b1, b2).status == "too_few_inliers"


def test_a_numpy_integer_is_a_seed():
    points = np.random.default_rng(0).normal(size=(20, 3))
    a = estimate_relative_pose(points, points + [1, 0, 0], seed=np.int64(5))
    b = estimate_relative_pose(points, points + [1, 0, 0], seed=5)
    np.testing.assert_array_equal(a.covariance, b.covariance)


def test_a_panorama_of_a_few_rows_has_no_features():
    camera = Equirectangular(1024, 14, vertical_fov_deg=4.92)
    assert len(extract_features(np.zeros((14, 1024), np.uint8), camera)) == 0


def test_a_turn_seen_only_along_one_axis_is_not_taken_for_known():
    rng = np.random.default_rng(0)
    ahead = np.column_stack([rng.uniform(-1e-9, 1e-9, (60, 2)), np.ones(60)])
    ahead[30:] *= -1.0  # two opposite points: the angle about their axis is free
    b1 = ahead + 1e-6 * rng.normal(size=ahead.shape)
    b2 = ahead + 1e-6 * rng.normal(size=ahead.shape)
    for pair in ((b1, b2), (ahead, ahead)):
        result = estimate_relative_pose(*pair)
        assert result.status not in ("ok", "pure_rotation")


def test_a_refused_rotation_has_no_probability_of_a_pose_and_its_own_noise():
    rng = np.random.default_rng(7)
    b1 = rng.normal(size=(12, 3))
    b1 /= np.linalg.norm(b1, axis=1, keepdims=True)
    b2 = b1 + 1e-3 * rng.normal(size=b1.shape)
    turned = estimate_relative_pose(b1, b2, residual="angular")
    refused = estimate_relative_pose(
        b1, b2, residual="angular", options=RansacOptions(min_num_inliers=50)
    )
    assert turned.status == "pure_rotation" and refused.status == "too_few_inliers"
    assert refused.noise_deg == turned.noise_deg and refused.probability == 0.0
