# SPDX-License-Identifier: BSD-3-Clause
"""The paper's estimators on synthetic points, for the sliders of the demo's second tab."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import SkCost, pose_from_essential, search_sk, stability
from epi360.estimation import eight_point, estimate_relative_pose, paper_pose
from epi360.poses import Pose, rotation_error_deg, translation_error_deg
from epi360.report.html_page import packed
from epi360.synthetic import TwoViewScene, two_view_scene
from epi360_demo.limits import RefusedError

Array = NDArray[np.float64]
Estimator = Callable[[TwoViewScene, float, float], Pose]

# The first set of points is the answer to a slider, and the others follow for the medians.
NUM_DRAWS = 15
SURFACE_RATIOS = np.linspace(-2.8, 2.8, 41)  # ln(K / S)


@dataclass(frozen=True)
class Setting:
    """Where the sliders stand; the name of each says its unit."""

    noise_deg: float = 1.0
    outlier_percent: float = 10.0
    num_points: int = 200
    fov_deg: float = 360.0
    S: float = 1.0
    K: float = 1.0
    seed: int = 0


RANGES = {
    "noise_deg": (0.0, 10.0),
    "outlier_percent": (0.0, 60.0),
    "num_points": (10, 1000),
    "fov_deg": (60.0, 360.0),
    "S": (0.25, 4.0),
    "K": (0.25, 4.0),
    "seed": (0, 99),
}


@dataclass(frozen=True)
class Method:
    """One row of the errors."""

    group: str
    name: str
    estimate: Estimator


def _paper(method: str) -> Estimator:
    return lambda scene, S, K: paper_pose(scene.bearings1, scene.bearings2, method)


def _with_sliders(scene: TwoViewScene, S: float, K: float) -> Pose:
    b1, b2 = scene.bearings1, scene.bearings2
    return pose_from_essential(eight_point(b1, b2, normalization=(S, K)).E, b1, b2)


def _robust(scene: TwoViewScene, S: float, K: float) -> Pose:
    return estimate_relative_pose(scene.bearings1, scene.bearings2).cam2_from_cam1


_LINEAR, _GOLD, _T = "Linear: 8-PA", "Gold standard", "Gold standard, Student's t"
METHODS = (
    Method(_LINEAR, "no normalisation", _paper("8pa")),
    Method(_LINEAR, "your S and K", _with_sliders),
    Method(_LINEAR, "best S and K", _paper("opt_sk")),
    Method(_LINEAR, "isotropic", _paper("8pa_isotropic")),
    Method(_LINEAR, "non-isotropic", _paper("8pa_non_isotropic")),
    Method(_LINEAR, "both of them", _paper("8pa_isotropic_non_isotropic")),
    Method(_GOLD, "no weights", _paper("gsm")),
    Method(_GOLD, "weights of 8-PA", _paper("gsm_w_xi")),
    Method(_GOLD, "weights of S and K", _paper("gsm_w_sk")),
    Method(_GOLD, "weights anew, from 8-PA", _paper("gsm_irls_xi")),
    Method(_GOLD, "weights anew, S and K", _paper("gsm_irls_sk")),
    Method(_T, "weights of 8-PA", _paper("gsm_w_xi_t")),
    Method(_T, "weights of S and K", _paper("gsm_w_sk_t")),
    Method(_T, "weights anew, from 8-PA", _paper("gsm_irls_xi_t")),
    Method(_T, "weights anew, S and K", _paper("gsm_irls_sk_t")),
    Method("epi360", "five-point, RANSAC", _robust),
)


def setting_from(values: Mapping[str, Any]) -> Setting:
    """Return a checked setting; `RefusedError` where a value is out of its range."""
    if set(values) != {field.name for field in fields(Setting)}:
        raise RefusedError("The sliders are those of another version of this page; load it again.")
    for name, (low, high) in RANGES.items():
        value = values[name]
        if not isinstance(value, int | float) or not low <= value <= high:
            raise RefusedError(f"{name} must be between {low:g} and {high:g}.")
    whole = {name: round(values[name]) for name in ("num_points", "seed")}
    return Setting(**(dict(values) | whole))


def look(setting: Setting) -> dict[str, Any]:
    """Return what the page draws at once: errors, sigma_8, bearings, the surface over S and K."""
    scene = _scene(setting, 0)
    b1, b2 = scene.bearings1, scene.bearings2
    S, K, _, _ = search_sk(b1, b2)
    cost = SkCost(b1, b2)
    return {
        "errors": _numbers(draw_errors(setting, 0)),
        "sigma8": [
            _sigma8("no normalisation", scene, 1.0, 1.0),
            _sigma8("your S and K", scene, setting.S, setting.K),
            _sigma8("best S and K", scene, S, K),
        ],
        "found": math.log(abs(K / S)),
        "ratios": SURFACE_RATIOS.round(4).tolist(),
        "costs": [float(np.degrees(cost.at(u)) / len(b1)) for u in SURFACE_RATIOS],
        "rays": packed(b1),
        "outliers": "".join("0" if each else "1" for each in scene.inlier_mask),
        "S": setting.S,
        "K": setting.K,
    }


def draw_errors(setting: Setting, draw: int) -> Array:
    """Return rotation and translation errors in degrees, one row a method; NaN is no pose."""
    scene = _scene(setting, draw)
    return np.array([_error_deg(method, scene, setting) for method in METHODS])


def medians(draws: list[Array]) -> list[list[float | None]]:
    """Return the medians of both errors over sets of points; no pose counts as 180 degrees."""
    errors = np.nan_to_num(np.stack(draws), nan=180.0)
    return _numbers(np.median(errors, axis=0))


def _scene(setting: Setting, draw: int) -> TwoViewScene:
    return two_view_scene(
        1000 * setting.seed + draw,
        num_matches=setting.num_points,
        layout="cone",
        cone_half_angle_deg=setting.fov_deg / 2.0,
        noise_deg=setting.noise_deg or None,
        outlier_ratio=setting.outlier_percent / 100.0,
    )


def _error_deg(method: Method, scene: TwoViewScene, setting: Setting) -> tuple[float, float]:
    """Return both errors; NaN where the method gives no pose."""
    try:
        pose = method.estimate(scene, setting.S, setting.K)
    except (ValueError, np.linalg.LinAlgError):
        return math.nan, math.nan
    truth = scene.cam2_from_cam1
    return rotation_error_deg(pose, truth), translation_error_deg(pose, truth)


def _sigma8(name: str, scene: TwoViewScene, S: float, K: float) -> dict[str, Any]:
    values = stability(scene.bearings1, scene.bearings2, (S, K)).singular_values
    return {"name": name, "value": _number(values[7]), "share": _number(values[7] / values[0])}


def _numbers(rows: Array) -> list[list[float | None]]:
    return [[_number(value) for value in row] for row in rows]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
