# SPDX-License-Identifier: BSD-3-Clause
"""Features of a new image and the points of a map that they may show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.absolute_evidence import directions_of
from epi360.features import Features, match_features
from epi360.jobs.localization.map_views import MapView
from epi360.jobs.localization.new_image import NewImage
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# The second look, guided by a pose. On rendered rooms and theta_flat, descriptors of one point are
# more alike than this in 9 of 10 cases, those of two points that lie near each other in 1 of 10.
_LEAST_SIMILARITY = 0.8
_NUM_NEAR = 8  # features near a point that are compared with it
_DISPLACED_RAD = 0.12  # chance is what a pose turned by so much finds
_TURNS = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))


@dataclass(frozen=True, eq=False)
class MapMatches:
    """Row i of all: feature of the new image, point, its covariance and id, number of the view."""

    rows: Indices
    points: Array
    covariances: Array
    ids: Indices
    views: Indices

    def __len__(self) -> int:
        return len(self.rows)

    def chosen(self, index: NDArray[np.bool_] | Indices) -> MapMatches:
        """Those of a mask or of indices."""
        return MapMatches(
            self.rows[index],
            self.points[index],
            self.covariances[index],
            self.ids[index],
            self.views[index],
        )


def no_matches() -> MapMatches:
    """No match at all."""
    nothing = np.zeros(0, dtype=np.int64)
    return MapMatches(nothing, np.zeros((0, 3)), np.zeros((0, 3, 3)), nothing, nothing)


def joined(parts: Sequence[MapMatches]) -> MapMatches:
    """All matches; a feature and a point that several images match stand there once."""
    if not parts:
        return no_matches()
    names = ("rows", "points", "covariances", "ids", "views")
    everything = MapMatches(*(np.concatenate([getattr(part, n) for part in parts]) for n in names))
    pairs = np.column_stack([everything.rows, everything.ids])
    _, first = np.unique(pairs, axis=0, return_index=True)
    return everything.chosen(np.sort(first))


def matches_with(view: MapView, number: int, features: Features) -> MapMatches:
    """Matches by descriptors alone, where the image of the map knows the point."""
    # Only features with a point: a third of the work.
    matches = match_features(view.known, features)
    return _of_view(view, number, view.rows[matches[:, 0]], matches[:, 1])


@dataclass(frozen=True, eq=False)
class SecondLook:
    """What a pose finds: matches, and the share of the points in sight that the image shows.

    ``chance_share`` is what poses that are turned by 7 degrees find.
    """

    matches: MapMatches
    seen_share: float
    chance_share: float


def look_again(
    views: Sequence[tuple[int, MapView]], new: NewImage, pose: Pose, radius_rad: float
) -> SecondLook:
    """Matches of points with features that are near where a pose says they are, and look alike."""
    parts = []
    found = np.zeros(1 + len(_TURNS))
    num_in_sight = 0
    for number, view in views:
        directions = directions_of(pose, view.points[view.rows])
        in_sight = np.isfinite(new.camera.pixels_from_bearings(directions)[:, 0])
        rows, directions = view.rows[in_sight], directions[in_sight]
        num_in_sight += len(rows)
        for number_of_turn, these in enumerate(turned(directions)):
            near = similar_near(view, rows, new, these, radius_rad)
            found[number_of_turn] += np.count_nonzero(near >= 0)
            if number_of_turn == 0:
                kept = near >= 0
                parts.append(_of_view(view, number, rows[kept], near[kept]))
    shares = found / max(num_in_sight, 1)
    return SecondLook(joined(parts), float(shares[0]), float(shares[1:].max()))


def turned(directions: Array) -> list[Array]:
    """Directions, and where poses that are turned by 7 degrees have them."""
    turns = [rotation_from_vector(_DISPLACED_RAD * axis) for axis in _TURNS]
    return [directions, *(directions @ turn.T for turn in turns)]


def similar_near(
    view: MapView,
    rows: NDArray[np.intp],
    new: NewImage,
    directions: Array,
    radius_rad: float,
) -> Indices:
    """Feature that is near each direction and most like the point's; -1 where none is."""
    nothing = np.full(len(rows), -1, dtype=np.int64)
    if not len(rows) or not new.tree.n:
        return nothing
    count = min(_NUM_NEAR, new.tree.n)
    limit = 2.0 * np.sin(0.5 * radius_rad)
    every = np.arange(1, count + 1)
    chords, near = new.tree.query(directions, every, distance_upper_bound=limit)
    is_near = np.isfinite(chords)
    near = np.where(is_near, near, 0)
    described = view.features.descriptors[rows]
    similarity = np.einsum("nd,nkd->nk", described, new.features.descriptors[near])
    similarity = np.where(is_near, similarity, -1.0)
    best = similarity.argmax(axis=1)
    chosen = np.arange(len(rows)), best
    return np.where(similarity[chosen] > _LEAST_SIMILARITY, near[chosen], nothing)


def _of_view(view: MapView, number: int, own: Indices, rows: Indices) -> MapMatches:
    return MapMatches(
        np.asarray(rows, np.int64),
        view.points[own],
        view.covariances[own],
        view.ids[own],
        np.full(len(rows), number, dtype=np.int64),
    )
