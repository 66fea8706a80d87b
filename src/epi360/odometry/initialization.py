# SPDX-License-Identifier: BSD-3-Clause
"""The first two key frames: wait until the motion between two frames is known well enough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import smallest_pixel_deg
from epi360.estimation import RelativePoseResult, estimate_relative_pose
from epi360.estimation.sky_motion import with_ground_motion
from epi360.odometry.frame_result import FrameStatus, FrameTracks, shared_rows
from epi360.odometry.gravity import GravityPrior
from epi360.odometry.turning import rotation_angle, rotation_between
from epi360.poses import angles_of_units

Array = NDArray[np.float64]

_SMALLEST_SHARE = 0.35  # of the tracks of the reference; with fewer, a later frame replaces it
_FEWEST_TRACKS = 40
_MOST_FRAMES = 400  # that wait for a pose; of a longer wait every second one is dropped
_TRACKS_PER_FRAME = 300  # that a waiting frame keeps; a pose from so many is as good as from all
# Median angles in pixels: a still picture leaves less than the first; a rotation that explains the
# picture leaves less than the second.
_STILL_PX, _TURNING_PX = 0.12, 0.15
# Each point of the first map then has its depth to a fifth.
_PARALLAX_SIGMAS = 5.0
_TRACK_NOISE_PX = 0.05  # what neighbouring tracks share does not show in their residuals


@dataclass(frozen=True, eq=False)
class Start:
    """Where the wait stands: a status with a sentence, and the two frames once they are known."""

    status: FrameStatus
    message: str
    reference: FrameTracks | None = None
    result: RelativePoseResult | None = None
    rows: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None  # of the inliers in both frames

    @property
    def has_begun(self) -> bool:
        """Whether the motion is known."""
        return self.result is not None


class Waiting:
    """Frames from the first one kept until a map can begin."""

    def __init__(
        self,
        camera: Camera,
        sigma_rad: float,
        seed: int,
        gravity: GravityPrior | None = None,
    ) -> None:
        self.frames: list[FrameTracks] = []
        self._reference: FrameTracks | None = None
        self._camera = camera
        self._pixel_rad = float(np.radians(smallest_pixel_deg((camera, camera))))
        self._sigma_rad = sigma_rad
        self._seed = seed
        self._gravity = gravity
        self._before: FrameTracks | None = None

    @property
    def reference_index(self) -> int:
        """Number of the frame with which later ones are compared, -1 before there is one."""
        return -1 if self._reference is None else self._reference.index

    def add(self, tracks: FrameTracks) -> Start:
        """Take a frame, and say whether a map can begin with it."""
        before, self._before = self._before, tracks
        if self._reference is None:
            self._restart(tracks)
            return Start("waiting", "")
        start = self._compared(tracks, before)
        if not start.has_begun:
            self.keep(tracks)
        return start

    def keep(self, tracks: FrameTracks) -> None:
        """Keep a frame that waits for a pose."""
        self.frames.append(tracks.thinned(_TRACKS_PER_FRAME))
        if len(self.frames) > _MOST_FRAMES:
            del self.frames[1::2]

    def repeat(self, index: int) -> None:
        """Keep a frame that shows the picture of the last one."""
        if self.frames:
            self.keep(replace(self.frames[-1], index=index, is_repeat=True))

    def _compared(self, tracks: FrameTracks, before: FrameTracks | None) -> Start:
        assert self._reference is not None
        rows1, rows2 = shared_rows(self._reference.ids, tracks.ids)
        share = len(rows1) / max(len(self._reference.ids), 1)
        if len(rows1) < _FEWEST_TRACKS or share < _SMALLEST_SHARE:
            return self._moved_on(tracks)
        bearings1, bearings2 = self._reference.bearings[rows1], tracks.bearings[rows2]
        rotation, left = rotation_between(bearings1, bearings2)
        parallax_px = float(np.median(left)) / self._pixel_rad
        if parallax_px < _TURNING_PX:
            return self._without_parallax(tracks, before, rotation)
        result = self._two_views(bearings1, bearings2)
        sigma = direction_sigma(result)
        noise_rad = max(np.radians(result.noise_deg), _TRACK_NOISE_PX * self._pixel_rad)
        strong = np.radians(result.parallax_deg) >= _PARALLAX_SIGMAS * noise_rad
        if result.status == "ok" and sigma <= self._sigma_rad and strong:
            inliers = result.inlier_mask
            said = (
                f"the map begins with frames {self._reference.index} and {tracks.index}: parallax "
                f"{result.parallax_deg:.2f} degrees, direction known to "
                f"{np.degrees(sigma):.1f} degrees"
            )
            rows = (rows1[inliers], rows2[inliers])
            return Start("tracked", said, self._reference, result, rows)
        if result.status == "pure_rotation":
            return self._without_parallax(tracks, before, rotation)
        known = f"known to {np.degrees(sigma):.0f} degrees" if np.isfinite(sigma) else "unknown"
        said = f"parallax of {parallax_px:.1f} pixels: the direction of motion is {known}"
        return Start("waiting", f"{said} since frame {self._reference.index}")

    def _two_views(self, bearings1: Array, bearings2: Array) -> RelativePoseResult:
        gravity = self._gravity
        estimate = partial(
            estimate_relative_pose,
            gravity1=None if gravity is None else gravity.direction,
            gravity2=None if gravity is None else gravity.direction,
            gravity_sigma_deg=1.0 if gravity is None else float(np.degrees(gravity.sigma_rad)),
            seed=self._seed,
        )
        result = estimate(bearings1, bearings2)
        both = self._camera, self._camera
        return with_ground_motion(result, (bearings1, bearings2), both, estimate)

    def _without_parallax(
        self, tracks: FrameTracks, before: FrameTracks | None, rotation: Array
    ) -> Start:
        assert self._reference is not None
        since = f"since frame {self._reference.index}"
        if rotation_angle(rotation) < _STILL_PX * self._pixel_rad * 4 or _is_still(
            tracks, before, _STILL_PX * self._pixel_rad
        ):
            return Start("static", f"the camera has not moved {since}")
        return Start("turning", f"the camera has not moved {since}, only turned")

    def _moved_on(self, tracks: FrameTracks) -> Start:
        """Replace the reference by the oldest waiting frame that shares enough tracks."""
        assert self._reference is not None
        old = self._reference.index
        for frame in self.frames:
            shared = len(shared_rows(frame.ids, tracks.ids)[0])
            if (
                frame.index > old
                and not frame.is_repeat
                and shared >= max(_FEWEST_TRACKS, 0.6 * len(frame.ids))
            ):
                self._reference = frame
                return Start("waiting", f"the wait goes on from frame {frame.index}")
        self._restart(tracks)
        return Start("waiting", f"shows too little of frame {old}")

    def _restart(self, tracks: FrameTracks) -> None:
        self._reference = tracks
        self.keep(tracks)


def direction_sigma(result: RelativePoseResult) -> float:
    """Largest standard deviation of the direction of motion, in radians; NaN if not known."""
    covariance = result.covariance[3:, 3:]
    if not np.isfinite(covariance).all():
        return float("nan")
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


def _is_still(tracks: FrameTracks, before: FrameTracks | None, limit_rad: float) -> bool:
    if before is None:
        return False
    rows1, rows2 = shared_rows(before.ids, tracks.ids)
    moved = angles_of_units(before.bearings[rows1], tracks.bearings[rows2])
    return len(moved) > 0 and float(np.median(moved)) < limit_rad
