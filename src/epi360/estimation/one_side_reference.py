# SPDX-License-Identifier: BSD-3-Clause
"""The side of a camera that says most of where it moved; in the core it is `one_side.cpp`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar.residuals import residual_jacobians
from epi360.estimation.around_camera import are_all_around
from epi360.poses import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIDES_DEG = (35.0, 60.0, 85.0)
SAYS_MOST = 10.0  # times the variance of the direction, without it
MOVED_MORE = 2.0  # times the median parallax elsewhere
FEWEST_ON_SIDE = 6
BANDS, SECTORS = 4, 12


def sides_that_say_most(pose: Pose, bearings1: Array, bearings2: Array, inlier: Mask) -> list[Mask]:
    """Masks (N,) of inliers on one side without which the direction is known much less.

    A side holds the equal-area cells within 35, 60 or 85 degrees of one of them, and of these the
    inliers that moved twice as far as the median elsewhere. ``bearings1`` and ``bearings2`` (N, 3)
    are of unit length.
    """
    J = residual_jacobians(pose, bearings1, bearings2)
    cells = np.where(inlier, cells_of(bearings1), -1)
    kept = np.unique(cells[inlier])
    if not len(kept):
        return []
    information = np.array([J[cells == cell].T @ J[cells == cell] for cell in kept])
    centres = np.array([bearings1[cells == cell].sum(axis=0) for cell in kept])
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    counts = np.array([(cells == cell).sum() for cell in kept])
    parallax = np.linalg.norm(bearings1 @ pose.rotation.T - bearings2, axis=1)
    sides = []
    for side_deg in SIDES_DEG:
        near = centres @ centres.T > np.cos(np.radians(side_deg))
        variances = [
            _direction_variance(information[~each].sum(axis=0))
            if counts[~each].sum() >= FEWEST_ON_SIDE
            else 0.0
            for each in near
        ]
        if not max(variances) > SAYS_MOST * _direction_variance(information.sum(axis=0)):
            continue
        inside = inlier & np.isin(cells, kept[near[int(np.argmax(variances))]])
        elsewhere = np.sort(parallax[inlier & ~inside])
        side = inside & (parallax > MOVED_MORE * elsewhere[(len(elsewhere) - 1) // 2])
        if side.sum() >= FEWEST_ON_SIDE and are_all_around((bearings1, bearings2), inlier & ~side):
            sides.append(side)
    return sides


def cells_of(bearings: Array) -> NDArray[np.int64]:
    """Index (N,) of the equal-area cell of each bearing: bands along y by sectors around it."""
    bands = np.minimum(BANDS - 1, (0.5 * (bearings[:, 1] + 1.0) * BANDS).astype(np.int64))
    azimuths = np.arctan2(bearings[:, 0], bearings[:, 2])
    sectors = np.floor(azimuths / (2.0 * np.pi / SECTORS)).astype(np.int64) % SECTORS
    return bands * SECTORS + sectors


def _direction_variance(information: Array) -> float:
    """Trace of the covariance of the two components of the direction; infinite if it is free."""
    try:
        return float(np.trace(np.linalg.inv(information)[3:, 3:]))
    except np.linalg.LinAlgError:
        return np.inf
