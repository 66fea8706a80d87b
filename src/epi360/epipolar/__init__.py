# SPDX-License-Identifier: BSD-3-Clause
"""Bearings to essential matrix, in plain NumPy: the readable twin of the native core."""

from epi360.epipolar.essential import (
    cheirality_mask,
    decompose_essential,
    essential_from_pose,
    pose_from_essential,
    project_to_essential,
    triangulate,
)
from epi360.epipolar.linear import EightPointSolution, eight_point, observation_matrix
from epi360.epipolar.normalization import (
    NORMALIZATIONS,
    isotropic_normalizer,
    non_isotropic_normalizer,
    normalizers,
    sk_normalizer,
)
from epi360.epipolar.residuals import (
    RESIDUALS,
    angular_residuals,
    paper_residuals,
    pose_residuals,
    residual_jacobians,
    sampson_residuals,
    solarte2021_residuals,
    tangent_basis,
    tangent_sampson_residuals,
)
from epi360.epipolar.sk_search import SK_SEARCHES, SkCost, search_sk
from epi360.epipolar.stability import Stability, stability
from epi360.epipolar.upright import upright_three_point

__all__ = [
    "NORMALIZATIONS", "RESIDUALS", "SK_SEARCHES", "EightPointSolution", "SkCost", "Stability",
    "angular_residuals", "cheirality_mask", "decompose_essential", "eight_point",
    "essential_from_pose", "isotropic_normalizer", "non_isotropic_normalizer", "normalizers",
    "observation_matrix", "paper_residuals", "pose_from_essential", "pose_residuals",
    "project_to_essential", "residual_jacobians", "sampson_residuals", "search_sk", "sk_normalizer",
    "solarte2021_residuals", "stability", "tangent_basis", "tangent_sampson_residuals",
    "triangulate", "upright_three_point",
]  # fmt: skip
