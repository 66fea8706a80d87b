# SPDX-License-Identifier: BSD-3-Clause
"""Types of the native module. Shapes and values are checked by the callers."""

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

# status, rotation, translation, scale, threshold, inlier, residuals, num_iterations, parallax,
# coverage, match_coverage, covariance, alternatives, num_usable, num_distinct, spread,
# spread_of_matches, translation_basis, seconds
_PairResult = tuple[
    int,
    _Array,
    _Array,
    float,
    float,
    NDArray[np.uint8],
    _Array,
    int,
    float,
    float,
    float,
    _Array,
    list[tuple[_Array, _Array]],
    int,
    int,
    float,
    float,
    _Array,
    float,
]

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
def estimate_relative_poses(
    bearings1: list[_Array],
    bearings2: list[_Array],
    *,
    residual: str,
    threshold: float,
    threshold_in_pixels: bool,
    sample_size: int,
    min_iterations: int,
    max_iterations: int,
    confidence: float,
    seed: int | list[int],  # one for all pairs, or one for each
    num_threads: int,
    weights: list[_Array],
    scores: list[_Array],
    jacobians1: list[_Array],
    jacobians2: list[_Array],
    gravity1: list[_Array],
    gravity2: list[_Array],
) -> list[_PairResult] | tuple[int, int, int, bool]: ...
def upright_three_point(
    bearings1: _Array, bearings2: _Array, gravity1: _Array, gravity2: _Array
) -> list[tuple[_Array, _Array]]: ...
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
