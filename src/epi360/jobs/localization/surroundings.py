# SPDX-License-Identifier: BSD-3-Clause
"""Whether a new image shows what the map knows around its pose, or stands in a copy of the place.

All that a room shares with its twin agrees on a pose in the twin. But the images of the map also
know what only the twin has: their points must be visible from the pose, and most of them have no
like in the new image. `epi360.jobs.graph.place_evidence` asks the same of pairs, with pictures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.features.sphere_cells import SphereCells
from epi360.jobs.graph.place_evidence import log_beyond
from epi360.jobs.localization.map_matches import MapMatches, similar_near, turned
from epi360.jobs.localization.map_views import LocalizationMap, MapView
from epi360.jobs.localization.new_image import NewImage
from epi360.places.shared_points import Cloud
from epi360.poses import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_CELLS = SphereCells(183)  # of 15 degrees
_MOST_WITNESSES, _FEWEST_SHARED = 6, 15  # images that are asked; points of the pose that each sees
_HIDDEN = 0.2  # log of distances: a point so much behind what is known there may be hidden
_MOST_OF_CELL = 4.0  # a cell with more points counts like so many: they are not independent
# Of the points in sight that are the same, the share that a new image shows as well: 0.45 to 0.85
# of the best witness on rendered homes and on three real sets. Of other points, by chance.
_SHOWN, _SHOWN_SIGMA, _LEAST_CHANCE, _MOST_CHANCE = 0.6, 0.1, 0.03, 0.95
_RATES = np.linspace(0.2, 0.9, 15)
_SHARES = np.linspace(0.02, 1.0, 50)
# Of 96 rendered panoramas, each in maps with and without its room, 47 of 66 right poses have this
# probability and 1 of 78 wrong ones; most of the other right ones see the map through a door only.
_LEAST_SHARE, LEAST_PROBABILITY = 0.6, 0.6


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What the image of the map that speaks most for a pose says of it.

    ``share`` of ``num_parts`` parts of the view, of those in which this image must have points in
    sight, looks the same; ``probability`` is that of a share as large as of no copy.
    """

    share: float = math.nan
    num_parts: int = 0
    probability: float = 0.0
    witness: str = ""

    @property
    def confirm(self) -> bool:
        """Whether the pose is that of the place, and not of a copy of it."""
        return self.probability >= LEAST_PROBABILITY


def surroundings_at(
    world: LocalizationMap,
    inliers: MapMatches,
    pose: Pose,
    new: NewImage,
    radius_rad: float,
    left_out: Set[int],
) -> Surroundings:
    """Ask the images of the map around a pose for the points that must be visible from there."""
    views = [world.view(number) for number in _witnesses(world, inliers, pose, left_out)]
    seen = [_moved(pose, view.points[view.rows]) for view in views]
    clouds = [_cloud(each) for each in (*seen, _moved(pose, inliers.points))]
    best = Surroundings()
    for view, points in zip(views, seen, strict=True):
        found = _asked(view, points, clouds, new, radius_rad)
        if found.probability > best.probability:
            best = found
    return best


def _witnesses(
    world: LocalizationMap, inliers: MapMatches, pose: Pose, left_out: Set[int]
) -> list[int]:
    """Images that see enough of the points that agree with a pose, the nearest ones."""
    # Points of features that were found anew are known to the images that were matched only.
    counts = np.maximum(
        world.num_seen(inliers.ids),
        np.bincount(inliers.views, minlength=len(world.model.images)),
    )
    counts[list(left_out)] = 0
    (able,) = np.nonzero(counts >= _FEWEST_SHARED)
    centers = world.centers[able]
    away = np.linalg.norm(centers - pose.inverse().translation, axis=1)
    return [int(k) for k in able[np.argsort(away, kind="stable")][:_MOST_WITNESSES]]


def _asked(
    view: MapView, points: Array, clouds: Sequence[Cloud], new: NewImage, radius_rad: float
) -> Surroundings:
    """What one image says; ``points`` are its own, in the frame of the new camera."""
    directions = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-300)
    kept = new.shows(directions) & ~_hidden(points, clouds)
    if not kept.any():
        return Surroundings()
    rows, directions = view.rows[kept], directions[kept]
    found, *by_chance = (
        similar_near(view, rows, new, each, radius_rad) >= 0 for each in turned(directions)
    )
    chance = float(np.clip(np.mean(by_chance), _LEAST_CHANCE, _MOST_CHANCE))
    _, cells = np.unique(_CELLS.indices(directions), return_inverse=True)
    num_found = np.asarray(np.bincount(cells, found), np.float64)
    likely = _likely_shares(np.bincount(cells), num_found, chance)
    return Surroundings(
        share=float(likely @ _SHARES),
        num_parts=int(cells.max()) + 1,
        probability=min(1.0, float(likely[_SHARES >= _LEAST_SHARE].sum())),
        witness=view.name,
    )


def _likely_shares(counts: NDArray[np.int64], found: Array, chance: float) -> Array:
    """Probability of each of `_SHARES` by the points in each cell and those of them found.

    A cell shows the same as in the map, and then each of its points with a rate that all such cells
    have in common, or something else.
    """
    weights = np.minimum(1.0, _MOST_OF_CELL / counts)
    shown, missing = (weights * found)[:, None], (weights * (counts - found))[:, None]
    same = shown * np.log(_RATES) + missing * np.log1p(-_RATES)
    other = shown * math.log(chance) + missing * math.log1p(-chance)
    with np.errstate(divide="ignore"):
        shares = np.log(_SHARES)[:, None, None], np.log1p(-_SHARES)[:, None, None]
    logs = np.logaddexp(shares[0] + same, shares[1] + other).sum(axis=1)
    logs -= 0.5 * ((_RATES - _SHOWN) / _SHOWN_SIGMA) ** 2
    odds = np.exp(logs - logs.max()).sum(axis=1)
    return np.asarray(odds / odds.sum())


def _hidden(points: Array, clouds: Sequence[Cloud]) -> Mask:
    """Points that lie behind what any of the clouds has in about the same direction."""
    hidden = np.zeros(len(points), dtype=bool)
    for cloud in clouds:
        hidden |= log_beyond(points, cloud) > _HIDDEN  # NaN where it has nothing
    return hidden


def _moved(pose: Pose, points: Array) -> Array:
    return np.asarray(points @ pose.rotation.T + pose.translation)


def _cloud(points: Array) -> Cloud:
    return Cloud(points, np.arange(len(points)), np.zeros(len(points)))
