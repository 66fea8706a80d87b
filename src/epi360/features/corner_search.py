# SPDX-License-Identifier: BSD-3-Clause
"""New corners for a tracker, where the sphere shows texture and no point is followed yet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360.features.lucas_kanade import erode_mask, find_corners
from epi360.features.sphere_cells import SphereCells
from epi360.features.tracking_views import TrackingView

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_TILE_PX = 128  # large temporary arrays would take ten times as long
_ROUNDS = 4  # frames in which every tile is searched once
_LEAST_STRENGTH = 2e-5  # of a corner; noise of one grey value reaches it
_MOST_PER_CELL = 3
_ENOUGH = 0.7  # of the points after the last search of everything


class CornerSearch:
    """Search a part of the views in each frame, and all of them when many points are gone."""

    def __init__(
        self,
        views: list[TrackingView],
        num_cells: float,
        min_distance_rad: float,
        quality_level: float,
        window_px: int,
    ) -> None:
        self._views = views
        self._usable = [erode_mask(view.usable, window_px) for view in views]
        self._tiles = _tiles(self._usable)
        self._cells = SphereCells(num_cells)
        self._fine_cells = SphereCells(4 * num_cells)
        self._chord = 2 * np.sin(min_distance_rad / 2)
        self._quality_level = quality_level
        self._round = 0
        self._num_before = 0
        self._strongest = np.zeros(len(self._tiles))  # corner of each tile when last searched

    def new_bearings(self, pictures: list[Picture], taken: Array, wanted: int) -> Array:
        """At most so many bearings (K, 3) of corners, away from those taken, best first."""
        everywhere = len(taken) <= _ENOUGH * self._num_before
        self._round = (self._round + 1) % _ROUNDS
        tiles = range(
            0 if everywhere else self._round, len(self._tiles), 1 if everywhere else _ROUNDS
        )
        found = np.empty((0, 3))
        if wanted > 0:
            bearings, strengths = self._corners(pictures, tiles)
            found = self._chosen(bearings, strengths, taken)[:wanted]
        if everywhere or len(taken) + len(found) > self._num_before:
            self._num_before = len(taken) + len(found)
        return found

    def thinned(self, bearings: Array) -> NDArray[np.bool_]:
        """Which bearings are not within half of the least distance of one before them."""
        kept = np.ones(len(bearings), dtype=bool)
        if len(bearings):
            pairs = cKDTree(bearings).query_pairs(self._chord / 2, output_type="ndarray")
            kept[pairs[:, 1]] = False  # a pair's indices ascend
        return kept

    def _chosen(self, bearings: Array, strengths: Array, taken: Array) -> Array:
        order = np.argsort(-strengths, kind="stable")
        bearings = bearings[order]
        _, best = np.unique(self._fine_cells.indices(bearings), return_index=True)
        bearings = bearings[np.sort(best)]
        if len(taken) and len(bearings):
            bearings = bearings[cKDTree(taken).query(bearings)[0] >= self._chord]
        if len(bearings) == 0:
            return bearings
        pairs = cKDTree(bearings).query_pairs(self._chord, output_type="ndarray")
        bearings = np.delete(bearings, pairs[:, 1], axis=0)
        cells = self._cells.indices(bearings)
        counts = np.bincount(self._cells.indices(taken), minlength=len(self._cells))
        place = counts[cells] + _rank_in_group(cells)
        order = np.argsort(place, kind="stable")  # empty cells first
        return bearings[order[place[order] < _MOST_PER_CELL]]

    def _corners(self, pictures: list[Picture], tiles: range) -> tuple[Array, Array]:
        all_bearings, all_strengths = [np.empty((0, 3))], [np.empty(0)]
        for index in tiles:
            number, top, left = self._tiles[index]
            view = self._views[number]
            tile = np.s_[top : top + _TILE_PX, left : left + _TILE_PX]
            points, strengths = find_corners(
                pictures[number][tile], self._usable[number][tile], self._quality_level
            )
            self._strongest[index] = strengths.max(initial=0)
            bearings = view.bearings_from_points(points + np.array([left, top], np.float32))
            own = view.owns(bearings)
            all_bearings.append(bearings[own])
            all_strengths.append(strengths[own].astype(np.float64))
        bearings, strengths = np.concatenate(all_bearings), np.concatenate(all_strengths)
        weakest = max(_LEAST_STRENGTH, self._quality_level * self._strongest.max(initial=0))
        return bearings[strengths > weakest], strengths[strengths > weakest]


def _tiles(usable: list[Picture]) -> list[tuple[int, int, int]]:
    """View, first row and first column of the tiles that hold usable pixels."""
    return [
        (number, top, left)
        for number, mask in enumerate(usable)
        for top in range(0, mask.shape[0], _TILE_PX)
        for left in range(0, mask.shape[1], _TILE_PX)
        if mask[top : top + _TILE_PX, left : left + _TILE_PX].any()
    ]


def _rank_in_group(groups: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many entries before each one have the same value."""
    order = np.argsort(groups, kind="stable")
    ordered = groups[order]
    first = np.searchsorted(ordered, ordered)
    ranks = np.empty(len(groups), dtype=np.int64)
    ranks[order] = np.arange(len(groups)) - first
    return ranks
