# SPDX-License-Identifier: BSD-3-Clause
"""Surfaces that two panoramas of known pose share, grown from the points that they matched.

A match says at which depth a patch lies; its neighbours lie at about the same depth, and so on
(match propagation: Lhuillier and Quan, PAMI 2002, here over the sphere and along known epipolar
curves). So two views say themselves which parts of them show one thing, and which do not where
both must: no detector has to find anything again. The core does it (`grow_surfaces`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360 import _core
from epi360.features.sphere_cells import even_directions
from epi360.features.warped_patches import Panorama
from epi360.poses import Pose

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

NUM_CELLS = 6000  # directions that lie 2.6 degrees apart
LEAST_CONTRAST = 4.0  # grey values; less than that is a bare wall
NUM_NEIGHBOURS, _NUM_AROUND = 8, 24
_NEAREST, _FARTHEST = 0.02, 500.0  # of seeds, in units of the baseline


@dataclass(frozen=True, eq=False)
class Grid:
    """Directions (N, 3) spread evenly over the sphere, and which lie next to each."""

    directions: Floats
    neighbours: NDArray[np.int32]
    around: NDArray[np.int32]
    tree: cKDTree

    def nearest(self, directions: Array, count: int) -> Indices:
        """Cells (N, count) that lie nearest to directions (N, 3)."""
        _, cells = self.tree.query(directions, count)
        return np.asarray(cells, np.int64)


@cache
def grid() -> Grid:
    """All cells; made once."""
    directions = even_directions(NUM_CELLS)
    tree = cKDTree(directions)
    _, near = tree.query(directions, _NUM_AROUND + 1)
    around = np.ascontiguousarray(near[:, 1:], np.int32)
    neighbours = np.ascontiguousarray(around[:, :NUM_NEIGHBOURS])
    return Grid(np.asarray(directions, np.float32), neighbours, around, tree)


@dataclass(frozen=True, eq=False)
class SeenCells:
    """Cells of one view at some depths, as the other camera sees them.

    ``points`` (N, 3) are in its frame, ``ranges`` and ``directions`` theirs there, ``changes_deg``
    the angles between both rays.
    """

    points: Array
    ranges: Array
    directions: Array
    changes_deg: Array

    @classmethod
    def of(cls, pose: Pose, cells: Indices, depths: NDArray[np.floating]) -> SeenCells:
        """Place cells (N,) of a camera at depths (N,); the pose leads from it to the other."""
        rays = grid().directions[cells].astype(np.float64) @ pose.rotation.T
        points = depths[:, None] * rays + pose.translation
        ranges = np.maximum(np.linalg.norm(points, axis=1), 1e-9)
        directions = points / ranges[:, None]
        cosines = np.clip(np.sum(directions * rays, axis=1), -1, 1)
        return cls(points, ranges, directions, np.degrees(np.arccos(cosines)))

    def chosen(self, mask: NDArray[np.bool_]) -> SeenCells:
        """Return those of a mask (N,)."""
        return SeenCells(
            self.points[mask], self.ranges[mask], self.directions[mask], self.changes_deg[mask]
        )


@dataclass(frozen=True, eq=False)
class SharedSurfaces:
    """What one of two panoramas shows of the other's surroundings, for each cell of `grid`.

    Attributes
    ----------
    contrasts : ndarray, shape (N,)
        Standard deviation of the grey values of a patch of 2.8 degrees.
    depths : ndarray, shape (N,)
        In units of the translation; 0 where nothing was found.
    likeness : ndarray, shape (N,)
        Correlation with the other view, -1 where nothing was found.
    normals : ndarray, shape (N, 3)
        Of the plane over which it was found.
    expected_depths, expected_likeness : ndarray, shape (N,)
        Depth that the cells around say, and how alike both views look there, whether the cell
        itself was found or not; 0 and -1 where too few around it were.
    counts : ndarray, shape (N,)
        Whether nothing in the cell and around it is masked.
    """

    contrasts: Floats
    depths: Floats
    likeness: Floats
    normals: Floats
    expected_depths: Floats
    expected_likeness: Floats
    counts: NDArray[np.bool_]

    @property
    def found(self) -> NDArray[np.bool_]:
        """Cells that both views show."""
        return np.asarray(self.depths > 0)


def grow_surfaces(
    first: Panorama, second: Panorama, second_from_first: Pose, points: Array
) -> SharedSurfaces:
    """Surfaces of the first panorama that the second shows too.

    ``points`` (M, 3) are where growth begins, in the frame of the first camera and in units of the
    translation; those that lie nearly at the camera or nearly nowhere are left out.
    """
    distances = np.linalg.norm(points, axis=1)
    kept = (distances > _NEAREST) & (distances < _FARTHEST)
    points, distances = points[kept], distances[kept]
    cells = grid().nearest(points / distances[:, None], 1).ravel()
    order = np.argsort(cells, kind="stable")
    found = _core.grow_surfaces(
        first.levels,
        second.levels,
        *_rows(second_from_first),
        grid().directions,
        grid().neighbours,
        grid().around,
        cells[order].astype(np.int32),
        distances[order].astype(np.float32),
    )
    return SharedSurfaces(*found, counts=cells_that_count(first))


def cells_that_count(panorama: Panorama) -> NDArray[np.bool_]:
    """Cells of which nothing is masked, nor of the cells around them."""
    if panorama.usable is None:
        return np.ones(NUM_CELLS, dtype=bool)
    counts = panorama.counts_at(grid().directions.astype(np.float64))
    clear: NDArray[np.bool_] = counts & counts[grid().around].all(axis=1)
    return clear


def likeness_of(
    first: Panorama,
    second: Panorama,
    second_from_first: Pose,
    cells: Indices,
    depths: Array,
    normals: Array,
) -> Floats:
    """How alike both panoramas look at cells (N,) of the first, at depths on planes."""
    return _core.surface_likeness(
        first.levels,
        second.levels,
        *_rows(second_from_first),
        np.ascontiguousarray(grid().directions[cells]),
        np.ascontiguousarray(depths, np.float32),
        np.ascontiguousarray(normals, np.float32),
    )


def _rows(pose: Pose) -> tuple[Array, Array]:
    return np.ascontiguousarray(pose.rotation), np.ascontiguousarray(pose.translation)
