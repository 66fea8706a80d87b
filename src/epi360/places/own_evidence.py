# SPDX-License-Identifier: BSD-3-Clause
"""What a pair shows by itself: the shape of what grows in both views, and what differs in it.

Of a right pair, surfaces (`features.shared_surfaces`) grow until something hides them or they are
bare: few of the cells lie at edges, and few are holes, cells that must be there, by those around
them, and look different. A copy of the room grows as far, and has holes where its owners put other
things. Of another place with the same door little grows, and it frays out.

Seven numbers say so, see `shown_by`. Right pairs are told from pairs of copies, and from those of
other rooms, by logistic regression on the numbers, their squares and products.
`benchmarks/own_evidence.py` fits it to rendered homes, which have copies, and to real tours, and
writes ``own_evidence.json``; and once more to the homes alone, for folders in which copies are.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from epi360.features.shared_surfaces import (
    LEAST_CONTRAST,
    SeenCells,
    SharedSurfaces,
    grid,
    grow_surfaces,
)
from epi360.features.warped_patches import Panorama
from epi360.places.one_surface import on_floor, on_one_wall
from epi360.places.shared_points import PosedPair, cloud_of, floor_share

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Item = TypeVar("Item")
Found = TypeVar("Found")

WEIGHTS = "own_evidence.json"  # beside this file
EVERY, HOMES = "homes_and_tours", "homes"  # what its weights were fitted to
SHOWN = ("edges", "turned", "strong", "bare", "faint", "inside", "textured")  # see `shown_by`

# Logarithm of the 95th percentile of distances over the 5th. Of rooms that are taken for their
# copies 4 % have more, and of street scenes nearly all.
LARGEST_SPREAD = 1.8
# Of the sphere, clear of masks and edges: what either view must show, and below which it is a part.
_LEAST_SHARE, _PART = 0.15, 0.55
_DIFFERS, _CLEARLY_HIDDEN = 0.5, 0.8
_ONE_SURFACE = 0.15  # largest difference of the logarithms of distances
_FAINT, _STRONG = 8.0, 12.0  # contrasts, in grey values
_TURNED_DEG, _MUCH_TURNED_DEG = 20.0, 45.0
# Of right pairs in rooms most of whose inliers lie on the floor, so much of what grew and more is
# above the horizon, if so many cells of either view have a texture there; of rooms that have the
# floor alone in common 0.02 and less.
_MOSTLY_ON_FLOOR, _LEAST_ABOVE, _FEWEST_ABOVE = 0.85, 0.04, 50
_HORIZON = np.sin(np.radians(5.0))
_LEAST_AMONG_DOORS = -0.5  # log-odds in a corridor
_NUM_NEXT = 6  # cells around each that say what is nearest there


@dataclass(frozen=True)
class OwnEvidence:
    """Log-likelihood ratios of a pose by what the pair shows by itself.

    Over that of another place with a similar thing, and over that of a copy of the place. Both must
    speak for a pair: where nothing grows, it is no copy either. ``inliers_on_floor`` and
    ``on_one_wall`` say that nearly all inliers lie there, which rooms may have alike, and
    ``grown_on_floor`` that nearly all that grew does, though there is more to see. ``in_the_open``
    says that what both show lies at distances that differ more than in a room, ``repeats`` that it
    is a corridor whose things repeat (`among_equal_doors`), ``is_partial`` that either view shows
    little more than a hemisphere, or less. Nothing is known if either view shows too little.
    ``as_in_homes`` has both ratios by the weights that were fitted to homes alone; a pair on one
    wall is always weighed by these.
    """

    over_others: float = 0.0
    over_copies: float = 0.0
    inliers_on_floor: bool = False
    on_one_wall: bool = False
    grown_on_floor: bool = False
    in_the_open: bool = False
    repeats: bool = False
    is_partial: bool = False
    is_known: bool = True
    as_in_homes: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, pair: PosedPair, views: tuple[SharedSurfaces, SharedSurfaces]) -> OwnEvidence:
        """Weigh what has grown from both sides of a pair; nothing if they show too little."""
        share = min(map(_share_that_counts, views))
        if share < _LEAST_SHARE:
            return cls(is_known=False, is_partial=True)
        shown = shown_by(pair, views)
        by_all, as_in_homes = _FITTED.ratios(shown), _FITTED_TO_HOMES.ratios(shown)
        in_the_open = min(depth_spread(view.depths[view.found]) for view in views) > LARGEST_SPREAD
        is_on_one_wall = not in_the_open and on_one_wall(pair)  # a street may have one long front
        return cls(
            *(as_in_homes if is_on_one_wall else by_all),
            inliers_on_floor=on_floor(pair),
            on_one_wall=is_on_one_wall,
            grown_on_floor=not in_the_open and _grown_on_floor(pair, views),
            in_the_open=in_the_open,
            is_partial=share < _PART,
            as_in_homes=as_in_homes,
        )

    def weighed_as_in_homes(self) -> OwnEvidence:
        """The same by the weights that were fitted to homes alone."""
        if self.repeats:
            return self
        over_others, over_copies = self.as_in_homes
        return replace(self, over_others=over_others, over_copies=over_copies)

    def among_equal_doors(self, odds: float) -> OwnEvidence:
        """The same in a corridor, whose copies are equal doors; ``odds`` are those of the pose."""
        over_copies = max(odds, _LEAST_AMONG_DOORS)
        return replace(self, over_copies=over_copies, repeats=True, in_the_open=False)


@dataclass(frozen=True, eq=False)
class Scaling:
    """How the seven numbers are scaled for a regression.

    ``least`` and ``most`` (7,) limit them, for nothing is known beyond what pairs have shown. What
    is then is taken in units of ``spread`` (7,) from ``centre`` (7,).
    """

    least: Array
    most: Array
    centre: Array
    spread: Array

    @classmethod
    def of_record(cls, record: Mapping[str, Any]) -> Self:
        """Take values of the file."""
        return cls(**{each.name: np.array(record[each.name]) for each in fields(cls)})

    def scaled(self, shown: Array) -> Array:
        """What is shown (..., 7), limited and in these units."""
        scaled: Array = (np.clip(shown, self.least, self.most) - self.centre) / self.spread
        return scaled


@dataclass(frozen=True, eq=False)
class Weights(Scaling):
    """How much the seven numbers speak for right pairs, as quadratic functions of them.

    `terms` of them, scaled, are weighed by ``over_others`` and ``over_copies`` (36,).
    """

    over_others: Array
    over_copies: Array

    def ratios(self, shown: Array) -> tuple[float, float]:
        """Log-likelihood ratios of right pairs over those of other rooms, and over copies."""
        told = terms(self.scaled(shown))
        return float(told @ self.over_others), float(told @ self.over_copies)


def terms(scaled: Array) -> Array:
    """One, the numbers (..., 7), and their squares and products: (..., 36)."""
    first, second = np.triu_indices(scaled.shape[-1])
    one = np.ones((*scaled.shape[:-1], 1))
    return np.concatenate([one, scaled, scaled[..., first] * scaled[..., second]], axis=-1)


_RECORD: dict[str, Any] = json.loads(files(__package__).joinpath(WEIGHTS).read_text("utf-8"))
_FITTED, _FITTED_TO_HOMES = (Weights.of_record(_RECORD[kind]) for kind in (EVERY, HOMES))


def grow_both(
    pair: PosedPair, panoramas: Sequence[Panorama], *, num_threads: int = 1
) -> tuple[SharedSurfaces, SharedSurfaces]:
    """Surfaces of each of both panoramas that the other one shows too."""

    def grown(side: int) -> SharedSurfaces:
        points = cloud_of(pair, side, 0.0).points
        here, there = panoramas[side], panoramas[1 - side]
        return grow_surfaces(here, there, pair.other_from(side), points)

    return of_both(grown, (0, 1), num_threads)


def of_both(
    work: Callable[[Item], Found], both: Sequence[Item], num_threads: int
) -> tuple[Found, Found]:
    """What is found of each of two, one after the other or on threads."""
    if num_threads == 1:
        first, second = map(work, both)
    else:
        with ThreadPoolExecutor(num_threads) as pool:
            first, second = pool.map(work, both)
    return first, second


def shown_by(pair: PosedPair, views: tuple[SharedSurfaces, SharedSurfaces]) -> Array:
    """Logarithms (7,) of shares and numbers of textured cells that both views must show.

    In the order of `SHOWN`: the share at the edge of a surface; the number that is seen from
    directions more than 45 degrees apart, and that of much contrast; the share that the other view
    shows bare; and the shares that differ, of those of little contrast, of those inside of surfaces
    that are seen from nearly one direction, and of those that the other view shows textured. Cells
    that are seen from directions more than 45 degrees apart do not count in the last three. Numbers
    are those of whole spheres, if the views are parts of them.
    """
    sides = (_Expected.of(pair, side, views) for side in (0, 1))
    cells = _Expected(*(np.concatenate(each) for each in zip(*sides, strict=True)))
    turned, much_turned = (cells.turned_deg >= limit for limit in (_TURNED_DEG, _MUCH_TURNED_DEG))
    bare = cells.other_contrasts < LEAST_CONTRAST
    whole = 2.0 / sum(map(_share_that_counts, views))
    return np.array(
        [
            _log_share(cells.at_edge),
            _log_number(much_turned, whole),
            _log_number(cells.contrasts > _STRONG, whole),
            _log_share(bare),
            _log_share(cells.differs[~much_turned & (cells.contrasts < _FAINT)]),
            _log_share(cells.differs[~turned & ~cells.at_edge]),
            _log_share(cells.differs[~much_turned & ~bare]),
        ]
    )


class _Expected(NamedTuple):
    """Textured cells (N,) that both views must show, by the cells around them.

    ``contrasts`` and ``other_contrasts`` are those of both views, ``turned_deg`` angles between
    both rays.
    """

    contrasts: Floats
    other_contrasts: Floats
    differs: Mask
    at_edge: Mask
    turned_deg: Array

    @classmethod
    def of(cls, pair: PosedPair, side: int, views: Sequence[SharedSurfaces]) -> _Expected:
        """Cells of one side of a pair that nothing hides from the other, nor a mask."""
        here, there = views[side], views[1 - side]
        expected = (here.expected_depths > 0) & (here.contrasts >= LEAST_CONTRAST)
        (cells,) = np.nonzero(expected & here.counts)
        seen = SeenCells.of(pair.other_from(side), cells, here.expected_depths[cells])
        others = grid().nearest(seen.directions, 1).ravel()
        hidden = _nearest_shown(there)[others] < _CLEARLY_HIDDEN * seen.ranges
        kept = ~hidden & there.counts[others]
        cells = cells[kept]
        return cls(
            here.contrasts[cells],
            there.contrasts[others[kept]],
            here.expected_likeness[cells] < _DIFFERS,
            _at_edge(here, cells),
            seen.changes_deg[kept],
        )


def _nearest_shown(view: SharedSurfaces) -> Floats:
    """Distance (N,) of the nearest thing that a cell and those next to it show, or infinity."""
    ranges = np.where(view.found, view.depths, np.float32(np.inf))
    nearest: Floats = np.minimum(ranges, ranges[grid().around[:, :_NUM_NEXT]].min(axis=1))
    return nearest


def _share_that_counts(view: SharedSurfaces) -> float:
    """Share of the cells that no mask reaches."""
    return float(np.mean(view.counts))


def depth_spread(depths: NDArray[np.floating]) -> float:
    """How much distances (N,) differ; 0 where there are none."""
    if len(depths) == 0:
        return 0.0
    nearest, farthest = np.percentile(depths, [5, 95])
    return float(np.log(farthest / nearest))


def _grown_on_floor(pair: PosedPair, views: Sequence[SharedSurfaces]) -> bool:
    """Whether what grew is on the floor, as nearly all inliers, though both show more than that."""
    if floor_share(*pair.bearings) < _MOSTLY_ON_FLOOR:
        return False
    is_above = grid().directions[:, 1] < -_HORIZON
    textured = [view.counts & (view.contrasts >= LEAST_CONTRAST) for view in views]
    if min(int((each & is_above).sum()) for each in textured) < _FEWEST_ABOVE:
        return False
    grown = [view.found & each for view, each in zip(views, textured, strict=True)]
    num_grown = sum(int(each.sum()) for each in grown)
    num_above = sum(int((each & is_above).sum()) for each in grown)
    return num_above < _LEAST_ABOVE * num_grown


def _at_edge(view: SharedSurfaces, cells: Indices) -> Mask:
    """Whether the found cells of one surface around each cell leave half a turn free."""
    around = grid().around[cells]
    with np.errstate(divide="ignore"):
        apart = np.abs(np.log(view.depths[around] / view.expected_depths[cells, None]))
    same = apart < _ONE_SURFACE  # infinite where nothing was found
    azimuths = _azimuths()[cells]
    first = np.where(same, azimuths, np.pi).min(axis=1, keepdims=True)
    turns = np.sort(np.where(same, azimuths, first), axis=1)
    free = np.append(np.diff(turns, axis=1), turns[:, :1] + 2 * np.pi - turns[:, -1:], axis=1)
    edge: Mask = free.max(axis=1) >= np.pi
    return edge


@cache
def _azimuths() -> Array:
    """Directions (N, 24), as angles about each cell, in which those around it lie."""
    centres = grid().directions.astype(np.float64)
    to_others = centres[grid().around] - centres[:, None]
    is_steep = np.abs(centres[:, 1:2]) > 0.9
    axes = np.cross(np.where(is_steep, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]), centres)
    across = np.cross(centres, axes)
    angles: Array = np.arctan2(
        np.sum(to_others * across[:, None], axis=2), np.sum(to_others * axes[:, None], axis=2)
    )
    return angles


def _log_share(which: Mask) -> float:
    """Logarithm of a share; that of few cells is drawn to a tenth."""
    return float(np.log((np.count_nonzero(which) + 3) / (len(which) + 30)))


def _log_number(which: Mask, factor: float) -> float:
    """Logarithm of a number times a factor; small ones do not differ much."""
    return float(np.log(factor * np.count_nonzero(which) + 20))
