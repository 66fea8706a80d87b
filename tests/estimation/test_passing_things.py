# SPDX-License-Identifier: BSD-3-Clause
"""A small step past a tram: the direction of what surrounds the camera is named, too."""

import numpy as np
import pytest

from epi360 import (
    Pose,
    RansacOptions,
    estimate_relative_pose,
    estimate_relative_poses,
    rotation_error_deg,
    translation_error_deg,
)
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.result import MISSING_MATCHES
from epi360.poses import rotation_from_vector

NOISE_RAD = np.radians(0.056)
TURN = rotation_from_vector([0.02, 0.3, -0.01])
NUM_STILL, NUM_WRONG = 300, 40


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def past_a_tram(seed, num_tram, step_m=0.04):
    """Bearings in both views, and the pose: still things all around, a tram and wrong matches."""
    rng = np.random.default_rng(seed)
    directions = unit(rng.normal(size=(NUM_STILL, 3)))
    walls = np.min([8.0, 2.5, 10.0] / np.abs(directions), axis=1, keepdims=True)
    still = directions * walls * rng.uniform(0.6, 1.0, (NUM_STILL, 1))
    tram = rng.uniform([-6.0, -2.0, 4.0], [6.0, 1.5, 4.3], (num_tram, 3))
    step = np.array([0.0, 0.0, step_m])
    second = np.concatenate([still - step, tram + [0.6, 0.0, 0.0] - step]) @ TURN.T
    views = []
    for points in (np.concatenate([still, tram]), second):
        bearings = np.concatenate([unit(points), unit(rng.normal(size=(NUM_WRONG, 3)))])
        views.append(unit(bearings + rng.normal(0.0, NOISE_RAD, bearings.shape)))
    return *views, Pose(TURN, -TURN @ step)


@pytest.mark.parametrize("options", [RansacOptions(), IMAGE_OPTIONS])
@pytest.mark.parametrize("seed", range(6))
def test_both_directions_are_named_first_that_of_what_surrounds_the_camera(options, seed):
    b1, b2, pose = past_a_tram(seed, 220)
    result = estimate_relative_pose(b1, b2, options=options, seed=seed)
    if result.status == "pure_rotation":  # a step of five times the noise
        assert rotation_error_deg(result.cam2_from_cam1, pose) < 1.0
        return
    assert result.status == "planar_ambiguous" and result.probability <= 0.5
    assert rotation_error_deg(result.cam2_from_cam1, pose) < 0.3
    error = translation_error_deg(result.cam2_from_cam1, pose)
    assert error < max(10.0, 4.0 * result.translation_sigma_deg)
    assert translation_error_deg(result.alternatives[0], pose) > 60.0
    assert "220 matches on one side of the camera moved much more" in result.warnings[-1]
    assert not any(MISSING_MATCHES in each for each in result.warnings)
    assert not result.inlier_mask[NUM_STILL : NUM_STILL + 220].any()
    assert len(result.residuals_rad) == len(b1)


def test_some_are_named_at_all():
    statuses = [
        estimate_relative_pose(*past_a_tram(seed, 220)[:2], seed=seed).status for seed in range(6)
    ]
    assert statuses.count("planar_ambiguous") >= 4


@pytest.mark.parametrize(("num_tram", "step_m"), [(220, 0.4), (60, 0.06), (0, 0.06)])
def test_a_larger_step_or_a_smaller_tram_leaves_the_pose_alone(num_tram, step_m):
    for seed in range(4):
        b1, b2, pose = past_a_tram(seed, num_tram, step_m)
        result = estimate_relative_pose(b1, b2, seed=seed)
        assert result.status == "ok"
        error = translation_error_deg(result.cam2_from_cam1, pose)
        assert error < max(2.0, 4.0 * result.translation_sigma_deg)


def test_many_pairs_are_told_the_same():
    made = [past_a_tram(seed, 220)[:2] for seed in range(4)]
    together = estimate_relative_poses(made, seed=3, num_threads=2)
    for pair, result in zip(made, together, strict=True):
        alone = estimate_relative_pose(*pair, seed=3)
        assert alone.status == result.status and alone.warnings == result.warnings
        np.testing.assert_array_equal(alone.cam2_from_cam1.matrix(), result.cam2_from_cam1.matrix())
