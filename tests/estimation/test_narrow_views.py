# SPDX-License-Identifier: BSD-3-Clause
"""Narrow views with much noise: false parallax, and depths that noise hides."""

import numpy as np
from noisy_problems import errors_deg, unit_pose

from epi360 import _core, estimate_relative_pose
from epi360.epipolar.residuals import pose_residuals, residual_jacobians
from epi360.estimation.testimony_reference import LARGEST_WRONG_PARALLAX, in_front
from epi360.synthetic import two_view_scene


def cone(seed):
    """A cone of 30 degrees with 2.6 degrees of noise and 30 % of outliers."""
    return two_view_scene(
        seed,
        num_matches=400,
        layout="cone",
        cone_half_angle_deg=30.0,
        kappa=500.0,
        outlier_ratio=0.3,
    )


def test_a_narrow_view_with_much_noise_and_outliers_keeps_its_rotation():
    # Turning along the epipolar planes hardly changes a residual; large false parallax must not win
    # by its depths.
    scenes = [cone(seed) for seed in range(24)]
    results = [estimate_relative_pose(s.bearings1, s.bearings2) for s in scenes]
    errors = [
        errors_deg(result.cam2_from_cam1, unit_pose(scene))[0]
        for result, scene in zip(results, scenes, strict=True)
        if result.status in ("ok", "planar_ambiguous")
    ]
    assert len(errors) > 21  # measured: 24
    # Measured 1.6, worst 4.6; a pose with false parallax is off by some 30 degrees.
    assert np.median(errors) < 3.0
    assert np.max(errors) < 10.0


def step_of_expectation_maximisation(pose, b1, b2):
    """Length in standard deviations, under one Gaussian and the density of a narrow view."""
    density = _core.internals.density_in_view(b1, b2)
    residuals = pose_residuals(pose, b1, b2)
    share, scale = 0.7, np.radians(2.0)
    for _ in range(200):
        front = in_front(pose, b1, b2, min(3.0 * scale, LARGEST_WRONG_PARALLAX))
        right = share * np.exp(-0.5 * (residuals / scale) ** 2) / (np.sqrt(2.0 * np.pi) * scale)
        weights = right * front / (right * front + (1.0 - share) * density)
        share = weights.mean()
        scale = np.sqrt(weights @ residuals**2 / (weights.sum() - 5.0))
    J = residual_jacobians(pose, b1, b2)
    gradient = J.T @ (weights * residuals)
    return np.sqrt(gradient @ np.linalg.solve((J * weights[:, None]).T @ J, gradient)) / scale


def test_depths_that_noise_hides_do_not_hold_a_pose_back():
    # A step that makes some matches change sides is no worse for it: at the end expectation
    # maximisation, here written out in NumPy, has nothing left to gain.
    steps = []
    for seed in range(80):
        scene = cone(seed)
        result = estimate_relative_pose(scene.bearings1, scene.bearings2)
        if result.success:
            pose = result.cam2_from_cam1
            steps.append(step_of_expectation_maximisation(pose, scene.bearings1, scene.bearings2))
    assert len(steps) > 70
    assert np.median(steps) < 1e-2
    # The others were released from their depths, or their mixture kept its wider parts. It was 0.76
    # where the depths of a trial could refuse a step.
    assert np.mean(np.array(steps) < 0.05) > 0.87  # measured: 0.95
