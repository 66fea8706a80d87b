# SPDX-License-Identifier: BSD-3-Clause
"""The paper's methods by name under a protocol, and their errors."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import essential_from_pose
from epi360.estimation.linear import eight_point
from epi360.estimation.paper import paper_pose
from epi360.estimation.refinement import refine_pose
from epi360.estimation.weights import residual_weights
from epi360.poses import Pose, rotation_error_deg, translation_error_deg
from epi360_paper.paper_ransac import essential_residuals
from epi360_paper.protocols import Protocol

Array = NDArray[np.float64]

# The five of Fig. 4 and Tables 3 and 4, with the names that the paper gives them.
METHODS = ("8pa", "opt_sk", "gsm", "gsm_w_xi", "gsm_w_sk")
TITLES = {
    "8pa": "8-PA",
    "opt_sk": "Opt ε(S, K)",
    "gsm": "GSM",
    "gsm_w_xi": "ω_ξ",
    "gsm_w_sk": "ω_SK",
}
# The same names for figures, which set mathematics.
LEGENDS = {
    **TITLES,
    "opt_sk": r"Opt $\epsilon(S, K)$",
    "gsm_w_xi": r"$\omega_\xi$",
    "gsm_w_sk": r"$\omega_{SK}$",
}


def estimate_pose(method: str, bearings1: Array, bearings2: Array, protocol: Protocol) -> Pose:
    """Pose by one of the paper's methods, with the details of the protocol."""
    if len(bearings1) < 8:
        return Pose.nan()
    if protocol.weight_residual == "solarte2021" and method in ("gsm_w_xi", "gsm_w_sk"):
        return _weighted_as_published(method, bearings1, bearings2, protocol)
    return paper_pose(
        bearings1,
        bearings2,
        method=method,
        sk_search=protocol.sk_search,
        parameterization=protocol.parameterization,
    )


def pose_errors(estimate: Pose, truth: Pose) -> tuple[float, float]:
    """Errors of rotation and translation by eq. 16: angles as shares of half a turn."""
    return (
        rotation_error_deg(estimate, truth) / 180.0,
        translation_error_deg(estimate, truth) / 180.0,
    )


def method_errors(
    methods: Sequence[str], bearings1: Array, bearings2: Array, truth: Pose, protocol: Protocol
) -> dict[str, float]:
    """Errors of several methods on the same matches, as columns of a row."""
    columns = {}
    for method in methods:
        pose = estimate_pose(method, bearings1, bearings2, protocol)
        columns[f"rotation_{method}"], columns[f"translation_{method}"] = pose_errors(pose, truth)
    return columns


def _weighted_as_published(method: str, b1: Array, b2: Array, protocol: Protocol) -> Pose:
    """Weighted GSM with the weights of the authors' code."""
    # Their residuals have no sign and are divided by one norm of the whole array.
    normalized = method == "gsm_w_sk"
    start = estimate_pose("opt_sk" if normalized else "8pa", b1, b2, protocol)
    E = eight_point(b1, b2, normalization="sk").E if normalized else essential_from_pose(start)
    weights = residual_weights(essential_residuals(E, b1, b2, "solarte2021"), kind="gaussian")
    # Over the manifold, natively: xi in se(3) has the same minimum.
    return refine_pose(b1, b2, start, residual="paper", weights=weights).pose
