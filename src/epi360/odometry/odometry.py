# SPDX-License-Identifier: BSD-3-Clause
"""Visual odometry of a panorama or fisheye video, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import resized_camera, smallest_pixel_deg
from epi360.estimation.absolute_pose_fit import AbsolutePoseFit
from epi360.features import ImageSource, read_mask
from epi360.features.frame_tracker import FrameTracker
from epi360.features.image_cameras import check_camera
from epi360.features.images import read_masked_image, usable_at
from epi360.odometry.connections import Connections
from epi360.odometry.frame_clock import FrameClock
from epi360.odometry.frame_result import (
    FrameResult,
    FrameStatus,
    FrameTracks,
    MapPoints,
    Trajectory,
)
from epi360.odometry.gaps import FAR_SHARE, Gaps
from epi360.odometry.gravity import GravityPrior
from epi360.odometry.initialization import Start, Waiting
from epi360.odometry.key_frames import KeyFrame
from epi360.odometry.motion import Motion
from epi360.odometry.options import OdometryOptions
from epi360.odometry.pictures import PictureWatch, joint_mask, mask_for
from epi360.odometry.recognition import Recognition
from epi360.odometry.results import joined, no_points, trajectory_of, updated_results
from epi360.odometry.segment import Segment
from epi360.poses import Pose

_GAP = (
    "frames seem to be missing before it, for {num_tracked} points could be followed in place of "
    "some {usual}; where a place repeats itself, the map may go on in another part of it"
)
_ELSEWHERE = "around what it has in common with the map, it seems to show another place"
_TRIES = 4  # frames in a row that are looked for in the map; afterwards one of so many is


class Odometry:
    """Trajectory and sparse map of one moving camera, found while its frames come in.

    Frames wait until the parallax since the first one determines the direction of motion; then a
    map begins, later frames are placed in it, and frames that waited get their poses afterwards.

    Parameters
    ----------
    camera : Camera
        Camera of all frames.
    mask : path or array, optional
        White = use, in the size of the frames: the operator and the camera's own holder are black.
    options : OdometryOptions, optional
        How frames are tracked.
    gravity : array_like, shape (3,), optional
        Direction of gravity in the camera in every frame, ``(0, 1, 0)`` if the frames are upright
        panoramas. Leave it out for a camera that is held by hand and not levelled.
    gravity_sigma_deg : float
        Its standard deviation in degrees, per axis.
    seed : int
        Random seed of the sampling; the same seed gives the same result.

    Raises
    ------
    ValueError
        If the camera is none, the mask cannot be used, or gravity or its standard deviation is out
        of range.
    FileNotFoundError
        If the mask does not exist.

    Notes
    -----
    The world is the camera's frame at the first key frame, and the unit of length the distance
    between the two frames that the map began with. If the sequence is cut, each part has a world
    of its own until the camera sees a place of another part again, and `trajectory` is that of the
    part with most frames.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        mask: ImageSource | None = None,
        options: OdometryOptions | None = None,
        gravity: ArrayLike | None = None,
        gravity_sigma_deg: float = 1.0,
        seed: int = 0,
    ) -> None:
        check_camera(camera, "camera")
        self._camera = camera
        self._options = options or OdometryOptions()
        self._seed = seed
        self._gravity = GravityPrior.given(gravity, gravity_sigma_deg)
        usable = None if mask is None else read_mask(mask, (camera.height, camera.width))
        working = resized_camera(camera, min(camera.width, self._options.max_width))
        if usable is not None and working != camera:
            usable = mask_for(working, usable)
        self._tracker = FrameTracker(working, usable, max_points=self._options.max_points)
        self._watch = PictureWatch(camera, working, usable)
        self._working, self._usable = working, usable
        self._full_from_working = np.array(
            [camera.width / working.width, camera.height / working.height]
        )
        self._pixel_rad = float(np.radians(smallest_pixel_deg((working, working))))
        self._results: list[FrameResult] = []
        self._segments: dict[int, Segment] = {}  # by their numbers, from 1
        self._num_begun = 0  # segments, of which some may have been joined
        self._connections = Connections()
        self._waiting = self._new_wait()
        self._active = 0  # number of the segment that is tracked
        self._first_index = -1
        self._last_seen = -1  # the frame whose picture was the last to show something
        self._first_gray: NDArray[np.uint8] | None = None  # picture of the frame that waits first
        self._is_lost, self._is_in_doubt, self._num_lost = False, False, 0
        self._clock = FrameClock()
        self._motion = Motion()
        self._gaps = Gaps()

    def add_frame(
        self,
        image: ImageSource,
        timestamp_s: float | None = None,
        *,
        mask: ImageSource | None = None,
    ) -> FrameResult:
        """Take the next frame and say where it was taken, as far as that is known by now.

        Parameters
        ----------
        image : path or array
            What `read_image` takes; RGB or grey.
        timestamp_s : float, optional
            Time stamp in seconds, the number of the frame by default.
        mask : path or array, optional
            White = use, in the size of the camera: of this frame, beside the mask of all frames.
            An array of bool may leave nothing of it.

        Returns
        -------
        result : FrameResult
            A frame of the wait before the map gets its pose later: see `results`.

        Raises
        ------
        ValueError
            If the image or the mask is no picture, or the mask has another size than the camera.
        FileNotFoundError
            If one of them does not exist.
        """
        picture, opaque = read_masked_image(image)
        usable = joint_mask(self._camera, _read_mask(mask, self._camera), opaque)
        frame = self._next_frame(timestamp_s)
        fitted, misfit = self._watch.fitted(picture)
        if fitted is None:
            return self._lost(frame, misfit)
        frame = replace(frame, message=joined(frame.message, misfit))
        gray = np.asarray(cv2.cvtColor(fitted, cv2.COLOR_RGB2GRAY), np.uint8)
        verdict = self._watch.verdict(gray)
        if verdict == "blank":
            return self._lost(frame, "is blank")
        before, self._last_seen = self._last_seen, frame.index
        if verdict == "frozen":
            return self._repeated(frame, self._results[before])
        tracked = self._tracker.track(gray, self._motion.turn)
        seen = np.ones(len(tracked.ids), np.bool_)
        if usable is not None:
            seen = usable_at(usable, tracked.pixels * self._full_from_working)
        tracks = FrameTracks(
            frame.index,
            tracked.ids[seen],
            tracked.bearings[seen],
            tracked.pixels[seen] * self._full_from_working,
        )
        self._motion.look(tracks)
        num_tracked = int(np.count_nonzero(~tracked.is_new[seen]))
        frame = replace(frame, num_tracked=num_tracked)
        usual = self._gaps.usual_before(num_tracked) if before >= 0 else None
        if usual is not None:
            said = joined(frame.message, _GAP.format(num_tracked=num_tracked, usual=usual))
            frame = replace(frame, follows_gap=True, message=said)
        is_far = usual is not None and num_tracked < FAR_SHARE * usual
        return self._kept(self._place(tracks, frame, fitted, gray, is_far))

    def skip_frame(self, reason: str, timestamp_s: float | None = None) -> FrameResult:
        """Count a frame that cannot be used, for example because its file is damaged.

        Parameters
        ----------
        reason : str
            Why, for the frame's message.
        timestamp_s : float, optional
            Time stamp in seconds.
        """
        return self._lost(self._next_frame(timestamp_s), reason)

    def finish(self) -> None:
        """Adjust the whole map once, when no frame follows."""
        if self._main is not None:
            self._main.adjust_all()
            self._connections.forget()

    def results(self) -> list[FrameResult]:
        """What is known of each frame by now: frames that waited have their poses.

        Frames of other parts of a sequence that was cut are "lost", and their messages say which
        part they are in.
        """
        main = self._main
        if main is None:
            return list(self._results)
        for segment in self._segments.values():
            segment.pose_waiting()
        return updated_results(self._results, self._segments, main)

    def trajectory(self) -> Trajectory:
        """Poses of all frames that have one, as the map is now."""
        return trajectory_of(self.results())

    def key_frames(self) -> list[KeyFrame]:
        """Key frames of the map; empty before it begins."""
        return [] if self._main is None else self._main.map.key_frames

    def points(self) -> MapPoints:
        """Landmarks of the map and where its key frames see them."""
        return no_points() if self._main is None else self._main.points()

    def move_map(self, cam_from_world: Sequence[Pose], positions: NDArray[np.float64]) -> None:
        """Put key frames and points where another adjustment has found them; frames follow.

        Parameters
        ----------
        cam_from_world : sequence of Pose
            Pose of each of `key_frames`.
        positions : ndarray, shape (P, 3)
            Positions of `points`, in their order.

        Raises
        ------
        ValueError
            If there are not as many as of key frames and points.
        """
        if self._main is not None:
            self._main.move(cam_from_world, positions)
            self._connections.forget()

    def began_past(self, index: int) -> bool:
        """Whether frames from one on began a map that has been joined with that of those before.

        Then it is sure that both belong together, whatever is missing between them.

        Parameters
        ----------
        index : int
            Number of the frame.
        """
        main = self._main
        if main is None or not any(each < index for each in main.frames):
            return False
        after = [each for each in main.frames if each >= index]
        return bool(after) and main.frames[min(after)].key_frame.chain >= index

    @property
    def num_segments(self) -> int:
        """Number of maps: more than one where the sequence was cut and no place seen again."""
        return len(self._segments)

    @property
    def _main(self) -> Segment | None:
        sizes = {number: len(segment.frames) for number, segment in self._segments.items()}
        if not sizes:
            return None
        return self._segments[min(sizes, key=lambda number: (-sizes[number], number))]

    @property
    def _segment(self) -> Segment | None:
        return self._segments.get(self._active)

    def _new_wait(self) -> Waiting:
        return Waiting(
            self._working,
            float(np.radians(self._options.start_sigma_deg)),
            self._seed,
            self._gravity,
        )

    def _next_frame(self, timestamp_s: float | None) -> FrameResult:
        """Result of the next frame as far as its time stamp goes."""
        stamp, said = self._clock.stamp(timestamp_s)
        return FrameResult(len(self._results), stamp, "lost", Pose.nan(), message=said)

    def _place(
        self,
        tracks: FrameTracks,
        frame: FrameResult,
        image: NDArray[np.uint8],
        gray: NDArray[np.uint8],
        is_far: bool,
    ) -> FrameResult:
        """Fill in where a frame was taken, perhaps far from the one before."""
        segment = self._segment
        if segment is None:
            return self._wait(tracks, frame, image, gray)
        guess = None if self._is_lost else self._motion.guess(segment)
        result = segment.locate(tracks, guess)
        is_asked = self._is_lost or is_far
        if result is not None and is_asked and segment.denies(tracks, result.cam_from_world, gray):
            tracks, result = self._begun_anew(tracks), None
            self._is_in_doubt = True
            frame = replace(frame, message=joined(frame.message, _ELSEWHERE))
        if result is None:
            if not self._is_lost:
                self._is_lost, self._waiting = True, self._new_wait()
            segment, result = self._found_again(segment, tracks, gray)
        if result is None:
            message = joined(frame.message, "shows too little of the map")
            return self._wait(tracks, replace(frame, message=message), image, gray)
        if self._is_lost:
            frame = replace(frame, message=joined(frame.message, "the map is found again"))
            segment.add_waited(self._waiting.frames)
            self._found()
            self._motion.restart()
        segment.agree(tracks, result)
        pose, count = result.cam_from_world, int(result.inlier_mask.sum())
        is_key_frame = segment.wants_key_frame(tracks, pose, count)
        if is_key_frame:
            pose = segment.add_key_frame(tracks, pose)
            segment.color(segment.last_key_frame, image, self._full_from_working)
            frame = self._recognised(segment, frame, gray)
            pose = segment.last_key_frame.cam_from_world
        segment.add_frame(tracks.index, pose, count)
        self._motion.follow(tracks.index)
        return replace(
            frame,
            status="tracked",
            cam_from_world=pose,
            num_inliers=count,
            is_keyframe=is_key_frame,
        )

    def _wait(
        self,
        tracks: FrameTracks,
        frame: FrameResult,
        image: NDArray[np.uint8],
        gray: NDArray[np.uint8],
    ) -> FrameResult:
        """Wait for a first map, or for another one while the map is lost."""
        start = self._waiting.add(tracks)
        if self._waiting.reference_index == tracks.index:
            self._first_index, self._first_gray = tracks.index, gray
        status: FrameStatus = "lost" if self._is_lost else start.status
        message = frame.message if self._is_lost else joined(frame.message, start.message)
        frame = replace(frame, status=status, message=message)
        if not start.has_begun:
            return frame
        if self._is_lost and self._num_lost < _TRIES:  # the old map may still be found again
            self._waiting.keep(tracks)
            return frame
        segment = self._begun(start, tracks)
        if segment is None:
            self._waiting.keep(tracks)
            return replace(frame, status="lost" if self._is_lost else "waiting")
        segment.color(segment.last_key_frame, image, self._full_from_working)
        if segment.map.key_frames[0].index == self._first_index:
            segment.recognise_first(self._first_gray)
        self._first_index, self._first_gray = -1, None
        said = start.message
        if self._num_begun > 1:
            said = f"another place, map {self._num_begun}: {said}"
        frame = self._recognised(segment, replace(frame, message=said), gray)
        return replace(
            frame,
            status="tracked",
            cam_from_world=segment.pose_of(tracks.index),
            num_inliers=segment.frames[tracks.index].num_inliers,
            is_keyframe=True,
        )

    def _recognised(
        self, segment: Segment, frame: FrameResult, gray: NDArray[np.uint8]
    ) -> FrameResult:
        """Look where the place of the newest key frame was seen before, and say so."""
        old = segment.recognise(gray)
        if old is not None:
            said = joined(frame.message, f"closes a loop with frame {old}")
            return replace(frame, message=said, loop_frame=old)
        if not self._options.loop_closure:
            return frame
        found = self._connections.find(self._active, self._segments)
        if found is None:
            return frame
        number, connections = found
        other = self._segments.pop(number)
        old = other.map.key_frames[connections[1].loop.old].index
        segment.take_in(other, connections, self._tracker.new_identities)
        first, second = sorted((number, self._active))
        del self._segments[self._active]
        self._segments[first], self._active = segment, first
        self._connections.forget()
        message = joined(frame.message, f"joins map {second} to map {first}, by frame {old}")
        return replace(frame, message=message, loop_frame=old)

    def _found(self) -> None:
        """Count no longer as lost."""
        self._is_lost, self._is_in_doubt, self._num_lost = False, False, 0

    def _begun_anew(self, tracks: FrameTracks) -> FrameTracks:
        """The points of a frame as new ones: they were followed from what only looks like them."""
        tracks = replace(tracks, ids=self._tracker.begin_anew(tracks.ids))
        self._motion.look(tracks)
        return tracks

    def _begun(self, start: Start, tracks: FrameTracks) -> Segment | None:
        """Begin a map; None if the frame does not find its place in it."""
        waited = self._waiting.frames
        recognition = Recognition(self._working, self._usable, self._pixel_rad)
        segment = Segment.begin(
            start, tracks, waited, self._pixel_rad, self._options, recognition, self._gravity
        )
        pose = segment.last_key_frame.cam_from_world
        if segment.locate(tracks, pose) is None:
            return None
        segment.add_frame(tracks.index, pose, segment.map.num_seen_by(segment.last_key_frame))
        self._num_begun += 1
        self._active = self._num_begun
        self._segments[self._active] = segment
        self._found()
        before = [tracks.index - 1] if tracks.index - 1 in segment.frames else []
        self._motion.restart(*before, tracks.index)
        return segment

    def _found_again(
        self, active: Segment, tracks: FrameTracks, gray: NDArray[np.uint8]
    ) -> tuple[Segment, AbsolutePoseFit | None]:
        """The map, of all there are, whose key frames show what a lost frame shows."""
        self._num_lost += 1
        if self._num_lost > _TRIES and self._num_lost % _TRIES:
            return active, None
        others = [number for number in sorted(self._segments) if number != self._active]
        for number in (self._active, *others):
            segment = self._segments[number]
            result = segment.find(gray, tracks, in_doubt=self._is_in_doubt)
            if result is not None:
                self._active = number
                return segment, result
        return active, None

    def _repeated(self, frame: FrameResult, before: FrameResult) -> FrameResult:
        """Result of a frame that shows the picture of an earlier one, the last that shows any."""
        said = joined(frame.message, f"repeats the picture of frame {before.index}")
        segment = self._segment
        frame = replace(frame, message=said, num_inliers=before.num_inliers)
        if segment is not None and before.index in segment.frames and not self._is_lost:
            pose = segment.pose_of(before.index)
            segment.add_frame(frame.index, pose, before.num_inliers)
            self._motion.restart(frame.index)
            return self._kept(replace(frame, status="tracked", cam_from_world=pose))
        if segment is None:
            self._waiting.repeat(frame.index)
            status: FrameStatus = "static" if before.status != "turning" else "turning"
            return self._kept(replace(frame, status=status))
        return self._kept(replace(frame, status="lost"))

    def _lost(self, frame: FrameResult, reason: str) -> FrameResult:
        """Result of a frame that cannot be used; the next one is tracked from the one before."""
        said = joined(frame.message, reason)
        self._motion.skip()
        return self._kept(replace(frame, status="lost", message=said))

    def _kept(self, result: FrameResult) -> FrameResult:
        if result.message:
            result = replace(result, message=f"frame {result.index}: {result.message}")
        self._results.append(result)
        return result


def _read_mask(mask: ImageSource | None, camera: Camera) -> NDArray[np.bool_] | None:
    """Mask of one frame; one of bool may leave nothing of it."""
    shape = camera.height, camera.width
    if isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == shape:
        return mask
    return None if mask is None else read_mask(mask, shape)
