# SPDX-License-Identifier: BSD-3-Clause
"""What the surroundings that are known from elsewhere look like where a pair says they must be.

The points that other pairs of a panorama triangulate lie, if a pair is right, at known places in
the view of its other camera. Which of them are nearer than what that camera sees there is known as
well. Such points must be visible, and look the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360.features.shared_surfaces import LEAST_CONTRAST
from epi360.features.warped_patches import Panorama, likeness
from epi360.jobs.graph.surface_evidence import (
    OWN,
    PARTS,
    KnownView,
    Sibling,
    SurfaceSightings,
    SurfaceWitnesses,
    known_views,
)
from epi360.places.corridor import shown_by_itself
from epi360.places.own_evidence import OwnEvidence, grow_both
from epi360.places.shared_points import (
    MOST_WITNESSES,
    PLACE_SIGMA_DEG,
    Cloud,
    PosedPair,
    cloud_of,
    place_sigmas_deg,
    scale_between,
    some_of,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_NOBODY = np.empty(0, dtype=np.int64)
_FOUND = 0.7  # likeness of what is the same
_VIEW_CHANGES_DEG = (20.0, 45.0)  # points are classed by the angle between both rays
_MOST_POINTS, _MOST_OF_ONE = 240, 40  # that are looked for from one side, in all and of one witness
_FEWEST_POINTS = 15  # of a pair that is asked
_LEAST_PARALLAX_DEG, _LEAST_OWN_PARALLAX_DEG = 1.5, 0.5
_ABOUT_DEG, _NUM_ABOUT = 5.0, 7  # the distance that a camera sees somewhere is that of points near


@dataclass(frozen=True, eq=False)
class Sightings:
    """Points of one camera of a pair that were looked for in the view of the other.

    Attributes
    ----------
    witnesses : ndarray of int, shape (N,)
        Pair that knows each point.
    cells : ndarray of int, shape (N,)
        Part of the view that it lies in.
    changes : ndarray of int, shape (N,)
        Class of the angle between both rays to it: small, medium or large.
    found : ndarray of bool, shape (N,)
        Whether the same is seen there.
    sources : ndarray of int, shape (S,)
        Pairs that know distances in the other view; `OWN` is the pair itself.
    beyond : ndarray, shape (N, S)
        Logarithm of each point's distance over what the other camera sees there; NaN if a source
        does not know.
    """

    witnesses: Indices
    cells: Indices
    changes: Indices
    found: Mask
    sources: Indices
    beyond: NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was looked for from both sides of a pair: points, and whole surfaces.

    ``own`` is what the pair shows by itself; ``siblings`` are right or wrong with it. Where
    surfaces were not asked for there are none.
    """

    sides: tuple[Sightings, Sightings]
    surfaces: tuple[SurfaceSightings, ...] = ()
    own: OwnEvidence = OwnEvidence()
    siblings: tuple[Sibling, ...] = ()


@dataclass(frozen=True, eq=False)
class Surroundings:
    """All pairs of a folder with what they know about the views of its panoramas.

    ``panorama_of`` gives the picture of a number. Only the first ``num_heard`` pairs are asked.
    """

    pairs: Sequence[PosedPair]
    num_heard: int
    clouds: Mapping[tuple[int, int], Cloud]  # by pair and side
    at: Mapping[int, Sequence[tuple[int, int]]]  # pairs and sides of each panorama
    panorama_of: Callable[[int], Panorama]

    @classmethod
    def of(
        cls,
        pairs: Sequence[PosedPair],
        panorama_of: Callable[[int], Panorama],
        num_heard: int | None = None,
    ) -> Surroundings:
        """Triangulate the pairs; those with most points come first at each panorama.

        All are asked if it is not said how many.
        """
        clouds = {
            (row, side): cloud_of(pair, side, _LEAST_PARALLAX_DEG)
            for row, pair in enumerate(pairs[:num_heard])
            for side in (0, 1)
        }
        at: dict[int, list[tuple[int, int]]] = {}
        for row, side in sorted(clouds, key=lambda key: (-len(clouds[key].points), key)):
            at.setdefault(pairs[row].images[side], []).append((row, side))
        return cls(pairs, len(pairs[:num_heard]), clouds, at, panorama_of)

    def grown(self, row: int) -> tuple[tuple[KnownView, KnownView], OwnEvidence]:
        """What the surfaces that a pair shares say about its views, and about itself."""
        pair = self.pairs[row]
        panoramas = [self.panorama_of(image) for image in pair.images]
        grown = grow_both(pair, panoramas)
        return known_views(pair, grown), shown_by_itself(pair, grown, panoramas)

    def of_points(self, row: int) -> Evidence:
        """Look for points that are known of the views of a pair."""
        clouds = [self._known(row, side) for side in (0, 1)]
        first, second = (
            self._sightings(row, side, clouds[side], clouds[1 - side]) for side in (0, 1)
        )
        return Evidence((first, second))

    def with_surfaces(
        self, row: int, points: Evidence, known: SurfaceWitnesses, own: OwnEvidence
    ) -> Evidence:
        """Look for surfaces that are known of the views of a pair as well."""
        panoramas = [self.panorama_of(image) for image in self.pairs[row].images]
        surfaces, siblings = known.asked(row, panoramas)
        return Evidence(points.sides, surfaces, own, siblings)

    def _known(self, row: int, side: int) -> dict[int, Cloud]:
        """Points of other pairs at one camera of a pair, in the pair's units, and its own."""
        own = cloud_of(self.pairs[row], side, _LEAST_OWN_PARALLAX_DEG)
        known = {}
        for other, other_side in self.at.get(self.pairs[row].images[side], ()):
            cloud = self.clouds[other, other_side]
            if other == row or len(cloud.points) < _FEWEST_POINTS:
                continue
            scale = scale_between(own, cloud)
            if scale is not None:
                known[other] = cloud.scaled(*scale)
            if len(known) == MOST_WITNESSES:
                break
        return {**known, OWN: own}

    def _sightings(
        self, row: int, side: int, here: Mapping[int, Cloud], there: Mapping[int, Cloud]
    ) -> Sightings:
        points, normals, witnesses = [np.empty((0, 3))], [np.empty((2, 0, 3))], [_NOBODY]
        most = min(_MOST_OF_ONE, _MOST_POINTS // max(len(here) - 1, 1))
        for other, cloud in here.items():
            if other != OWN:
                kept = self._placed(row, side, cloud, most)
                points.append(cloud.points[kept])
                normals.append(_normals(cloud.points, kept))
                witnesses.append(np.full(len(kept), other))
        return _looked_for(
            self,
            row,
            side,
            np.concatenate(points),
            np.concatenate(normals, axis=1),
            np.concatenate(witnesses),
            there,
        )

    def _placed(self, row: int, side: int, cloud: Cloud, most: int) -> Indices:
        """Rows of some points whose place in the other view is known well enough."""
        pair, pose = self.pairs[row], self.pairs[row].other_from(side)
        seen = cloud.points @ pose.rotation.T + pose.translation
        sigmas = place_sigmas_deg(pair, side, seen, cloud.log_sigmas)
        (good,) = np.nonzero(sigmas < PLACE_SIGMA_DEG)
        return some_of(good, most)


def _looked_for(
    known: Surroundings,
    row: int,
    side: int,
    points: Array,
    normals: Array,
    witnesses: Indices,
    there: Mapping[int, Cloud],
) -> Sightings:
    """Look for points of one camera of a pair in the view of the other."""
    pair = known.pairs[row]
    pose = pair.other_from(side)
    first, second = (known.panorama_of(pair.images[each]) for each in (side, 1 - side))
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    backward = points - pose.inverse().translation
    backward /= np.linalg.norm(backward, axis=1, keepdims=True)
    planes = np.concatenate([normals, directions[None], (directions + backward)[None]])
    planes /= np.maximum(np.linalg.norm(planes, axis=2, keepdims=True), 1e-9)
    alike, contrasts = likeness(first, second, points, pose, planes)
    cosines = np.clip(np.sum(directions * backward, axis=1), -1, 1)
    (kept,) = np.nonzero(contrasts > LEAST_CONTRAST)
    seen = points[kept] @ pose.rotation.T + pose.translation
    shown = second.counts_at(seen)
    kept, seen = kept[shown], seen[shown]
    sources = np.array(list(there), dtype=np.int64)
    beyond = [log_beyond(seen, cloud) for cloud in there.values()]
    return Sightings(
        witnesses[kept],
        PARTS.indices(directions[kept]) + side * len(PARTS),
        np.digitize(np.degrees(np.arccos(cosines[kept])), _VIEW_CHANGES_DEG),
        alike[kept] > _FOUND,
        sources,
        np.array(beyond, np.float32).reshape(len(sources), len(seen)).T,
    )


def log_beyond(seen: Array, cloud: Cloud) -> Array:
    """Logarithm of distances over those of the cloud in about the same directions."""
    if len(cloud.points) < 2 or len(seen) == 0:
        return np.full(len(seen), np.nan)
    ranges = np.linalg.norm(seen, axis=1)
    tree = cKDTree(cloud.points / cloud.distances[:, None])
    limit = 2 * np.sin(np.radians(_ABOUT_DEG) / 2)
    _, near = tree.query(seen / ranges[:, None], _NUM_ABOUT, distance_upper_bound=limit)
    distances = np.sort(np.append(np.log(cloud.distances), np.nan)[near], axis=1)  # NaN last
    num_known = np.isfinite(distances).sum(axis=1)
    middle = np.maximum(num_known - 1, 0) // 2
    beyond: Array = np.log(ranges) - distances[np.arange(len(seen)), middle]
    return beyond


def _normals(points: Array, rows: Indices) -> Array:
    """Normals (2, K, 3) of planes that rows may lie on: that of their neighbours, the floor's."""
    directions = points / np.linalg.norm(points, axis=1, keepdims=True)
    _, near = cKDTree(directions).query(directions[rows], min(_NUM_ABOUT, len(points)))
    return np.stack([_plane_normals(points[near]), np.tile([0.0, 1.0, 0.0], (len(rows), 1))])


def _plane_normals(groups: Array) -> Array:
    """Normal (N, 3) of the plane that fits each group of points (N, K, 3) best."""
    centred = groups - groups.mean(axis=1, keepdims=True)
    normals: Array = np.linalg.eigh(centred.transpose(0, 2, 1) @ centred)[1][:, :, 0]
    return normals
