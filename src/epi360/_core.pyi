# SPDX-License-Identifier: BSD-3-Clause
"""Types of the native module. Shapes and values are checked by the callers."""

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.result import Status

_Array = NDArray[np.float64]
_Floats = NDArray[np.float32]
_Cells = NDArray[np.int32]
_AngleModel = tuple[str, float, float]

def find_sift(
    picture: NDArray[np.uint8], mask: NDArray[np.uint8] | None, contrast_threshold: float
) -> tuple[_Array, NDArray[np.uint8]]: ...
def grow_surfaces(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    rotation: _Array,
    translation: _Array,
    directions: _Floats,
    neighbours: _Cells,
    around: _Cells,
    seed_cells: _Cells,
    seed_depths: _Floats,
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, _Floats]: ...
def surface_likeness(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    rotation: _Array,
    translation: _Array,
    directions: _Floats,
    depths: _Floats,
    normals: _Floats,
) -> _Floats: ...
def two_nearest(
    queries: NDArray[np.float32], targets: NDArray[np.float32]
) -> (
    tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]] | None
): ...
def fit_angle_changes(
    bearings1: _Array,
    bearings2: _Array,
    model1: _AngleModel,
    model2: _AngleModel,
    is_one_camera: bool,
    rotation: _Array,
    translation: _Array,
    changes: _Array,
    noise: float,
) -> tuple[
    _Array, _Array, _Array, float, _Array, _Array, tuple[_Array, _Array], tuple[_Array, _Array]
]: ...
def changed_by_a_turn(
    bearings1: _Array,
    bearings2: _Array,
    model1: _AngleModel,
    model2: _AngleModel,
    is_one_camera: bool,
    rotation: _Array,
    noise: float,
) -> _Array | None: ...
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

class Warning:
    @property
    def code(self) -> str: ...
    @property
    def value(self) -> float: ...
    @property
    def reference(self) -> float: ...

class Pair:
    def __init__(
        self,
        bearings1: _Array,
        bearings2: _Array,
        *,
        weights: _Array | None = None,
        scores: _Array | None = None,
        jacobians1: _Array | None = None,
        jacobians2: _Array | None = None,
        gravity1: _Array | None = None,
        gravity2: _Array | None = None,
        gravity_sigma: float = 0.0,  # radians, as is the next; 0 is any elevation
        elevation_sigma: float = 0.0,
        seed: int = 0,
        min_noise: float = 0.0,  # radians, as is the next; 0 is no limit
        max_noise: float = 0.0,
    ) -> None: ...

class Explanations:
    @property
    def nothing(self) -> float: ...
    @property
    def rotation(self) -> float: ...
    @property
    def surface(self) -> float: ...
    @property
    def motion(self) -> float: ...
    @property
    def rival(self) -> float: ...

class PairResult:  # angles in radians; the arrays are views
    @property
    def probability(self) -> float: ...
    @property
    def explanations(self) -> Explanations: ...
    @property
    def evidence(self) -> internals.Evidence: ...  # for tests
    @property
    def noise(self) -> float: ...  # of the bearings, per axis and view
    @property
    def log_ratio(self) -> float: ...
    @property
    def regional_sigma(self) -> float: ...
    @property
    def rotation_rejection(self) -> float: ...
    @property
    def status(self) -> Status: ...
    @property
    def warnings(self) -> list[Warning]: ...
    @property
    def rotation(self) -> _Array: ...
    @property
    def translation(self) -> _Array: ...
    @property
    def scale(self) -> float: ...
    @property
    def threshold(self) -> float: ...
    @property
    def parallax(self) -> float: ...
    @property
    def coverage(self) -> float: ...
    @property
    def num_iterations(self) -> int: ...
    @property
    def inlier_mask(self) -> NDArray[np.bool_]: ...
    @property
    def residuals(self) -> _Array: ...
    @property
    def covariance(self) -> _Array: ...
    @property
    def translation_basis(self) -> _Array: ...
    @property
    def alternatives(self) -> list[tuple[_Array, _Array]]: ...
    @property
    def bad_row(self) -> tuple[int, int, bool]: ...  # view (0: none), row, whether it is infinite
    @property
    def seconds(self) -> float: ...

def estimate_relative_poses(
    pairs: list[Pair],
    *,
    residual: str,
    threshold: float,
    threshold_in_pixels: bool,
    sample_size: int,
    min_iterations: int,
    max_iterations: int,
    confidence: float,
    min_num_inliers: int,
    shared_error: float,
    num_threads: int,
) -> list[PairResult]: ...
def noise_per_residual(residual: str) -> float: ...
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
def adjust_window(
    rotations: _Array,
    translations: _Array,
    points: _Array,
    free_frames: NDArray[np.bool_],
    frame_index: NDArray[np.uint32],
    point_index: NDArray[np.uint32],
    bearings: _Array,
    weights: _Array,
    *,
    gravity: _Array,
    gravity_weights: _Array,
    world_gravity: _Array,
    noise: float,
    loss: str,
    loss_scale: float,
    max_iterations: int,
    tolerance: float,
    points_free: bool,
) -> tuple[_Array, _Array, _Array, float, int, bool]: ...
def absolute_pose(
    bearings: _Array,
    points: _Array,
    *,
    guess: tuple[_Array, _Array] | None,
    gravity: _Array | None,
    world_gravity: _Array,
    gravity_sigma: float,
    threshold: float,
    min_inliers: int,
    seed: int,
) -> tuple[_Array, _Array] | None: ...
def p3p(bearings: _Array, points: _Array) -> list[tuple[_Array, _Array]]: ...

class internals:  # noqa: N801 - a submodule, for tests
    class Evidence: ...

    @staticmethod
    def judge(evidence: internals.Evidence) -> tuple[Status, list[Warning]]: ...
