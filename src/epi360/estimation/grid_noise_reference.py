# SPDX-License-Identifier: BSD-3-Clause
"""The noise of key points on a grid of pixels or cells, in NumPy: the twin of the core's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from epi360.estimation.result import RelativePoseResult

Array = NDArray[np.float64]

_ROUNDING = 2e-7  # of bearings that were 32-bit numbers
_FEWEST, _FEWEST_IN_COLUMNS, _LEAST_SHARE = 4, 2, 0.03  # points that share a row, or a column
_CENTRAL = 0.9
_SMALLEST_GAPS, _ONE_GRID = 0.02, 0.3
_LARGEST_CELL = 0.06  # radians
_LESS_NOISE, _NEARLY_RIGHT, _NEAR_CELLS = 0.7, 0.1, 2.0
_PYRAMID = 3.5  # rows of all pictures of ORB's pyramid, over those of the largest


def grid_noise(bearings1: Array, bearings2: Array) -> float:
    """Standard deviation (radians) of bearings on a grid, that of rounding to its cells.

    ``bearings1`` and ``bearings2`` (N, 3) are unit vectors. 0 unless points of both views share
    rows and columns: of a panorama latitudes and longitudes, of a pinhole camera slopes.
    """
    cell = min(_cell(bearings1), _cell(bearings2))
    return float(cell / np.sqrt(12.0)) if cell < _LARGEST_CELL else 0.0


def least_noise(bearings1: Array, bearings2: Array, result: RelativePoseResult) -> float:
    """Noise (radians) that an answer should have been found with at least; 0 if it is as it says.

    It is that of rounding where the bearings are on a grid, the answer has clearly less noise, and
    many of the matches that are no inliers are off by no more than two cells.
    """
    rounding = grid_noise(bearings1, bearings2)
    if rounding == 0.0 or not np.radians(result.noise_deg) < _LESS_NOISE * rounding:
        return 0.0
    near = np.abs(result.residuals_rad) < _NEAR_CELLS * np.sqrt(12.0) * rounding
    nearly = np.count_nonzero(near & ~result.inlier_mask)
    return rounding if nearly > _NEARLY_RIGHT * result.num_inliers else 0.0


def _cell(bearings: Array) -> float:
    x, y, z = np.unique(bearings, axis=0).T
    cells = [_spacing(np.arcsin(np.clip(y, -1.0, 1.0)), np.arctan2(x, z))]
    if (z > 0.0).all():
        cells.append(float(np.mean(z**2)) * _spacing(y / z, x / z))
    return max(cells)


def _spacing(rows: Array, columns: Array) -> float:
    """Distance of the rows of points on a grid, 0 where there is none.

    Of one grid it is the smallest gap between rows; of several, as of an image pyramid, the number
    of rows that many points hit tells how many there are (a birthday problem).
    """
    gaps, column_gaps = (np.diff(np.sort(each)) for each in (rows, columns))
    different = gaps > _ROUNDING
    num, hit = len(rows), int(different.sum()) + 1
    if hit < 2 or num - hit < max(_FEWEST, _LEAST_SHARE * num):
        return 0.0
    if (column_gaps <= _ROUNDING).sum() < _FEWEST_IN_COLUMNS:
        return 0.0
    tails = 0.5 - 0.5 * _CENTRAL, 0.5 + 0.5 * _CENTRAL
    low, high = np.quantile(rows, tails, method="lower")
    total = brentq(lambda n: -n * np.expm1(-num / n) - hit, hit, float(num) ** 2)
    by_number = float(high - low) / _CENTRAL / total
    by_gaps = float(np.quantile(gaps[different], _SMALLEST_GAPS, method="lower"))
    return by_gaps if by_gaps > _ONE_GRID * by_number else _PYRAMID * by_number
