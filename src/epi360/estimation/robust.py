# SPDX-License-Identifier: BSD-3-Clause
"""The robust estimator: matches with outliers in, a pose with its evidence and verdict out."""

from __future__ import annotations

from dataclasses import dataclass
from operator import index
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360 import _core
from epi360.epipolar.arguments import bearing_pair, jacobians_array, weights_array
from epi360.epipolar.essential import essential_from_pose
from epi360.epipolar.residuals import RESIDUALS, tangent_basis
from epi360.estimation.result import RelativePoseResult, Status
from epi360.poses import Pose

Array = NDArray[np.float64]

_STATUSES: tuple[Status, ...] = (  # in the order of native/core/robust.h
    "ok",
    "too_few_matches",
    "too_few_inliers",
    "pure_rotation",
    "planar_ambiguous",
    "concentrated_inliers",
)
_MIN_MATCHES = 5
# A wrong pose on real images rested on 5 of 48 cells while the matches covered 21; the poorest
# right one covers 8 of 25. A lens that sees little covers little with all of its matches.
_PATCH_CELLS, _PATCH_SHARE = 6 / 48, 0.35
_PATCH_SPREAD = 0.03  # as of a cone of 28 degrees
# Measured on real pairs: directions are wrong under about 3 times the noise, good from 6 to 7.
_PARALLAX_PER_NOISE = 6.0
# The one-sided residuals see the noise of both views at once.
_NOISE_PER_RESIDUAL = {
    "paper": 0.5**0.5,
    "angular": 0.5**0.5,
    "sampson": 1.0,
    "tangent_sampson": 1.0,
}


@dataclass(frozen=True)
class _Support:
    """How many matches agree, and from how much of the sphere."""

    num_distinct: int
    spread: float
    spread_of_matches: float


@dataclass(frozen=True)
class RansacOptions:
    """How the sampling runs.

    Parameters
    ----------
    minimal_solver : str
        "five_point" (Nistér 2004) or "eight_point".
    min_iterations, max_iterations : int
        Limits on the minimal samples of one round; an automatic threshold takes one to four.
    confidence : float
        Probability that at least one sample without outliers was drawn when sampling stops.
    min_num_inliers : int
        Support under which a pose is not believed, whatever its odds.
    """

    minimal_solver: Literal["five_point", "eight_point"] = "five_point"
    min_iterations: int = 30
    max_iterations: int = 5000
    confidence: float = 0.999
    min_num_inliers: int = 6

    def __post_init__(self) -> None:
        """Check all options.

        Raises
        ------
        ValueError
            If one is out of its range.
        """
        if self.minimal_solver not in ("five_point", "eight_point"):
            raise ValueError(
                f"minimal_solver must be five_point or eight_point, got {self.minimal_solver!r}"
            )
        for name in ("min_iterations", "max_iterations", "min_num_inliers"):
            if not isinstance(getattr(self, name), (int, np.integer)):
                raise ValueError(f"{name} must be an integer, got {getattr(self, name)!r}")
        if not 1 <= self.min_iterations <= self.max_iterations:
            raise ValueError(
                "1 <= min_iterations <= max_iterations must hold, got "
                f"{self.min_iterations} and {self.max_iterations}"
            )
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"confidence must be between 0 and 1, got {self.confidence}")
        if self.min_num_inliers < 5:
            raise ValueError(f"min_num_inliers must be at least 5, got {self.min_num_inliers}")


def estimate_relative_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    *,
    inlier_threshold_deg: float | Literal["auto"] = "auto",
    residual: str = "sampson",
    jacobians1: ArrayLike | None = None,
    jacobians2: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    options: RansacOptions = RansacOptions(),  # noqa: B008 - frozen
    seed: int = 0,
) -> RelativePoseResult:
    """Relative pose from matches of which many may be wrong.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (M, 3)
        Bearings of any length in both cameras, row i of both is one match; a row with NaN in either
        is missing data.
    inlier_threshold_deg : float or "auto"
        Gate on the residual's angle in degrees; "auto" estimates the noise and gates at the angle
        where a match is as likely right as wrong.
    residual : str
        "sampson", "angular", "paper", or "tangent_sampson" with the Jacobians.
    jacobians1, jacobians2 : array_like, shape (M, 3, 2), optional
        Derivative of each bearing by its pixel: respects the pixel noise of any camera.
    weights : array_like, shape (M,), optional
        Of the matches, relative to one another.
    options : RansacOptions
        How the sampling runs.
    seed : int
        Of the sampling; the same input and seed give the same result.

    Returns
    -------
    result : RelativePoseResult
        With ``status`` other than "ok" where the matches do not support one pose.

    Raises
    ------
    ValueError
        If an array has a wrong shape, an infinite or a zero bearing, or an option is unknown.

    Notes
    -----
    Five-point samples whose points lie in front of both cameras are scored by a truncated cost that
    counts depths (MSAC, Torr & Zisserman 2000), over four scales while the noise is unknown. Good
    hypotheses are refined over SO(3) x S^2 to the most likely pose under Gaussian inliers, near
    misses and uniform outliers, whose scale and shares are estimated along; the most likely wins.
    The verdict asks whether a rotation explains the matches as well, whether chance would, whether
    another pose does, and whether the inliers are one patch among matches from everywhere.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    if residual not in RESIDUALS:
        raise ValueError(f"residual must be one of {', '.join(RESIDUALS)}, got {residual!r}")
    w = weights_array(weights, len(b1))
    J1, J2 = _unit_jacobians(jacobians1, jacobians2, len(b1), residual)
    usable = np.asarray(np.isfinite(b1).all(axis=1) & np.isfinite(b2).all(axis=1))
    if w is not None:
        usable &= w > 0.0
    if J1 is not None and J2 is not None:
        usable &= np.isfinite(J1).all(axis=(1, 2)) & np.isfinite(J2).all(axis=(1, 2))
    if w is not None and usable.any():
        w = w / w[usable].mean()  # weights are relative to one another
    threshold_rad = check_threshold(inlier_threshold_deg)
    if int(usable.sum()) < _MIN_MATCHES:
        return _failure("too_few_matches", len(b1), threshold_rad)

    found = _core.estimate_relative_pose(
        b1[usable],
        b2[usable],
        residual=residual,
        threshold_rad=threshold_rad,
        sample_size=8 if options.minimal_solver == "eight_point" else 5,
        min_iterations=options.min_iterations,
        max_iterations=options.max_iterations,
        confidence=options.confidence,
        seed=index(seed) % 2**64,
        weights=None if w is None else w[usable],
        jacobians1=None if J1 is None else J1[usable],
        jacobians2=None if J2 is None else J2[usable],
    )
    inliers = np.flatnonzero(usable)[found["inlier"].astype(bool)]
    support = _Support(
        _num_distinct(b1[inliers], b2[inliers]),
        min(_spread(b1[inliers]), _spread(b2[inliers])),
        min(_spread(b1[usable]), _spread(b2[usable])),
    )
    return _result(found, usable, support, residual, options)


def check_threshold(inlier_threshold_deg: float | str) -> float:
    """Return a threshold in radians, 0 for "auto".

    Parameters
    ----------
    inlier_threshold_deg : float or "auto"
        Degrees in (0, 45].

    Raises
    ------
    ValueError
        If it is neither.
    """
    if inlier_threshold_deg == "auto":
        return 0.0
    try:
        degrees = float(inlier_threshold_deg)
    except (TypeError, ValueError):
        degrees = np.nan
    if not 0.0 < degrees <= 45.0:
        raise ValueError(
            f'inlier_threshold_deg must be "auto" or in (0, 45], got {inlier_threshold_deg!r}'
        )
    return float(np.radians(degrees))


def _unit_jacobians(
    jacobians1: ArrayLike | None, jacobians2: ArrayLike | None, num_matches: int, residual: str
) -> tuple[Array | None, Array | None]:
    """Jacobians scaled by one number to a mean of one radian a pixel, so residuals are radians."""
    if residual != "tangent_sampson":
        return None, None
    J1 = jacobians_array(jacobians1, num_matches, "jacobians1")
    J2 = jacobians_array(jacobians2, num_matches, "jacobians2")
    if J1 is None or J2 is None:
        raise ValueError("residual tangent_sampson needs jacobians1 and jacobians2")
    squares = np.concatenate([(J1**2).sum(axis=(1, 2)), (J2**2).sum(axis=(1, 2))])
    squares = squares[np.isfinite(squares)]
    scale = float(np.sqrt(squares.mean() / 2.0)) if len(squares) else 1.0
    return J1 / scale, J2 / scale


def _failure(status: Status, num_matches: int, threshold_rad: float) -> RelativePoseResult:
    return RelativePoseResult(
        cam2_from_cam1=Pose.nan(),
        E=np.full((3, 3), np.nan),
        inlier_mask=np.zeros(num_matches, dtype=bool),
        residuals_rad=np.full(num_matches, np.nan),
        noise_deg=np.nan,
        inlier_threshold_deg=float(np.degrees(threshold_rad)) if threshold_rad else np.nan,
        parallax_deg=np.nan,
        sphere_coverage=0.0,
        num_iterations=0,
        status=status,
        covariance=np.full((5, 5), np.nan),
        translation_basis=np.full((3, 2), np.nan),
    )


def _result(
    found: _core._RobustResult,
    usable: NDArray[np.bool_],
    support: _Support,
    residual: str,
    options: RansacOptions,
) -> RelativePoseResult:
    inlier_mask = np.zeros(len(usable), dtype=bool)
    inlier_mask[usable] = found["inlier"].astype(bool)
    residuals = np.full(len(usable), np.nan)
    residuals[usable] = found["residuals"]
    status = _status(found, support, options)
    share = 1.0 if status == "pure_rotation" else _NOISE_PER_RESIDUAL[residual]
    pose = _pose(found, status)
    determined = status in ("ok", "planar_ambiguous")
    alternatives = tuple(Pose(R, t) for R, t in found["alternatives"])
    if status == "too_few_inliers":
        alternatives = ()
    elif status == "concentrated_inliers":
        alternatives = (_pose(found, _STATUSES[found["status"]]), *alternatives)
    return RelativePoseResult(
        cam2_from_cam1=pose,
        E=essential_from_pose(pose) if determined else np.full((3, 3), np.nan),
        inlier_mask=inlier_mask,
        residuals_rad=residuals,
        noise_deg=float(np.degrees(found["scale"])) * share,
        inlier_threshold_deg=float(np.degrees(found["threshold"])),
        parallax_deg=float(np.degrees(found["parallax"])),
        sphere_coverage=found["coverage"],
        num_iterations=found["num_iterations"],
        status=status,
        covariance=(
            found["covariance"]
            if determined or status == "pure_rotation"
            else np.full((5, 5), np.nan)
        ),
        translation_basis=(
            tangent_basis(pose.translation) if determined else np.full((3, 2), np.nan)
        ),
        alternatives=alternatives,
        warnings=_warnings(found, usable, status),
    )


def _num_distinct(b1: Array, b2: Array) -> int:
    """Count inliers that are no copies of one another, told apart by one projection."""
    projected = b1 @ [0.6180, 0.7549, 0.8192] + b2 @ [1.3247, 1.2207, 1.1673]
    return len(np.unique(projected.round(12)))


def _spread(bearings: Array) -> float:
    """One minus the length of the mean bearing: 0 for one direction, 0.06 for a cone of 40°."""
    return 1.0 - float(np.linalg.norm(bearings.mean(axis=0))) if len(bearings) else 0.0


def _status(found: _core._RobustResult, support: _Support, options: RansacOptions) -> Status:
    status = _STATUSES[found["status"]]
    if status not in ("ok", "planar_ambiguous", "pure_rotation"):
        return status
    if support.num_distinct < options.min_num_inliers:
        return "too_few_inliers"
    if support.spread < _PATCH_SPREAD and support.spread < 0.2 * support.spread_of_matches:
        return "concentrated_inliers"  # also at a pole, which is a corner of many cells
    patch = found["coverage"] <= _PATCH_CELLS
    if patch and found["coverage"] < _PATCH_SHARE * found["match_coverage"]:
        return "concentrated_inliers"
    return status


def _pose(found: _core._RobustResult, status: Status) -> Pose:
    if status in ("ok", "planar_ambiguous"):
        return Pose(found["rotation"], found["translation"])
    if status == "pure_rotation":
        return Pose(found["rotation"], np.full(3, np.nan))
    return Pose.nan()


def _warnings(
    found: _core._RobustResult, usable: NDArray[np.bool_], status: Status
) -> tuple[str, ...]:
    warnings = []
    missing = len(usable) - int(usable.sum())
    if missing:
        warnings.append(f"{missing} of {len(usable)} matches are missing (NaN or weight 0)")
    if status != "ok":
        return tuple(warnings)
    if found["parallax"] < _PARALLAX_PER_NOISE * found["scale"]:
        ratio = found["parallax"] / found["scale"]
        warnings.append(
            f"the median parallax is only {ratio:.1f} times the noise: "
            "the direction of the translation is uncertain, the rotation is not"
        )
    if found["coverage"] < 0.5 * found["match_coverage"]:
        warnings.append(
            f"inliers cover {found['coverage']:.0%} of the sphere, all matches "
            f"{found['match_coverage']:.0%}: part of the scene may move or repeat itself"
        )
    return tuple(warnings)
