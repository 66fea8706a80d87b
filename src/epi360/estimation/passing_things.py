# SPDX-License-Identifier: BSD-3-Clause
"""Poses whose direction comes from one side alone, while what surrounds the camera says another.

A tram beside a camera that takes a small step moves far more than all that stands still, and most
of that agrees with the tram's direction to the noise. Asked without it, the others tell theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair
from epi360.estimation.around_camera import are_all_around, surround
from epi360.estimation.result import MISSING_MATCHES, RelativePoseResult
from epi360.poses import angles_of_units, translation_error_deg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Estimate = Callable[[Array, Array], RelativePoseResult]

# A quarter of the inliers must show less parallax than so many times the noise: after a large step
# all show more, and a tram agrees with hardly any of them.
_SMALL_NOISES, _MOST_INLIERS = 20.0, 80  # of so many inliers that are looked at
# Much more is so many times what that quarter shows, and so many times the noise at least.
_MUCH_MORE, _LEAST_NOISES = 5.0, 10.0
_FEWEST, _LEAST_SHARE = 6, 0.1  # of the inliers
_APART_DEG, _SIGMAS = 20.0, 4.0  # between both directions


def with_pose_all_around(
    result: RelativePoseResult, bearings1: ArrayLike, bearings2: ArrayLike, estimate: Estimate
) -> RelativePoseResult:
    """The result, or both poses if the matches around the camera say another direction.

    The first is that of the matches around it. ``bearings1`` and ``bearings2`` (N, 3) are those
    that the result was estimated from, and ``estimate`` does so once more, where some are NaN.
    """
    if not result.success or not _has_small_parallax(result, bearings1, bearings2):
        return result
    views = bearing_pair(bearings1, bearings2)
    moved = _moved_on_one_side(result, *views)
    if moved is None:
        return result
    first, second = (np.where(moved[:, None], np.nan, view) for view in views)
    others = estimate(first, second)
    if not others.success or not surround(views, others.inlier_mask):
        return result
    apart = translation_error_deg(others.cam2_from_cam1, result.cam2_from_cam1)
    sigma = np.hypot(others.translation_sigma_deg, result.translation_sigma_deg)
    if not apart > max(_APART_DEG, _SIGMAS * sigma):
        return result
    warning = (
        f"{np.count_nonzero(moved)} matches on one side of the camera moved much more than all "
        "others, which say another direction: something passes by, or the others are far away"
    )
    warnings = (each for each in others.warnings if MISSING_MATCHES not in each)
    return replace(
        others,
        status="planar_ambiguous",
        alternatives=(result.cam2_from_cam1, *others.alternatives),
        probability=0.5 * others.probability,
        warnings=(*warnings, warning),
    )


def _has_small_parallax(
    result: RelativePoseResult, bearings1: ArrayLike, bearings2: ArrayLike
) -> bool:
    """Whether a quarter of the inliers shows hardly any parallax; most results end here.

    It takes some 35 microseconds. Bearings of absurd lengths say nothing.
    """
    (inliers,) = result.inlier_mask.nonzero()
    some = inliers[:: 1 + len(inliers) // _MOST_INLIERS]
    first, second = (np.asarray(each, np.float64)[some] for each in (bearings1, bearings2))
    with np.errstate(all="ignore"):
        turned = first @ result.cam2_from_cam1.rotation.T
        cosines = np.einsum("ij,ij->i", turned, second)
        squares = np.einsum("ij,ij->i", turned, turned) * np.einsum("ij,ij->i", second, second)
        cosines /= np.sqrt(squares)
    cosines.sort()
    small = np.cos(np.radians(min(_SMALL_NOISES * result.noise_deg, 180.0)))
    return bool(cosines[-1 - len(cosines) // 4] > small)


def _parallaxes_deg(result: RelativePoseResult, b1: Array, b2: Array) -> Array:
    return np.degrees(angles_of_units(b1 @ result.cam2_from_cam1.rotation.T, b2))


def _moved_on_one_side(result: RelativePoseResult, b1: Array, b2: Array) -> Mask | None:
    """Inliers (N,) that moved much more than most; None if they are few, or all around."""
    parallaxes = np.nan_to_num(_parallaxes_deg(result, b1, b2))
    quarter = float(np.percentile(parallaxes[result.inlier_mask], 25))
    least = max(_MUCH_MORE * quarter, _LEAST_NOISES * result.noise_deg)
    moved = result.inlier_mask & (parallaxes > least)
    if moved.sum() < max(_FEWEST, _LEAST_SHARE * result.inlier_mask.sum()):
        return None
    return None if are_all_around((b1, b2), moved) else moved
