# SPDX-License-Identifier: BSD-3-Clause
"""A connected part of a sequence: its map, and the frames that have a pose in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.absolute_pose_fit import AbsolutePoseFit, fit_absolute_pose
from epi360.odometry.frame_result import FrameTracks, MapPoints, shared_rows
from epi360.odometry.gravity import GravityPrior
from epi360.odometry.initialization import Start
from epi360.odometry.key_frames import Ids, KeyFrame, SparseMap
from epi360.odometry.map_parts import Connection, PartOfMap
from epi360.odometry.mapping import Noise, adjust_all, adjust_last, triangulate, triangulate_new
from epi360.odometry.options import OdometryOptions
from epi360.odometry.recognition import Recognition
from epi360.odometry.turning import rotation_between
from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]

_YOUNG = 0.5  # of the parallax between first and last key frame makes one while it is small
_MOST_TOGETHER = 500  # key frames in one adjustment, whose time grows with their cube
_MOST_AT_A_JOIN = 200  # of two maps, which the next key frame waits for
_FEWEST_SHARED = 50  # points of two key frames whose parallax says something
_FRAMES_BETWEEN = 4  # that become key frames between the two that the map begins with
_NOISE_PX = (0.05, 0.5)  # limits of what the noise of tracks is taken to be
# From here on a track counts as wrong. Long tracks drift: half a pixel says nothing against one.
_OUTLIER_SIGMAS, _OUTLIER_PX = 5.0, (0.7, 2.0)
_JOIN_PX = 1.5  # between a track and the landmark that it must be
# Share of the landmarks in view that must agree with a pose, a larger one if few agree. A fisheye
# in a bare room shows 25 to 40 landmarks, of which three quarters agree.
_SMALLEST_SHARE, _SHARE_OF_FEW, _FEW = 0.3, 0.5, 30


class _GravityArguments(TypedDict, total=False):
    gravity: Array
    gravity_sigma_rad: float
    world_gravity: Array


@dataclass(frozen=True, eq=False)
class PosedFrame:
    """A frame's pose relative to a key frame, which later adjustments move."""

    key_frame: KeyFrame
    frame_from_key: Pose  # before the key frame's unit of length has grown
    num_inliers: int


class Segment:
    """Map of one place and the frames that were posed in it."""

    def __init__(
        self,
        start: Start,
        pixel_rad: float,
        options: OdometryOptions,
        recognition: Recognition,
        gravity: GravityPrior | None = None,
    ) -> None:
        assert start.result is not None
        self.map = SparseMap()
        self.recognition = recognition
        self.frames: dict[int, PosedFrame] = {}
        self.waited: dict[int, list[FrameTracks]] = {}  # for a pose, by the chain of the map
        self._pixel_rad = pixel_rad
        self._options = options
        self._gravity = gravity
        self._down: Array | None = None  # gravity in the world, once a map has been adjusted
        self._widest_rad = float(np.radians(start.result.parallax_deg))
        self._set_noise(np.radians(start.result.noise_deg))

    @classmethod
    def begin(
        cls,
        start: Start,
        tracks: FrameTracks,
        waited: list[FrameTracks],
        pixel_rad: float,
        options: OdometryOptions,
        recognition: Recognition,
        gravity: GravityPrior | None = None,
    ) -> Segment:
        """Map of the two frames of a start and of some that waited between them."""
        assert start.result is not None and start.reference is not None and start.rows is not None
        segment = cls(start, pixel_rad, options, recognition, gravity)
        sparse_map, pose = segment.map, start.result.cam2_from_cam1
        first = sparse_map.add_key_frame(start.reference, Pose(np.eye(3), np.zeros(3)))
        last = sparse_map.add_key_frame(tracks, pose)
        shared = start.reference.ids[start.rows[0]]
        for key_frame, given in ((first, start.reference), (last, tracks)):
            rejected = np.setdiff1d(np.intersect1d(start.reference.ids, tracks.ids), shared)
            key_frame.is_used &= ~np.isin(key_frame.ids, rejected)
            assert key_frame.index == given.index
        # Far points are taken as well: they hold the rotation, and the adjustment bounds them.
        triangulate(sparse_map, np.unique(shared), segment.noise, smallest_parallax=2.0)
        sparse_map.key_frames.pop()
        segment._insert_between(start.reference, tracks, pose, waited)
        sparse_map.key_frames.append(last)
        for _ in range(2):
            segment._adjust(max_iterations=10)
        segment.waited[first.chain] = waited
        segment.pose_waiting()
        return segment

    @property
    def last_key_frame(self) -> KeyFrame:
        """The newest key frame."""
        return self.map.key_frames[-1]

    def locate(self, tracks: FrameTracks, guess: Pose | None) -> AbsolutePoseFit | None:
        """Pose of a frame from the landmarks that it sees; None if they do not determine it."""
        positions = self.map.positions_of(tracks.ids)
        known = np.isfinite(positions[:, 0])
        if known.sum() < self._options.min_inliers:
            return None
        result = fit_absolute_pose(
            tracks.bearings[known],
            positions[known],
            threshold_rad=self.noise.outlier_rad,
            guess=guess,
            min_inliers=self._options.min_inliers,
            **self._gravity_now(),
        )
        count = int(result.inlier_mask.sum())
        share = _SHARE_OF_FEW if count < _FEW else _SMALLEST_SHARE
        return result if result.status == "ok" and count >= share * known.sum() else None

    def _gravity_now(self) -> _GravityArguments:
        if self._gravity is None or self._down is None:
            return {}
        return {
            "gravity": self._gravity.direction,
            "gravity_sigma_rad": self._gravity.sigma_rad,
            "world_gravity": self._down,
        }

    def agree(self, tracks: FrameTracks, result: AbsolutePoseFit) -> None:
        """Count which landmarks agree with the pose of a frame; those that never do are removed."""
        known = np.isfinite(self.map.positions_of(tracks.ids)[:, 0])
        self.map.count_agreement(tracks.ids[known], result.inlier_mask)

    def add_frame(self, index: int, pose: Pose, num_inliers: int) -> None:
        """Keep the pose of a frame relative to the newest key frame."""
        self._add_frame(index, pose, self.last_key_frame, num_inliers)

    def pose_of(self, index: int) -> Pose:
        """Pose of a frame as the map is now."""
        posed = self.frames[index]
        offset, key_frame = posed.frame_from_key, posed.key_frame
        grown = Pose(offset.rotation, key_frame.growth * offset.translation)
        return grown @ key_frame.cam_from_world

    def add_waited(self, waited: list[FrameTracks]) -> None:
        """Take in frames that waited while the map was lost."""
        assert self.map.chain is not None
        self.waited[self.map.chain].extend(waited)

    def wants_key_frame(self, tracks: FrameTracks, pose: Pose, num_inliers: int) -> bool:
        """Whether a frame shows enough that is new."""
        last = self.last_key_frame
        rows1, rows2 = shared_rows(last.ids, self.map.landmarks_of(tracks.ids))
        if len(rows1) < self._options.min_survival * len(last.ids) or num_inliers < 100:
            return bool(last.index < tracks.index - 1 or len(rows1) < 0.5 * len(last.ids))
        parallax = angles_of_units(last.rays[rows1], tracks.bearings[rows2] @ pose.rotation)
        wanted = np.radians(self._options.key_frame_parallax_deg)
        wanted = min(wanted, _YOUNG * self._widest_rad)
        return bool(np.median(parallax) > wanted)

    def add_key_frame(self, tracks: FrameTracks, pose: Pose) -> Pose:
        """Make a frame a key frame, place new landmarks, adjust; returns the pose after it."""
        key_frame = self.map.add_key_frame(tracks, pose)
        self._widest_rad = max(
            self._widest_rad, _parallax_between(self.map.key_frames[0], key_frame)
        )
        triangulate_new(self.map, self.noise)
        self._adjust(max_iterations=4)
        return key_frame.cam_from_world

    def points(self) -> MapPoints:
        """Landmarks that two key frames see at least, with their observations."""
        places, ids, _ = self.map.observations(list(range(len(self.map.key_frames))))
        pixels = np.concatenate(
            [
                each.pixels[each.is_used & np.isfinite(self.map.positions_of(each.ids)[:, 0])]
                for each in self.map.key_frames
            ]
        )
        several = np.isin(ids, self._landmarks())
        landmarks, rows = np.unique(ids[several], return_inverse=True)
        return MapPoints(
            self.map.positions_of(landmarks),
            self.map.colors_of(landmarks),
            rows.astype(np.int64),
            places[several],
            pixels[several],
        )

    def move(self, cam_from_world: Sequence[Pose], positions: Array) -> None:
        """Put key frames and `points` elsewhere."""
        landmarks = self._landmarks()
        if (len(cam_from_world), len(positions)) != (len(self.map.key_frames), len(landmarks)):
            raise ValueError(
                f"there must be {len(self.map.key_frames)} poses and {len(landmarks)} positions, "
                f"got {len(cam_from_world)} and {len(positions)}"
            )
        for key_frame, pose in zip(self.map.key_frames, cam_from_world, strict=True):
            key_frame.rotation = np.array(pose.rotation)
            key_frame.translation = np.array(pose.translation)
        self.map.set_positions(landmarks, positions)

    def _landmarks(self) -> NDArray[np.int64]:
        """Landmarks that two key frames see at least."""
        _, ids, _ = self.map.observations(list(range(len(self.map.key_frames))))
        landmarks, counts = np.unique(ids, return_counts=True)
        return np.asarray(landmarks[counts > 1])

    def recognise_first(self, gray: NDArray[np.uint8] | None) -> None:
        """Remember what the first key frame looks like."""
        if gray is not None:
            self.recognition.add(0, self.recognition.features(gray), gray)

    def recognise(self, gray: NDArray[np.uint8]) -> int | None:
        """Remember what the newest key frame looks like; the frame with which it closes a loop."""
        recognition, number = self.recognition, len(self.map.key_frames) - 1
        recognition.add(number, recognition.features(gray), gray)
        loop = recognition.close_loop(self.map) if self._options.loop_closure else None
        if loop is None:
            return None
        recognition.correct(self.map, loop)
        self._join_tracks(self.last_key_frame, loop.old)
        return self.map.key_frames[loop.old].index

    def _join_tracks(self, key_frame: KeyFrame, number: int) -> None:
        """Join tracks of a key frame to the landmarks around another one."""
        pose, limit = key_frame.cam_from_world, _JOIN_PX * self._pixel_rad
        self.recognition.join_tracks(self.map, key_frame, pose, number, limit)

    def connection(self, other: Segment) -> Connection | None:
        """How the newest key frame is connected with another map; None if that is not known."""
        return self.recognition.connect(self.map, other.recognition, other.map)

    def take_in(
        self,
        other: Segment,
        connections: tuple[Connection, Connection],
        new_identities: Callable[[int], Ids],
    ) -> None:
        """Make another map a part of this one; the world is that of the map that began first.

        The second one of two connections that agree is that of the newest key frame.
        """
        before_it, newest = connections
        connection = newest.with_scale_of_both(before_it)
        before = self.map.key_frames, other.map.key_frames
        if other.map.key_frames[0].index < self.map.key_frames[0].index:
            growths = connection.other_from_own.scale, 1.0
            self.map.move_world(connection.other_from_own)
        else:
            own_from_other = connection.other_from_own.inverse()
            growths = 1.0, own_from_other.scale
            other.map.move_world(own_from_other)
        waiting = [frame.ids for waited in other.waited.values() for frame in waited]
        other_waited = np.concatenate([np.zeros(0, np.int64), *waiting])
        renaming = self.map.take_in(other.map, other_waited, new_identities)
        number_of = {each.index: number for number, each in enumerate(self.map.key_frames)}
        own_part, other_part = (
            PartOfMap({row: number_of[each.index] for row, each in enumerate(key_frames)}, growth)
            for key_frames, growth in zip(before, growths, strict=True)
        )
        self.recognition.take_in(other.recognition, connections, self.map, own_part, other_part)
        self.frames = other.frames | self.frames
        for chain, waited in other.waited.items():
            renamed = [replace(frame, ids=renaming.of(frame.ids)) for frame in waited]
            self.waited[chain] = renamed
        self._widest_rad = max(self._widest_rad, other._widest_rad)
        if self._gravity is not None:
            self._down = self._gravity.in_world(self.map.key_frames)
        for each in connections:
            old, new, _ = each.ends(own_part, other_part)
            self._join_tracks(self.map.key_frames[new], old)
        if len(self.map.key_frames) <= _MOST_AT_A_JOIN:
            adjust_all(self.map, self.noise, gravity=self._gravity)

    def denies(self, tracks: FrameTracks, pose: Pose, gray: NDArray[np.uint8]) -> bool:
        """Whether what surrounds the landmarks of a located frame says that it is elsewhere."""
        return self.recognition.shows_another_place(self.map, tracks, pose, gray, self.noise)

    def find(
        self, gray: NDArray[np.uint8], tracks: FrameTracks, *, in_doubt: bool = False
    ) -> AbsolutePoseFit | None:
        """Pose of a frame that shares no tracks with the map, by what key frames look like.

        ``in_doubt`` what surrounds it must make that sure.
        """
        found = self.recognition.find(self.map, gray, in_doubt=in_doubt)
        if found is None:
            return None
        pose, number = found
        limit = _JOIN_PX * self._pixel_rad
        self.recognition.join_tracks(self.map, tracks, pose, number, limit)
        return self.locate(tracks, pose)

    def color(self, key_frame: KeyFrame, image: NDArray[np.uint8], full_from_image: Array) -> None:
        """Give the landmarks of a key frame the colors of its picture, which may be smaller."""
        height, width = image.shape[:2]
        pixels = (key_frame.pixels / full_from_image).astype(np.intp)
        columns, rows = np.clip(pixels[:, 0], 0, width - 1), np.clip(pixels[:, 1], 0, height - 1)
        self.map.set_colors(key_frame.ids, image[rows, columns])

    def adjust_all(self) -> None:
        """Adjust all key frames together, unless there are too many for that."""
        if len(self.map.key_frames) <= _MOST_TOGETHER:
            adjust_all(self.map, self.noise, gravity=self._gravity)
            triangulate_new(self.map, self.noise)
            adjust_all(self.map, self.noise, gravity=self._gravity)

    def pose_waiting(self) -> None:
        """Give frames that waited their poses, as far as the map shows what they saw."""
        for chain, waited in self.waited.items():
            own = [each for each in self.map.key_frames if each.chain == chain]
            later = [frame for frame in waited if frame.index >= own[0].index]
            earlier = [frame for frame in reversed(waited) if frame.index < own[0].index]
            for run in (later, earlier):
                self._pose_run(run, {each.index: each for each in own})

    def _pose_run(self, run: list[FrameTracks], key_frames: dict[int, KeyFrame]) -> None:
        """The same of frames in the order in which each helps to find the next."""
        last = -2
        for frame in run:
            near = key_frames[min(key_frames, key=lambda index: abs(index - frame.index))]
            if abs(frame.index - last) != 1:
                guess = near.cam_from_world
            if frame.is_repeat and frame.index - 1 in self.frames:
                self.frames[frame.index] = self.frames[frame.index - 1]
                last = frame.index
                continue
            if frame.index in key_frames:
                guess = near.cam_from_world
                self._add_frame(frame.index, guess, near, self.map.num_seen_by(near))
                last = frame.index
                continue
            result = self.locate(frame, guess)
            if result is not None:
                guess, last = result.cam_from_world, frame.index
                self._add_frame(frame.index, guess, near, int(result.inlier_mask.sum()))

    def _insert_between(
        self, first: FrameTracks, last: FrameTracks, pose: Pose, waited: list[FrameTracks]
    ) -> None:
        """Make some frames between the first two key frames key frames too: more views of all."""
        between = [
            frame
            for frame in waited
            if first.index < frame.index < last.index and not frame.is_repeat
        ]
        count = min(_FRAMES_BETWEEN, len(between))
        chosen = np.unique(np.linspace(0, len(between), count + 2)[1:-1].astype(int))
        for place in chosen:
            frame = between[place]
            rows1, rows2 = shared_rows(first.ids, frame.ids)
            rotation, _ = rotation_between(first.bearings[rows1], frame.bearings[rows2])
            share = (frame.index - first.index) / (last.index - first.index)
            result = self.locate(frame, Pose(rotation, share * pose.translation))
            if result is not None:
                self.map.add_key_frame(frame, result.cam_from_world)

    def _add_frame(self, index: int, pose: Pose, key_frame: KeyFrame, num_inliers: int) -> None:
        offset = pose @ key_frame.cam_from_world.inverse()
        offset = Pose(offset.rotation, offset.translation / key_frame.growth)
        self.frames[index] = PosedFrame(key_frame, offset, num_inliers)

    def _adjust(self, *, max_iterations: int) -> None:
        sigma_rad = adjust_last(
            self.map,
            self._options.window,
            self.noise,
            gravity=self._gravity,
            max_iterations=max_iterations,
        )
        self._set_noise(0.7 * self.noise.sigma_rad + 0.3 * sigma_rad)
        if self._gravity is not None:
            self._down = self._gravity.in_world(self.map.key_frames)

    def _set_noise(self, sigma_rad: float) -> None:
        low, high = (limit * self._pixel_rad for limit in _NOISE_PX)
        sigma_rad = float(np.clip(sigma_rad, low, high))
        low, high = (limit * self._pixel_rad for limit in _OUTLIER_PX)
        self.noise = Noise(sigma_rad, float(np.clip(_OUTLIER_SIGMAS * sigma_rad, low, high)))


def _parallax_between(first: KeyFrame, last: KeyFrame) -> float:
    """Median angle between the rays of what both see; infinite if that is little."""
    rows1, rows2 = shared_rows(first.ids, last.ids)
    if len(rows1) < _FEWEST_SHARED:
        return float("inf")
    return float(np.median(angles_of_units(first.rays[rows1], last.rays[rows2])))
