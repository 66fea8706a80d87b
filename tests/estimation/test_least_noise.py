# SPDX-License-Identifier: BSD-3-Clause
"""`min_noise_deg`: a few matches that agree too well to be measured do so by chance."""

import numpy as np
import pytest

from epi360 import estimate_relative_pose, estimate_relative_poses, rotation_error_deg
from epi360.estimation.image_matches import IMAGE_OPTIONS, noise_of_keypoints
from epi360.synthetic import two_view_scene

PIXEL_DEG = 360.0 / 1024
NOISE = noise_of_keypoints(PIXEL_DEG)
NUM_WRONG, NUM_COPIES, NUM_TRIALS = 80, 5, 20


def wrong_matches_with_a_pole(seed):
    """Matches that have nothing in common, and a key point straight down, five times."""
    rng = np.random.default_rng(seed)
    pole = np.tile([0.0, 1.0, 0.0], (NUM_COPIES, 1))
    views = [np.concatenate([rng.normal(size=(NUM_WRONG, 3)), pole]) for _ in range(2)]
    return tuple(view / np.linalg.norm(view, axis=1, keepdims=True) for view in views)


@pytest.fixture(scope="module")
def pairs():
    return [wrong_matches_with_a_pole(seed) for seed in range(NUM_TRIALS)]


def probabilities(pairs, **noise):
    results = estimate_relative_poses(pairs, options=IMAGE_OPTIONS, seed=1, **noise)
    assert not any(result.success for result in results)
    return [result.probability for result in results]


def test_no_pose_of_wrong_matches_is_probable_for_a_key_point_that_is_there_five_times(pairs):
    assert max(probabilities(pairs, **NOISE)) < 0.3
    without = probabilities(pairs, max_noise_deg=NOISE["max_noise_deg"])
    assert min(without) > 0.3  # what it is there for


def test_one_for_each_pair_is_the_same(pairs):
    each = {name: [value] * NUM_TRIALS for name, value in NOISE.items()}
    assert probabilities(pairs, **each) == probabilities(pairs, **NOISE)


def test_a_pose_of_many_matches_stays_to_the_last_digit():
    scene = two_view_scene(3, noise_deg=0.2 * PIXEL_DEG, noise_in_both_views=True)
    without, with_least = (
        estimate_relative_pose(scene.bearings1, scene.bearings2, **known)
        for known in ({}, {"min_noise_deg": NOISE["min_noise_deg"]})
    )
    assert with_least.success and with_least.noise_deg == without.noise_deg
    poses = [each.cam2_from_cam1.matrix() for each in (without, with_least)]
    np.testing.assert_array_equal(*poses)


def test_exact_matches_are_as_uncertain_as_bearings_with_that_noise():
    scene = two_view_scene(3, num_matches=200, noise_deg=0.0)
    result = estimate_relative_pose(scene.bearings1, scene.bearings2, min_noise_deg=0.1)
    assert result.success and rotation_error_deg(result.cam2_from_cam1, scene.cam2_from_cam1) < 1e-3
    assert result.noise_deg < 1e-6  # what the inliers show
    noisy = two_view_scene(3, num_matches=200, noise_deg=0.1, noise_in_both_views=True)
    expected = estimate_relative_pose(noisy.bearings1, noisy.bearings2)
    assert result.rotation_sigma_deg == pytest.approx(expected.rotation_sigma_deg, rel=0.3)
    assert result.inlier_threshold_deg == pytest.approx(expected.inlier_threshold_deg, rel=0.3)


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan, np.inf, "little"])
def test_a_least_noise_that_is_no_positive_number_is_refused(pairs, limit):
    with pytest.raises(ValueError, match="min_noise_deg must be a positive number"):
        estimate_relative_pose(*pairs[0], min_noise_deg=limit)


def test_what_is_wrong_with_both_limits_is_said(pairs):
    with pytest.raises(ValueError, match="min_noise_deg must be smaller than max_noise_deg, got 2"):
        estimate_relative_pose(*pairs[0], min_noise_deg=2.0, max_noise_deg=1.0)
    with pytest.raises(ValueError, match="min_noise_deg must be one for each of 2 pairs, got 1"):
        estimate_relative_poses(pairs[:2], min_noise_deg=[0.1])
