# SPDX-License-Identifier: BSD-3-Clause
"""Matched bearings to a robust pose, its uncertainty and its verdict: python 02_matches_to_pose.py.

Put your own matches in place of the synthetic ones: two (N, 3) arrays, row i of both is one match,
from any camera (``camera.bearings_from_pixels(pixels)``).
"""

import numpy as np

import epi360
from epi360.synthetic import TwoViewScene, two_view_scene


def show(title: str, scene: TwoViewScene) -> None:
    """Estimate and print what is known, and nothing else."""
    result = epi360.estimate_relative_pose(scene.bearings1, scene.bearings2, seed=0)
    print(f"\n{title}\n  status       {result.status}")
    for warning in result.warnings:
        print(f"  warning      {warning}")
    if result.success:
        print(f"  probability  {result.probability:.3f} that the pose is right")

    pose, truth = result.cam2_from_cam1, scene.cam2_from_cam1
    sigma_deg = np.degrees(np.sqrt(np.diag(result.covariance)))  # three of R, two of t
    # What the matches do not determine is NaN, never a number that looks like an answer.
    if np.isfinite(pose.rotation).all():
        error = epi360.rotation_error_deg(pose, truth)
        print(f"  rotation     error {error:.3f} deg, 1 sigma {np.hypot.reduce(sigma_deg[:3]):.3f}")
    if np.isfinite(pose.translation).all():
        error = epi360.translation_error_deg(pose, truth)
        print(f"  translation  error {error:.3f} deg, 1 sigma {np.hypot.reduce(sigma_deg[3:]):.3f}")
        print(f"  direction    t = {pose.translation.round(4)}, |t| = 1: two views fix no scale")
    if result.inlier_mask.any():
        wrong = np.count_nonzero(result.inlier_mask & ~scene.inlier_mask)
        print(f"  inliers      {result.inlier_mask.sum()} of {len(scene.points)}, {wrong} wrong")


def main() -> None:
    """Show three problems: a good one, a camera that only turned, and nothing but wrong matches."""
    noise = {"noise_deg": 0.1, "noise_in_both_views": True}
    show("400 matches, 40 % wrong", two_view_scene(1, num_matches=400, outlier_ratio=0.4, **noise))
    show("the camera only turned", two_view_scene(2, baseline_m=0.0, **noise))
    show("nothing but wrong matches", two_view_scene(3, outlier_ratio=1.0, **noise))


if __name__ == "__main__":
    main()
