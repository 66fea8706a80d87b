# SPDX-License-Identifier: BSD-3-Clause
"""Matches with known truth: landmarks seen from two views, with noise and outliers."""

from epi360.synthetic.depth_landmarks import landmarks_from_depth
from epi360.synthetic.disturbances import add_metric_noise, replace_with_outliers
from epi360.synthetic.landmarks import (
    TwoViewScene,
    sample_relative_pose,
    scene_from_points,
    two_view_scene,
)
from epi360.synthetic.von_mises_fisher import (
    kappa_from_mean_angle_deg,
    mean_angle_deg_from_kappa,
    noise_deg_from_kappa,
    sample_von_mises_fisher,
)

__all__ = [
    "TwoViewScene", "add_metric_noise", "kappa_from_mean_angle_deg", "landmarks_from_depth",
    "mean_angle_deg_from_kappa", "noise_deg_from_kappa", "replace_with_outliers",
    "sample_relative_pose", "sample_von_mises_fisher", "scene_from_points", "two_view_scene",
]  # fmt: skip
