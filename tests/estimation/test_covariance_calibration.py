# SPDX-License-Identifier: BSD-3-Clause
"""The covariance predicts the errors of 0.1 degrees of noise, and those of little parallax."""

import numpy as np
import pytest
from noisy_problems import normalised_squared_error, unit_pose

from epi360 import estimate_relative_poses
from epi360.synthetic import two_view_scene


@pytest.mark.parametrize("outliers", [0.0, 0.2, 0.5])
def test_covariance_predicts_the_errors_of_precise_matches(outliers):
    scenes = [
        two_view_scene(seed, num_matches=400, noise_deg=0.1, outlier_ratio=outliers)
        for seed in range(150)
    ]
    results = estimate_relative_poses((s.bearings1, s.bearings2) for s in scenes)
    assert all(result.success for result in results)
    ratios = [
        normalised_squared_error(result.cam2_from_cam1, result.covariance, unit_pose(scene))
        for result, scene in zip(results, scenes, strict=True)
    ]
    # The mean of 150 chi-squares over 5 has a standard deviation of 0.05; measured 0.98, 0.96,
    # 0.98 at 0, 20 and 50 % outliers.
    assert 0.85 < np.mean(ratios) < 1.2


def test_a_direction_from_little_parallax_comes_with_its_error():
    scenes = [
        two_view_scene(seed, num_matches=400, kappa=500.0, baseline_m=0.3) for seed in range(80)
    ]
    results = estimate_relative_poses((s.bearings1, s.bearings2) for s in scenes)
    ratios = [
        normalised_squared_error(result.cam2_from_cam1, result.covariance, unit_pose(scene))
        for result, scene in zip(results, scenes, strict=True)
        if result.success
    ]
    # Parallax of two to three times the noise. Measured 1.22, and 1.52 if what the noise of the
    # derivatives costs is left out.
    assert len(ratios) > 70 and 0.8 < np.mean(ratios) < 1.4


@pytest.mark.parametrize(
    ("options", "num_scenes", "most"),
    [
        # Measured 0.91 and 1.82; if all inliers are believed, 1.23 and 3.64.
        ({"num_matches": 400, "kappa": 500.0, "outlier_ratio": 0.5}, 80, 1.1),
        # A step of 5 cm: wrong matches among the inliers have most of the parallax.
        (
            {"num_matches": 6000, "noise_deg": 0.1, "baseline_m": 0.05, "outlier_ratio": 0.5},
            16,
            2.7,
        ),
    ],
)
def test_wrong_matches_among_the_inliers_do_not_make_a_pose_surer(options, num_scenes, most):
    scenes = [two_view_scene(seed, **options) for seed in range(num_scenes)]
    results = estimate_relative_poses((s.bearings1, s.bearings2) for s in scenes)
    ratios = [
        normalised_squared_error(result.cam2_from_cam1, result.covariance, unit_pose(scene))
        for result, scene in zip(results, scenes, strict=True)
        if result.success
    ]
    assert len(ratios) >= 0.95 * num_scenes
    assert np.mean(ratios) < most
