# SPDX-License-Identifier: BSD-3-Clause
"""Types of the native module. Shapes and values are checked by the callers."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

class _RobustResult(TypedDict):
    status: int
    rotation: _Array
    translation: _Array
    scale: float
    threshold: float
    inlier: NDArray[np.uint8]
    residuals: _Array
    num_iterations: int
    parallax: float
    coverage: float
    match_coverage: float
    rotation_share: float
    rival_share: float
    rival_evidence: float
    chance_log10: float
    covariance: _Array
    alternatives: list[tuple[_Array, _Array]]

def five_point(bearings1: _Array, bearings2: _Array) -> list[_Array]: ...
def eight_point(bearings1: _Array, bearings2: _Array, weights: _Array | None = None) -> _Array: ...
def pose_from_essential(
    E: _Array, bearings1: _Array, bearings2: _Array
) -> tuple[_Array, _Array]: ...
def residuals(
    bearings1: _Array,
    bearings2: _Array,
    rotation: _Array,
    translation: _Array,
    kind: str,
    jacobians1: _Array | None = None,
    jacobians2: _Array | None = None,
) -> tuple[_Array, _Array]: ...
def refine(
    bearings1: _Array,
    bearings2: _Array,
    rotation: _Array,
    translation: _Array,
    *,
    residual: str,
    loss: str,
    scale: float,
    weights: _Array | None,
    jacobians1: _Array | None,
    jacobians2: _Array | None,
    max_iterations: int,
) -> tuple[_Array, _Array, _Array, float, _Array, float, float, float, int, bool]: ...
def estimate_relative_pose(
    bearings1: _Array,
    bearings2: _Array,
    *,
    residual: str,
    threshold_rad: float,
    sample_size: int,
    min_iterations: int,
    max_iterations: int,
    confidence: float,
    seed: int,
    weights: _Array | None,
    jacobians1: _Array | None,
    jacobians2: _Array | None,
) -> _RobustResult: ...
def paper_pose(
    bearings1: _Array,
    bearings2: _Array,
    method: str,
    sk_search: str = "line",
    parameterization: str = "manifold",
) -> tuple[_Array, _Array, float, float, float, int, int, bool]: ...
def solve_linear(
    bearings1: _Array,
    bearings2: _Array,
    normalization: str,
    taubin: bool = False,
    S: float = 1.0,
    K: float = 1.0,
    weights: _Array | None = None,
) -> tuple[_Array, _Array, _Array]: ...
def search_sk(
    bearings1: _Array, bearings2: _Array, sk_search: str, weights: _Array | None = None
) -> tuple[float, float, float, int]: ...
