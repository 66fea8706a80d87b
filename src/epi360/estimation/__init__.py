# SPDX-License-Identifier: BSD-3-Clause
"""Bearings to pose: refinement, the robust estimator and its verdict."""

from epi360.estimation.absolute_pose import estimate_absolute_pose
from epi360.estimation.absolute_result import AbsolutePoseResult
from epi360.estimation.linear import eight_point
from epi360.estimation.options import RansacOptions
from epi360.estimation.paper import paper_pose
from epi360.estimation.paper_reference import PAPER_METHODS, paper_pose_reference
from epi360.estimation.refinement import RefinementResult, refine_pose, refine_pose_reference
from epi360.estimation.result import (
    Explanations,
    ImagePairResult,
    RelativePoseResult,
    SamePlace,
    Status,
)
from epi360.estimation.robust import estimate_relative_pose, estimate_relative_poses
from epi360.estimation.weights import residual_weights

__all__ = [
    "PAPER_METHODS",
    "AbsolutePoseResult",
    "Explanations",
    "ImagePairResult",
    "RansacOptions",
    "RefinementResult",
    "RelativePoseResult",
    "SamePlace",
    "Status",
    "eight_point",
    "estimate_absolute_pose",
    "estimate_relative_pose",
    "estimate_relative_poses",
    "paper_pose",
    "paper_pose_reference",
    "refine_pose",
    "refine_pose_reference",
    "residual_weights",
]
