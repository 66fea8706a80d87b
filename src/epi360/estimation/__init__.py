# SPDX-License-Identifier: BSD-3-Clause
"""Bearings to pose: refinement, the robust estimator and its verdict."""

from epi360.estimation.refinement import RefinementResult, refine_pose, refine_pose_reference
from epi360.estimation.result import ImagePairResult, RelativePoseResult, Status
from epi360.estimation.robust import RansacOptions, estimate_relative_pose

__all__ = [
    "ImagePairResult",
    "RansacOptions",
    "RefinementResult",
    "RelativePoseResult",
    "Status",
    "estimate_relative_pose",
    "refine_pose",
    "refine_pose_reference",
]
