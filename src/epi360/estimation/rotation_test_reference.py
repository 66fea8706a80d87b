# SPDX-License-Identifier: BSD-3-Clause
"""Whether matches reject that the camera only turned, in plain NumPy: the twin of the core's test.

docs/estimator.md has what each part gives and costs, native/core/robust/rotation_test.cpp the other
half of the twins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.around_camera import are_all_around, surround
from epi360.estimation.testimony_reference import region_votes

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ALIGNMENTS = 6
MOST_SQUARES = 13.8  # one in a thousand of chi^2 with two degrees of freedom
RAYLEIGH_MEDIAN, RAYLEIGH_MEDIAN_ERROR = 1.17741, 0.84932
DISPLACED, NEAR_ROTATION_RAD, MOSTLY_ALONG = 2.0, np.radians(10.0), 0.6
DIRECTION_UNKNOWNS = 2.0
FEWEST_DISPLACED = 6


class RotationTest(NamedTuple):
    """Standard deviations by the median and by what is displaced, how many are, and whether around.

    The names are those of the core's ``RotationTest``, whose header says what they mean.
    """

    by_median: float
    by_displaced: float
    num_displaced: int
    all_around: bool


def rotation_test_reference(
    bearings1: Array,
    bearings2: Array,
    inliers: Mask,
    *,
    rotation: Array,
    scale: float,
    gate: float,
    independent: float = 1.0,
    hidden: float = 0.0,
) -> RotationTest:
    """Return how far matches (N, 3) reject the rotation alone, ``inliers`` (N,) being of a pose.

    ``rotation`` (3, 3) is the one that explains most matches, ``scale`` the standard deviation of
    the residuals of the inliers and ``gate`` the largest of these, in radians. The errors of a
    share ``independent`` of them are independent, and the pose has fitted ``hidden`` times the
    variance of one away.
    """
    residuals = _without_translation(bearings1, bearings2, inliers, rotation, scale)
    displaced = residuals > DISPLACED * gate * np.sqrt(1.0 + 2.0 * hidden)
    along, still = displaced & inliers, inliers & ~displaced
    views = bearings1, bearings2
    all_around = are_all_around(views, along)
    passes = along.sum() >= FEWEST_DISPLACED and not all_around and surround(views, still)
    some = still if passes else inliers
    error = np.hypot(RAYLEIGH_MEDIAN_ERROR, RAYLEIGH_MEDIAN / np.sqrt(2.0))
    ordered = np.sort(residuals[some])
    median = ordered[len(ordered) // 2]
    by_median = median / scale - RAYLEIGH_MEDIAN * np.sqrt(1.0 + hidden)
    by_median *= np.sqrt(independent * some.sum()) / error

    near = displaced & (residuals < NEAR_ROTATION_RAD)
    votes = region_votes(bearings1, bearings2) * near
    agreeing = votes @ inliers
    if along.sum() < FEWEST_DISPLACED or agreeing < MOSTLY_ALONG * votes.sum():
        return RotationTest(float(by_median), 0.0, 0, all_around=False)
    by_chance = np.zeros_like(residuals)
    by_chance[near] = np.arcsin(np.minimum(gate / residuals[near], 1.0)) / np.pi
    more = agreeing - votes @ by_chance - DIRECTION_UNKNOWNS
    variance = votes @ (by_chance * (1.0 - by_chance))
    by_displaced = more * np.sqrt(independent / max(variance, 1.0))
    return RotationTest(float(by_median), float(by_displaced), int(along.sum()), all_around)


def _without_translation(
    bearings1: Array, bearings2: Array, inliers: Mask, rotation: Array, scale: float
) -> Array:
    """Angles over root 2 (N,) under the rotation that fits the inliers best (Geman-McClure)."""

    def residuals() -> Array:
        half = 0.5 * np.linalg.norm(bearings1 @ rotation.T - bearings2, axis=1)
        return np.asarray(np.sqrt(2.0) * np.arcsin(np.minimum(half, 1.0)))

    for _ in range(ALIGNMENTS):
        weights = inliers / (1.0 + residuals() ** 2 / (MOST_SQUARES * scale**2)) ** 2
        left, _, right = np.linalg.svd((bearings2 * weights[:, None]).T @ bearings1)
        mirror = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
        rotation = left @ mirror @ right
    return residuals()
