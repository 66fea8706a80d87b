# SPDX-License-Identifier: BSD-3-Clause
"""Cells of about equal area on the sphere, to spread points evenly."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SphereCells:
    """Bands of equal height, cut into about square cells; the axis is y, up and down."""

    def __init__(self, num_cells: float) -> None:
        side_rad = np.sqrt(4 * np.pi / num_cells)
        self._num_bands = max(1, round(np.pi / side_rad))
        edges = np.linspace(1, -1, 2 * self._num_bands + 1) * np.pi / 2
        around = 2 * np.pi * np.cos(edges[1::2]) / side_rad
        self._around = np.maximum(1, np.round(around)).astype(np.int64)
        self._first = np.concatenate([[0], np.cumsum(self._around)])

    def __len__(self) -> int:
        return int(self._first[-1])

    def indices(self, bearings: Array) -> NDArray[np.int64]:
        """Cell (N,) in which each bearing (N, 3) lies."""
        x, y, z = bearings.T
        latitudes = np.arctan2(y, np.hypot(x, z))
        band = ((latitudes / np.pi + 0.5) * self._num_bands).astype(np.int64)
        band = band.clip(0, self._num_bands - 1)
        around = self._around[band]
        column = ((np.arctan2(x, z) / (2 * np.pi) + 0.5) * around).astype(np.int64)
        cells: NDArray[np.int64] = self._first[band] + column.clip(0, around - 1)
        return cells


def even_directions(count: int) -> Array:
    """Unit vectors (count, 3) that cover the sphere evenly, on a Fibonacci spiral."""
    index = np.arange(count) + 0.5
    y = 1 - 2 * index / count
    longitude = index * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - y**2)
    return np.column_stack([radius * np.sin(longitude), y, radius * np.cos(longitude)])
