# SPDX-License-Identifier: BSD-3-Clause
"""What the native estimator found, as a result with a status and warnings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar.essential import essential_from_pose
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


class Found(NamedTuple):
    """One pair's answer of ``_core.estimate_relative_poses``; angles in radians, wall seconds."""

    status: int
    rotation: Array
    translation: Array
    scale: float
    threshold: float
    inlier: NDArray[np.uint8]
    residuals: Array
    num_iterations: int
    parallax: float
    coverage: float
    match_coverage: float
    covariance: Array
    alternatives: list[tuple[Array, Array]]
    num_usable: int
    num_distinct: int
    spread: float
    spread_of_matches: float
    translation_basis: Array
    seconds: float


def result_of(found: Found, residual: str, min_num_inliers: int) -> RelativePoseResult:
    """Return the public result of one pair.

    Parameters
    ----------
    found : Found
        The native answer.
    residual : str
        Name of the residual, for the unit of the noise.
    min_num_inliers : int
        Support under which a pose is not believed.
    """
    status = _status(found, min_num_inliers)
    pose = _pose(found, status)
    determined = status in ("ok", "planar_ambiguous")
    share = 1.0 if status == "pure_rotation" else _NOISE_PER_RESIDUAL[residual]
    return RelativePoseResult(
        cam2_from_cam1=pose,
        E=essential_from_pose(pose) if determined else np.full((3, 3), np.nan),
        inlier_mask=found.inlier.view(np.bool_),
        residuals_rad=found.residuals,
        noise_deg=float(np.degrees(found.scale)) * share,
        inlier_threshold_deg=float(np.degrees(found.threshold)),
        parallax_deg=float(np.degrees(found.parallax)),
        sphere_coverage=found.coverage,
        num_iterations=found.num_iterations,
        status=status,
        covariance=(
            found.covariance if determined or status == "pure_rotation" else np.full((5, 5), np.nan)
        ),
        translation_basis=(found.translation_basis if determined else np.full((3, 2), np.nan)),
        alternatives=_alternatives(found, status),
        warnings=_warnings(found, status),
    )


def _status(found: Found, min_num_inliers: int) -> Status:
    status = _STATUSES[found.status]
    if status not in ("ok", "planar_ambiguous", "pure_rotation"):
        return status
    if found.num_distinct < min_num_inliers:
        return "too_few_inliers"
    if found.spread < _PATCH_SPREAD and found.spread < 0.2 * found.spread_of_matches:
        return "concentrated_inliers"  # also at a pole, which is a corner of many cells
    patch = found.coverage <= _PATCH_CELLS
    if patch and found.coverage < _PATCH_SHARE * found.match_coverage:
        return "concentrated_inliers"
    return status


def _pose(found: Found, status: Status) -> Pose:
    if status in ("ok", "planar_ambiguous"):
        return Pose(found.rotation, found.translation)
    if status == "pure_rotation":
        return Pose(found.rotation, np.full(3, np.nan))
    return Pose.nan()


def _alternatives(found: Found, status: Status) -> tuple[Pose, ...]:
    if status == "too_few_inliers":
        return ()
    alternatives = tuple(Pose(R, t) for R, t in found.alternatives)
    if status == "concentrated_inliers":
        return (_pose(found, _STATUSES[found.status]), *alternatives)
    return alternatives


def _warnings(found: Found, status: Status) -> tuple[str, ...]:
    warnings = []
    missing = len(found.inlier) - found.num_usable
    if missing and status != "too_few_matches":
        warnings.append(f"{missing} of {len(found.inlier)} matches are missing (NaN or weight 0)")
    if status not in ("ok", "planar_ambiguous"):
        return tuple(warnings)
    if found.parallax < _PARALLAX_PER_NOISE * found.scale:
        ratio = found.parallax / found.scale
        warnings.append(
            f"the median parallax is only {ratio:.1f} times the noise: "
            "the direction of the translation is uncertain, the rotation is not"
        )
    if found.coverage < 0.5 * found.match_coverage:
        warnings.append(
            f"inliers cover {found.coverage:.0%} of the sphere, all matches "
            f"{found.match_coverage:.0%}: part of the scene may move or repeat itself"
        )
    return tuple(warnings)
