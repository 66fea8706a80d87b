# SPDX-License-Identifier: BSD-3-Clause
"""Whether things that look alike agree on another direction between two panoramas.

In an office with equal desks, a pose that puts one desk upon the next agrees with many matches, and
all around looks as it says. A match has one partner, and of equal things most get none, so that
those that would tell are missing. Here a key point may have any partner that looks like it. With
the rotation given, each such match says that the second camera moved along one half of a great
circle, and the direction is that on which most key points agree. A right pose has more of them than
any other direction, for what there is only once agrees with it alone, and after a small step most
key points are where the rotation alone takes them. In a corridor little is there only once, and the
other direction must have clearly more; what else tells there is left to `corridor`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar.residuals import tangent_basis
from epi360.features.self_likeness import SeenKeypoints, keypoints_of, share_like_itself
from epi360.features.sphere_cells import even_directions
from epi360.features.warped_patches import Panorama
from epi360.places.corridor import is_long_and_narrow
from epi360.places.own_evidence import grow_both, of_both
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

# Of either panorama, by `share_like_itself`: of accepted pairs of rendered offices with equal desks
# nearly all have more, of `zind_tour` none.
_LIKE_ITSELF = 0.25
# Key points of another direction for each one of the pose. When this was set, of 14 wrong poses in
# rendered offices 12 had more, of 154 right ones 11, and of 74 in furnished rooms none.
_MOST_OTHERS = 0.9
# The same in a corridor, in which right poses have up to 1.1.
_MOST_IN_CORRIDOR = 1.25
_MOST_KEYPOINTS = 700  # of each panorama, the strongest
_NUM_ALIKE, _LEAST_LIKENESS = 6, 0.75  # partners in the other one, and cosines of descriptors
_LEAST_PARALLAX_DEG, _NEAREST_DEG = 2.0, 1.0  # of a partner, and between it and the direction
_NEAR_DEG = 0.7  # from the great circle of a match
_OWN_DEG, _APART_DEG = 2.0, 10.0  # directions that are that of the pose, and others
_NUM_COARSE, _COARSE_DEG, _FINE_DEG, _STEP_DEG = 2000, 2.0, 2.5, 0.5
_NUM_TRIED = 6  # of the coarse directions
_FEWEST = 30  # key points that agree


def rival_direction(
    pair: PosedPair, panoramas: Sequence[Panorama], *, num_threads: int = 1
) -> Pose | None:
    """Return a pose with another direction on which nearly as many look-alikes agree, or more.

    None if there is none, or if neither panorama looks like other parts of itself: elsewhere what
    repeats is small, as the texture of a floor, and agrees with many directions by chance. If both
    show a corridor, more must agree on the other direction.
    """
    if max(of_both(share_like_itself, panoramas, num_threads)) <= _LIKE_ITSELF:
        return None
    pose = pair.cam2_from_cam1
    first, second = (keypoints_of(each).some(slice(_MOST_KEYPOINTS)) for each in panoramas)
    alike = Alike.of(pose.rotation, first, second)
    direction = pose.translation / np.linalg.norm(pose.translation)
    num_own = alike.num_for(direction)
    other, num_others = alike.best_apart_from(direction, _APART_DEG)
    if num_others < max(_FEWEST, _MOST_OTHERS * num_own):
        return None
    if num_others < _MOST_IN_CORRIDOR * num_own:
        views = grow_both(pair, panoramas, num_threads=num_threads)
        if all(map(is_long_and_narrow, views)):
            return None
    return Pose(pose.rotation, other)


class Alike:
    """Pairs of key points that look alike, as what they say of the direction of a translation.

    It lies on a half of a great circle, beyond the partner. ``turned`` (M, 3) are bearings of the
    first view by the rotation, ``seen`` (M, 3) those of the second. ``owners`` (K, M) say whose
    votes they are, such as the key points of both views: each of them votes once. Those of which
    some partner is just where the rotation alone takes them (``num_still``) agree with the pose as
    it is, whatever else looks like them.
    """

    def __init__(self, turned: Array, seen: Array, owners: Indices) -> None:
        normals = np.cross(turned, seen)
        sines = np.linalg.norm(normals, axis=1)
        moved = sines > np.sin(np.radians(_LEAST_PARALLAX_DEG))
        still = ~moved & (np.sum(turned * seen, axis=1) > 0.0)
        stay = [np.unique(each[still]) for each in owners]
        self.num_still = sum(map(len, stay))
        for own, at_rest in zip(owners, stay, strict=True):
            moved &= ~np.isin(own, at_rest)
        units = normals[moved] / sines[moved, None]
        self._normals = units.astype(np.float32)
        self._towards = np.cross(units, turned[moved]).astype(np.float32)
        self._beyond = np.cross(units, seen[moved]).astype(np.float32)
        self._owners = owners[:, moved]

    @classmethod
    def of(cls, rotation: Array, first: SeenKeypoints, second: SeenKeypoints) -> Alike:
        """Those of the nearest of each key point, of either view, that are near enough."""
        likeness = first.descriptors @ second.descriptors.T
        alike = _among_nearest(likeness) | _among_nearest(likeness.T).T
        rows, columns = np.nonzero(alike & (likeness > _LEAST_LIKENESS))
        turned = first.bearings @ rotation.T
        return cls(turned[rows], second.bearings[columns], np.stack([rows, columns]))

    def agree(self, directions: Floats, near_deg: float) -> NDArray[np.bool_]:
        """Which of the pairs that have moved agree with each direction (D, 3): (M', D)."""
        agrees = np.abs(self._normals @ directions.T) < np.sin(np.radians(near_deg))
        agrees &= self._towards @ directions.T > 0.0
        agrees &= self._beyond @ directions.T > np.sin(np.radians(_NEAREST_DEG))
        return np.asarray(agrees)

    def counts(self, directions: Floats, near_deg: float) -> NDArray[np.int64]:
        """How many owners agree with each direction (D, 3)."""
        agrees = self.agree(directions, near_deg)
        counts = np.zeros(len(directions), np.int64)
        for owners in self._owners:
            order = np.argsort(owners, kind="stable")
            begins = np.flatnonzero(np.diff(owners[order], prepend=-1))
            if len(begins):
                counts += np.logical_or.reduceat(agrees[order], begins, axis=0).sum(axis=0)
        return counts

    def owners_for(self, direction: Array) -> list[Indices]:
        """The owners of each kind, once each, that agree with one direction."""
        (agrees,) = self.agree(np.asarray(direction, np.float32)[None], _NEAR_DEG).T
        return [np.unique(owners[agrees]) for owners in self._owners]

    def num_for(self, direction: Array) -> int:
        """How many owners agree with one direction, or one next to it."""
        return self.num_still + int(self.counts(_around(direction, _OWN_DEG), _NEAR_DEG).max())

    def best_apart_from(self, direction: Array, apart_deg: float) -> tuple[Array, int]:
        """The direction so far from this one on which most agree, and how many do."""
        coarse = even_directions(_NUM_COARSE)
        left = self.counts(coarse.astype(np.float32), _COARSE_DEG)
        left[_are_within(coarse, direction, apart_deg)] = -1
        best, most = direction, -1
        for _ in range(_NUM_TRIED):
            tried = coarse[int(np.argmax(left))]
            fine = _around(tried, _FINE_DEG)
            counts = self.counts(fine, _NEAR_DEG)
            counts[_are_within(fine, direction, apart_deg)] = -1
            if counts.max() > most:
                best, most = fine[int(np.argmax(counts))].astype(np.float64), int(counts.max())
            left[_are_within(coarse, tried, _FINE_DEG)] = -1
        return best / np.linalg.norm(best), most


def _among_nearest(likeness: Floats) -> NDArray[np.bool_]:
    """Which columns (N, M) are among those that are most like a row."""
    count = min(_NUM_ALIKE, likeness.shape[1])
    nearest = np.argpartition(-likeness, count - 1, axis=1)[:, :count]
    among = np.zeros(likeness.shape, np.bool_)
    np.put_along_axis(among, nearest, True, axis=1)
    return among


def _are_within(
    directions: NDArray[np.floating], direction: Array, degrees: float
) -> NDArray[np.bool_]:
    return np.asarray(directions @ direction > np.cos(np.radians(degrees)))


def _around(direction: Array, degrees: float) -> Floats:
    """Directions (D, 3) within so much of one along two tangents, in steps of half a degree."""
    steps = np.radians(np.arange(-degrees, degrees + _STEP_DEG / 2, _STEP_DEG))
    across = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    found = direction + across @ tangent_basis(direction).T
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True), np.float32)
