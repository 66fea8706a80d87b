# SPDX-License-Identifier: BSD-3-Clause
"""The map of the odometry: key frames, landmarks and who sees what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epi360.odometry.frame_result import FrameTracks
from epi360.odometry.similarity import Similarity
from epi360.poses import Pose

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Mask = NDArray[np.bool_]

# A landmark that disagrees with the pose of three frames more than it agrees moves on its own.
_STRIKES = 3


@dataclass(eq=False)
class KeyFrame:
    """A frame of the map: its pose, and the tracks that it sees.

    Attributes
    ----------
    index : int
        Number of the frame in the sequence.
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        cam_from_world.
    ids : ndarray, shape (N,)
        Identities of the landmarks or tracks that are seen.
    bearings, pixels : ndarray, shapes (N, 3) and (N, 2)
        Where.
    is_used : ndarray, shape (N,)
        False for observations that disagree with the map.
    chain : int
        Number of the frame with which the map began in which the key frame was placed; maps may
        have been joined since. From one key frame of a chain to the next goes the odometry.
    growth : float
        By how much its unit of length has grown since it was placed.
    """

    index: int
    rotation: Array
    translation: Array
    ids: Ids
    bearings: Array
    pixels: Array
    is_used: Mask = field(default_factory=lambda: np.zeros(0, np.bool_))
    chain: int = 0
    growth: float = 1.0

    def __post_init__(self) -> None:
        if len(self.is_used) != len(self.ids):
            self.is_used = np.ones(len(self.ids), np.bool_)

    @property
    def cam_from_world(self) -> Pose:
        """Pose of the key frame."""
        return Pose(self.rotation, self.translation)

    @property
    def center(self) -> Array:
        """Position of the camera in the world, shape (3,)."""
        return -(self.rotation.T @ self.translation)

    @property
    def rays(self) -> Array:
        """Directions (N, 3) of the bearings in the world."""
        return self.bearings @ self.rotation

    def move(self, node_from_world: Similarity) -> None:
        """Put it where a similarity says, whose scale changes its unit of length."""
        pose = node_from_world.pose()
        self.rotation, self.translation = np.array(pose.rotation), np.array(pose.translation)
        self.growth /= node_from_world.scale


@dataclass(frozen=True, eq=False)
class Renaming:
    """Identities (sorted) that become others."""

    before: Ids
    after: Ids

    def of(self, ids: Ids) -> Ids:
        """Identities as they are called now."""
        if len(self.before) == 0:
            return ids
        rows = np.minimum(np.searchsorted(self.before, ids), len(self.before) - 1)
        return np.where(self.before[rows] == ids, self.after[rows], ids)


class SparseMap:
    """Key frames and landmarks; a landmark has the identity of the track that began it."""

    def __init__(self) -> None:
        self.key_frames: list[KeyFrame] = []
        self.chain: int | None = None  # that is continued
        self._first: int | None = None  # the lowest identity: rows of the tables start there
        self._positions = np.empty((0, 3))
        self._colors = np.empty((0, 3), np.uint8)
        self._strikes = np.empty(0, np.int8)
        self._is_banned = np.empty(0, np.bool_)
        self._same_as = np.empty(0, np.int64)

    @property
    def ids(self) -> Ids:
        """Identities of the landmarks with a position."""
        return np.flatnonzero(np.isfinite(self._positions[:, 0])) + (self._first or 0)

    def add_key_frame(self, tracks: FrameTracks, pose: Pose) -> KeyFrame:
        """Add a frame with its pose; tracks that were found to be wrong stay out."""
        if self.chain is None:
            self.chain = tracks.index
        rows = self._rows(tracks.ids)
        kept = ~self._is_banned[rows]
        key_frame = KeyFrame(
            tracks.index,
            np.array(pose.rotation),
            np.array(pose.translation),
            self.landmarks_of(tracks.ids)[kept],
            tracks.bearings[kept],
            tracks.pixels[kept],
            chain=self.chain,
        )
        _use_each_once(key_frame)
        self.key_frames.append(key_frame)
        return key_frame

    def landmarks_of(self, ids: Ids) -> Ids:
        """Identity of the landmark that each track shows, which may be an older track's."""
        rows = self._rows(ids)
        landmarks = self._same_as[rows]
        while len(landmarks):
            rows = self._rows(landmarks)
            older = self._same_as[rows]
            if np.array_equal(older, landmarks):
                break
            landmarks = older
        return landmarks

    def join(self, ids: Ids, landmarks: Ids) -> None:
        """Say that tracks show landmarks that are there already; theirs are given up."""
        own, known = self.landmarks_of(ids), self.landmarks_of(landmarks)
        different = own != known
        own, known = own[different], known[different]
        if len(own) == 0:
            return
        rows = self._rows(own)
        self._same_as[rows] = known
        self._positions[rows] = np.nan
        is_joined = np.zeros(len(self._strikes), np.bool_)
        is_joined[rows] = True
        for key_frame in self.key_frames:
            if is_joined[self._rows(key_frame.ids)].any():
                key_frame.ids = self.landmarks_of(key_frame.ids)
                _use_each_once(key_frame)

    def newest(self, count: int) -> list[int]:
        """Numbers of the last key frames of the chain that is continued, in order."""
        found: list[int] = []
        for number in range(len(self.key_frames) - 1, -1, -1):
            if len(found) == count:
                break
            if self.key_frames[number].chain == self.chain:
                found.append(number)
        return found[::-1]

    def near(self, number: int, reach: int) -> list[int]:
        """Numbers of the key frames of its chain up to so many before and after one, in order."""
        chain = self.key_frames[number].chain
        own = [row for row, each in enumerate(self.key_frames) if each.chain == chain]
        place = own.index(number)
        return own[max(place - reach, 0) : place + reach + 1]

    def move_world(self, new_from_old: Similarity) -> None:
        """Give key frames and landmarks another world."""
        old_from_new = new_from_old.inverse()
        for key_frame in self.key_frames:
            key_frame.move(Similarity.from_pose(key_frame.cam_from_world) @ old_from_new)
        self._positions = new_from_old.apply(self._positions)

    def take_in(
        self, other: SparseMap, other_waited: Ids, new_identities: Callable[[int], Ids]
    ) -> Renaming:
        """Take in another map of the same world, whose key frames and landmarks become this one's.

        Tracks that both know become two, for the maps would not be two if they were the same
        points; ``other_waited`` are those of frames that waited for a pose in the other map. Key
        frames are in the order of their frames afterwards.
        """
        ids = np.union1d(other._known_ids(), other_waited)
        shared = np.intersect1d(ids, self._known_ids())
        renaming = Renaming(shared, new_identities(len(shared)))
        rows, other_rows = self._rows(renaming.of(ids)), other._rows(ids)
        self._positions[rows] = other._positions[other_rows]
        self._colors[rows] = other._colors[other_rows]
        self._strikes[rows] = other._strikes[other_rows]
        self._is_banned[rows] = other._is_banned[other_rows]
        self._same_as[rows] = renaming.of(other._same_as[other_rows])
        for key_frame in other.key_frames:
            key_frame.ids = renaming.of(key_frame.ids)
        key_frames = [*self.key_frames, *other.key_frames]
        self.key_frames = sorted(key_frames, key=lambda each: each.index)
        return renaming

    def positions_of(self, ids: Ids) -> Array:
        """Positions (N, 3) of the landmarks of tracks, NaN where there is none."""
        rows = self._rows(self.landmarks_of(ids))
        return self._positions[rows]

    def colors_of(self, ids: Ids) -> NDArray[np.uint8]:
        """RGB (N, 3) of landmarks."""
        rows = self._rows(ids)
        return self._colors[rows]

    def set_positions(self, ids: Ids, positions: Array) -> None:
        """Place landmarks."""
        rows = self._rows(ids)
        self._positions[rows] = positions

    def set_colors(self, ids: Ids, colors: NDArray[np.uint8]) -> None:
        """Color landmarks."""
        rows = self._rows(ids)
        self._colors[rows] = colors

    def remove(self, ids: Ids) -> None:
        """Take landmarks out for good: what they show moves, or is not one point."""
        rows = self._rows(ids)
        self._positions[rows] = np.nan
        self._is_banned[rows] = True

    def unplace(self, ids: Ids) -> None:
        """Take the positions of landmarks back; other views may place them again."""
        rows = self._rows(ids)
        self._positions[rows] = np.nan

    def is_free(self, ids: Ids) -> Mask:
        """Whether tracks have no landmark and may still get one."""
        rows = self._rows(self.landmarks_of(ids))
        free: Mask = np.isnan(self._positions[rows, 0]) & ~self._is_banned[rows]
        return free

    def count_agreement(self, ids: Ids, agrees: Mask) -> None:
        """Count frames that landmarks agree or disagree with; remove those that mostly do not."""
        landmarks = self.landmarks_of(ids)
        rows = self._rows(landmarks)
        self._strikes[rows] = np.clip(self._strikes[rows] + np.where(agrees, -1, 1), 0, _STRIKES)
        self.remove(landmarks[self._strikes[rows] >= _STRIKES])

    def num_seen_by(self, key_frame: KeyFrame) -> int:
        """How many landmarks a key frame sees."""
        seen = key_frame.is_used & np.isfinite(self.positions_of(key_frame.ids)[:, 0])
        return int(seen.sum())

    def observations(self, numbers: list[int]) -> tuple[NDArray[np.int64], Ids, Array]:
        """Places in ``numbers``, landmarks and bearings of what these key frames see."""
        places, ids, bearings = [], [], []
        for place, number in enumerate(numbers):
            key_frame = self.key_frames[number]
            rows = key_frame.is_used & np.isfinite(self.positions_of(key_frame.ids)[:, 0])
            places.append(np.full(int(rows.sum()), place, np.int64))
            ids.append(key_frame.ids[rows])
            bearings.append(key_frame.bearings[rows])
        return np.concatenate(places), np.concatenate(ids), np.concatenate(bearings)

    def _rows(self, ids: Ids) -> NDArray[np.int64]:
        """Rows of the tables, which grow to hold all identities."""
        if len(ids) == 0:
            return ids
        if self._first is None:
            self._first = int(ids.min())
        lowest = int(ids.min())
        if lowest < self._first:
            self._grow(self._first - lowest, at_front=True)
            self._first = lowest
        needed = int(ids.max()) - self._first + 1 - len(self._strikes)
        if needed > 0:
            self._grow(max(needed, len(self._strikes) // 2, 4096), at_front=False)
        return np.asarray(ids - self._first)

    def _grow(self, count: int, *, at_front: bool) -> None:
        first = self._first or 0
        start = first - count if at_front else first + len(self._strikes)
        pieces: tuple[tuple[str, NDArray[np.generic]], ...] = (
            ("_positions", np.full((count, 3), np.nan)),
            ("_colors", np.zeros((count, 3), np.uint8)),
            ("_strikes", np.zeros(count, np.int8)),
            ("_is_banned", np.zeros(count, np.bool_)),
            ("_same_as", np.arange(start, start + count, dtype=np.int64)),
        )
        for name, piece in pieces:
            old = getattr(self, name)
            setattr(self, name, np.concatenate([piece, old] if at_front else [old, piece]))

    def _known_ids(self) -> Ids:
        """Sorted identities of all tracks of which something is known."""
        is_known = np.isfinite(self._positions[:, 0]) | self._is_banned | (self._strikes != 0)
        first = self._first or 0
        is_joined = self._same_as != np.arange(first, first + len(self._same_as))
        known = np.flatnonzero(is_known | is_joined) + first
        seen = [each.ids for each in self.key_frames]
        return np.unique(np.concatenate([known, self._same_as[is_joined], *seen]))


def _use_each_once(key_frame: KeyFrame) -> None:
    """Two tracks may have become one landmark: the first of them counts."""
    _, first = np.unique(key_frame.ids, return_index=True)
    is_first = np.zeros(len(key_frame.ids), np.bool_)
    is_first[first] = True
    key_frame.is_used &= is_first
