# SPDX-License-Identifier: BSD-3-Clause
"""What the surfaces that pairs share say about other pairs.

`place_evidence` asks for points that pairs matched; here whole surfaces are asked for, which grow
from these points (`features.shared_surfaces`), so that much more of both views has a say.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.features.shared_surfaces import (
    NUM_CELLS,
    SeenCells,
    SharedSurfaces,
    grid,
    likeness_of,
)
from epi360.features.sphere_cells import SphereCells
from epi360.features.warped_patches import Panorama
from epi360.places.shared_points import (
    MOST_WITNESSES,
    PLACE_SIGMA_DEG,
    PosedPair,
    place_sigmas_deg,
    scale_of,
    some_of,
)
from epi360.poses import Pose, poses_agree

Array = NDArray[np.float64]
Floats = NDArray[np.floating]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

OWN = -1  # the pair itself, as a source of depths
PARTS = SphereCells(183)  # of a view, of 15 degrees: what lies in one is one witness
FEWEST_PARTS = 4  # of either view, before surfaces say anything, and points anything for a pair
HIDDEN, VISIBLE, UNKNOWN = 1, 0, -1
_MOST_SIGHTINGS = 12_000_000  # of all pairs of a folder; 18 bytes each
_MOST_OF_ONE = 500  # of one witness
_FEWEST_SHARED = 12  # cells that put two pairs into one scale
_NEIGHBOURS_PER_WITNESS = 4.0  # neighbouring cells err together
_DEPTH_NOISE_DEG, _LEAST_PARALLAX_DEG = 0.15, 2.0
# A surface is sure if it is this alike, and if so many of its neighbours lie at its depth.
_SURE, _FEWEST_BESIDE, _ONE_SURFACE = 0.9, 3, 0.15
_NUM_NEAR, _FEWEST_NEAR = 8, 5  # cells that say how far the other camera sees in a direction
_HIDDEN_LOG = 0.16  # what lies so much behind what is seen there, as a logarithm, may be hidden
# Larger view changes say too little: poses of real tours are known to about a degree.
_VIEW_CHANGES_DEG, _LARGEST_CHANGE_DEG = (10.0, 20.0), 30.0
# Shares of the likeness of cells that both cameras must see, below 0.3, 0.4, ... 0.9 and above, if
# the pose is right (pairs of one room) and if it is not, by view change: six rendered homes.
_EDGES = np.array([0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
_IF_SAME = np.array(
    [
        [0.010, 0.003, 0.004, 0.005, 0.006, 0.014, 0.056, 0.902],
        [0.014, 0.004, 0.005, 0.007, 0.012, 0.024, 0.086, 0.848],
        [0.032, 0.010, 0.012, 0.015, 0.022, 0.045, 0.134, 0.730],
    ]
)
_IF_OTHER = np.array(
    [
        [0.371, 0.087, 0.091, 0.089, 0.081, 0.067, 0.056, 0.158],
        [0.343, 0.087, 0.090, 0.087, 0.082, 0.071, 0.067, 0.173],
        [0.303, 0.082, 0.083, 0.084, 0.080, 0.074, 0.085, 0.209],
    ]
)
_RATIOS = np.log(_IF_SAME / _IF_OTHER)
# Cells of one part of a view are not independent: so many of them tell as much as all.
_FEWEST_CELLS, _MOST_INDEPENDENT, _LARGEST_RATIO = 2, 3.0, 5.0
# Shares of the parts that are the same: nearly all if the pose is right. Things that move and wrong
# depths speak against right pairs too, and most of a copy looks the same: surfaces may not decide.
_SHARES = np.array([0.95, 0.8, 0.65, 0.5, 0.3, 0.1])
_LIMITS = (-1.0, 1.0)
# Poses of siblings agree to this; a step shorter than this share of the baseline says nothing.
_ROTATIONS_AGREE_DEG, _DIRECTIONS_AGREE_DEG, _SHORTEST_STEP = 2.5, 6.0, 0.2


@dataclass(frozen=True, eq=False)
class KnownView:
    """Depths that a pair knows in the view of one of its cameras, in units of its translation.

    ``log_sigmas`` are the standard deviations of their logarithms; `is_sure` says which are sure
    enough to be looked for in other views.
    """

    cells: NDArray[np.int16]
    depths: NDArray[np.float32]
    normals: NDArray[np.float16]
    log_sigmas: NDArray[np.float16]
    is_sure: Mask

    @classmethod
    def of(cls, surfaces: SharedSurfaces, other_from_camera: Pose) -> KnownView:
        """What is kept of the surfaces that a pair shares."""
        (cells,) = np.nonzero(surfaces.found)
        depths = np.where(surfaces.found, surfaces.depths, np.nan)
        with np.errstate(invalid="ignore"):
            gaps = np.abs(np.log(depths[grid().neighbours[cells]] / depths[cells, None]))
        changes_deg = SeenCells.of(other_from_camera, cells, depths[cells]).changes_deg
        is_sure = np.sum(gaps < _ONE_SURFACE, axis=1) >= _FEWEST_BESIDE
        is_sure &= (surfaces.likeness[cells] > _SURE) & (changes_deg > _LEAST_PARALLAX_DEG)
        sines = np.sin(np.radians(np.clip(changes_deg, _LEAST_PARALLAX_DEG, 90.0)))
        return cls(
            cells.astype(np.int16),
            surfaces.depths[cells],
            surfaces.normals[cells].astype(np.float16),
            (np.radians(_DEPTH_NOISE_DEG) / sines).astype(np.float16),
            is_sure,
        )

    def as_map(self) -> Array:
        """Depth of every cell, NaN where it is not known."""
        depths = np.full(NUM_CELLS, np.nan)
        depths[self.cells] = self.depths
        return depths


class LogScale(NamedTuple):
    """Logarithm of the factor between two pairs' units, its sigma, and how many cells say so."""

    log_scale: float
    sigma: float
    num_cells: int


def log_scale_to(own: Array, other: KnownView) -> LogScale | None:
    """How large the units of another pair of a panorama are in ours, by what both know of it.

    ``own`` are our depths of all cells, see `KnownView.as_map`. None where too little says it.
    """
    ratios = np.log(own[other.cells] / other.depths)
    ratios = ratios[~np.isnan(ratios)]
    if len(ratios) < _FEWEST_SHARED:
        return None
    scale = scale_of(ratios, len(ratios) / _NEIGHBOURS_PER_WITNESS)
    return None if scale is None else LogScale(*scale, len(ratios))


def known_views(
    pair: PosedPair, surfaces: tuple[SharedSurfaces, SharedSurfaces]
) -> tuple[KnownView, KnownView]:
    """What a pair knows of both its views, by the surfaces that have grown in them."""
    first, second = surfaces
    return KnownView.of(first, pair.other_from(0)), KnownView.of(second, pair.other_from(1))


@dataclass(frozen=True, eq=False)
class SurfaceSightings:
    """Cells of one view of a pair that were looked for in the other.

    Attributes
    ----------
    witnesses : ndarray of int, shape (N,)
        Pair that knows the depth of each.
    cells : ndarray of int, shape (N,)
        Cells of `features.shared_surfaces.grid`.
    ratios : ndarray, shape (N,)
        Log-likelihood ratio that the same surface is seen there, over another one.
    sources : ndarray of int, shape (S,)
        Pairs that know depths in the other view; `OWN` is the pair itself.
    hidden : ndarray of int, shape (N, S)
        `HIDDEN`, `VISIBLE` or `UNKNOWN`, as each source says.
    """

    witnesses: NDArray[np.int32]
    cells: NDArray[np.int16]
    ratios: NDArray[np.float32]
    sources: Indices
    hidden: NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class _Witness:
    """What another pair knows about a view, with what makes it this pair's units."""

    pair: int
    view: KnownView
    log_scale: float
    scale_sigma: float

    def placed(self, pair: PosedPair, side: int, most: int) -> tuple[Indices, Array, Floats]:
        """Some cells with depths and normals whose places in the other view are known."""
        (rows,) = np.nonzero(self.view.is_sure)
        cells = self.view.cells[rows].astype(np.int64)
        depths = self.view.depths[rows] * np.exp(self.log_scale)
        seen = SeenCells.of(pair.other_from(side), cells, depths)
        log_sigmas = np.hypot(self.view.log_sigmas[rows].astype(np.float64), self.scale_sigma)
        sigmas = place_sigmas_deg(pair, side, seen.points, log_sigmas)
        kept = (sigmas < PLACE_SIGMA_DEG) & (seen.changes_deg < _LARGEST_CHANGE_DEG)
        (good,) = np.nonzero(kept)
        good = some_of(good, most)
        return cells[good], depths[good], self.view.normals[rows[good]]


@dataclass(frozen=True)
class Sibling:
    """A pair that says the same as another one if a third, ``via``, is right."""

    pair: int
    via: int


def _agrees(pose: Pose, expected: Pose) -> bool:
    """Whether rotations and directions are equal; short steps have no direction to compare."""
    if float(np.linalg.norm(expected.translation)) < _SHORTEST_STEP:
        return False
    return poses_agree(pose, expected, _ROTATIONS_AGREE_DEG, _DIRECTIONS_AGREE_DEG)


@dataclass(frozen=True, eq=False)
class SurfaceWitnesses:
    """All pairs of a folder with what they know about the views of its panoramas.

    Only some of the pairs are asked.
    """

    pairs: Sequence[PosedPair]
    views: Mapping[tuple[int, int], KnownView]  # by pair and side
    at: Mapping[int, Sequence[tuple[int, int]]]  # pairs and sides of each panorama
    rows_of: Mapping[frozenset[int], Sequence[int]]  # pairs of two panoramas

    @classmethod
    def of(
        cls,
        pairs: Sequence[PosedPair],
        views: Mapping[tuple[int, int], KnownView],
        num_heard: int | None = None,
    ) -> SurfaceWitnesses:
        """Pairs that know most come first at each panorama; only the first so many are asked."""
        heard = [key for key in views if key[0] < len(pairs[:num_heard])]
        at: dict[int, list[tuple[int, int]]] = {}
        for row, side in sorted(heard, key=lambda key: (-len(views[key].cells), key)):
            at.setdefault(pairs[row].images[side], []).append((row, side))
        rows_of: dict[frozenset[int], list[int]] = {}
        for row, pair in enumerate(pairs[:num_heard]):
            rows_of.setdefault(frozenset(pair.images), []).append(row)
        return cls(pairs, views, at, rows_of)

    def asked(
        self, row: int, panoramas: Sequence[Panorama]
    ) -> tuple[tuple[SurfaceSightings, SurfaceSightings], tuple[Sibling, ...]]:
        """Look for what other pairs know of either view of a pair in the other, and for siblings.

        ``panoramas`` are those of both sides.
        """
        witnesses = (self._witnesses(row, 0), self._witnesses(row, 1))
        first, second = panoramas
        sightings = (
            self._sightings(row, 0, first, second, witnesses),
            self._sightings(row, 1, second, first, witnesses),
        )
        return sightings, tuple(self._siblings(row, witnesses))

    def _sightings(
        self,
        row: int,
        side: int,
        first: Panorama,
        second: Panorama,
        witnesses: Sequence[Sequence[_Witness]],
    ) -> SurfaceSightings:
        """What is known of the view of a side, ``first``, looked for in that of the other."""
        pair, pose = self.pairs[row], self.pairs[row].other_from(side)
        most = min(_MOST_OF_ONE, _MOST_SIGHTINGS // (2 * MOST_WITNESSES * len(self.pairs)))
        placed = [each.placed(pair, side, most) for each in witnesses[side]]
        cells = np.concatenate([np.empty(0, np.int64), *(each[0] for each in placed)])
        depths = np.concatenate([np.empty(0), *(each[1] for each in placed)])
        normals = np.concatenate([np.empty((0, 3)), *(each[2] for each in placed)])
        names = np.repeat(
            [each.pair for each in witnesses[side]], [len(each[0]) for each in placed]
        )
        seen = SeenCells.of(pose, cells, depths)
        shown = second.counts_at(seen.points)
        seen = seen.chosen(shown)
        cells, depths, normals, names = (e[shown] for e in (cells, depths, normals, names))
        alike = likeness_of(first, second, pose, cells, depths, normals)
        changes = np.digitize(seen.changes_deg, _VIEW_CHANGES_DEG)
        sources, hidden = self._hidden(row, 1 - side, seen, witnesses[1 - side])
        return SurfaceSightings(
            names.astype(np.int32),
            cells.astype(np.int16),
            _RATIOS[changes, np.digitize(alike, _EDGES)].astype(np.float32),
            sources,
            hidden,
        )

    def _siblings(self, row: int, witnesses: Sequence[Sequence[_Witness]]) -> Iterator[Sibling]:
        """Pairs that are right if this one is, and wrong if it is wrong."""
        images = self.pairs[row].images
        for side in (0, 1):
            here, there = images[side], images[1 - side]
            for each in witnesses[side]:
                witness = self.pairs[each.pair]
                witness_side = witness.images.index(here)
                beyond = witness.images[1 - witness_side]
                pose = witness.other_from(witness_side)
                step = Pose(pose.rotation, np.exp(each.log_scale) * pose.translation)
                expected = self.pairs[row].other_from(side) @ step.inverse()
                for other in self.rows_of.get(frozenset((beyond, there)), ()):
                    pair = self.pairs[other]
                    if _agrees(pair.other_from(pair.images.index(beyond)), expected):
                        yield Sibling(other, each.pair)

    def _witnesses(self, row: int, side: int) -> list[_Witness]:
        """Pairs that know the view of a side, in one scale with this pair."""
        own = self.views[row, side].as_map()
        found: list[_Witness] = []
        for other, other_side in self.at.get(self.pairs[row].images[side], ()):
            if other == row or len(found) == MOST_WITNESSES:
                continue
            view = self.views[other, other_side]
            told = log_scale_to(own, view)
            if told is not None:
                found.append(_Witness(other, view, told.log_scale, told.sigma))
        return found

    def _hidden(
        self, row: int, side: int, seen: SeenCells, witnesses: Sequence[_Witness]
    ) -> tuple[Indices, NDArray[np.int8]]:
        """What the pair and others know about things in front of points in the view of a side."""
        near = grid().nearest(seen.directions, _NUM_NEAR)
        maps = {OWN: self.views[row, side].as_map()}
        for each in witnesses:
            maps[each.pair] = np.exp(each.log_scale) * each.view.as_map()
        states = [_states(depths[near], seen.ranges) for depths in maps.values()]
        return np.array(list(maps), np.int64), np.stack(states, axis=1)


def _states(depths: Array, ranges: Array) -> NDArray[np.int8]:
    """Whether depths (N, K) that are known near points hide these."""
    num_known = np.sum(~np.isnan(depths), axis=1)
    nearest = np.where(np.isnan(depths), np.inf, depths).min(axis=1)
    is_behind = (np.log(ranges) - np.log(nearest) >= _HIDDEN_LOG) & (num_known >= 2)
    states = np.where(num_known >= _FEWEST_NEAR, VISIBLE, UNKNOWN)
    return np.where(is_behind, HIDDEN, states).astype(np.int8)


def surfaces_ratio(sides: Sequence[SurfaceSightings], trusted: Mask) -> float:
    """Log-likelihood ratio of a pose over any other, by what trusted pairs know; limited."""
    if len(sides) == 0:
        return 0.0
    places = [_place_ratios(each, trusted) for each in sides]
    ratios = np.concatenate(places)
    logs = np.log(_SHARES * np.exp(ratios)[:, None] + 1 - _SHARES).sum(axis=0)
    ratio = float(logs[0] - logs[1:].max())
    if min(len(each) for each in places) < FEWEST_PARTS:
        return 0.0  # a door that one camera knows well matches all doors of its kind
    return float(np.clip(ratio, *_LIMITS))


def surfaces_against(sides: Sequence[SurfaceSightings], trusted: Mask) -> Array:
    """What each pair (N,) that is trusted says against a pose, as a sum over its cells."""
    told = np.zeros(len(trusted))
    for each in sides:
        kept = _must_be_seen(each, trusted)
        told -= np.bincount(each.witnesses[kept], each.ratios[kept], minlength=len(trusted))
    return told


def _must_be_seen(sightings: SurfaceSightings, trusted: Mask) -> Mask:
    """Cells of trusted pairs that nothing hides, as far as trusted pairs know."""
    heeded = (sightings.sources == OWN) | trusted[sightings.sources]
    states = sightings.hidden[:, heeded]
    kept: Mask = np.any(states == VISIBLE, axis=1) & ~np.any(states == HIDDEN, axis=1)
    return kept & trusted[sightings.witnesses]


def _place_ratios(sightings: SurfaceSightings, trusted: Mask) -> Array:
    """Log-likelihood ratio of each part of a view that both cameras must see."""
    kept = _must_be_seen(sightings, trusted)
    cells = sightings.cells[kept].astype(np.int64)
    counts = np.bincount(cells, minlength=NUM_CELLS)
    sums = np.bincount(cells, sightings.ratios[kept], minlength=NUM_CELLS)
    (seen,) = np.nonzero(counts)
    parts = _parts()[seen]
    num_cells = np.bincount(parts)
    (asked,) = np.nonzero(num_cells >= _FEWEST_CELLS)
    means = np.bincount(parts, sums[seen] / counts[seen])[asked] / num_cells[asked]
    told: Array = means * np.minimum(np.sqrt(num_cells[asked]), _MOST_INDEPENDENT)
    return np.clip(told, -_LARGEST_RATIO, _LARGEST_RATIO)


@cache
def _parts() -> Indices:
    """Part of the view, of 15 degrees, that each cell lies in."""
    return PARTS.indices(grid().directions.astype(np.float64))
