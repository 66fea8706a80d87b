# SPDX-License-Identifier: BSD-3-Clause
"""What the odometry says of each frame, and the trajectory of all of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose

Array = NDArray[np.float64]
FrameStatus = Literal["tracked", "waiting", "static", "turning", "lost"]


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Where one frame of a sequence was taken, or why that is not known.

    Attributes
    ----------
    index : int
        Number of the frame in the order in which frames were added, from 0.
    timestamp_s : float
        Time stamp in seconds; the index if none was given.
    status : str
        "tracked": the frame has a pose. "waiting": the camera has moved too little for a first map.
        "static": it has not moved. "turning": it only turned. "lost": the frame shows nothing
        that the map knows, or could not be read.
    cam_from_world : Pose
        Pose of the frame, NaN if it has none. The unit of length is the distance between the first
        two key frames.
    num_tracked : int
        Points followed from the frame before.
    num_inliers : int
        Points of the map that agree with the pose.
    is_keyframe : bool
        Whether the frame became a key frame of the map.
    loop_frame : int, optional
        Number of an earlier frame whose place the camera has come back to, where that corrected the
        trajectory or joined two maps.
    message : str
        Sentence for a person, empty when there is nothing to say.
    follows_gap : bool
        Far fewer points could be followed than from frame to frame before, as where frames are
        missing. Where a place repeats itself, the map may go on in another part of it.
    """

    index: int
    timestamp_s: float
    status: FrameStatus
    cam_from_world: Pose
    num_tracked: int = 0
    num_inliers: int = 0
    is_keyframe: bool = False
    message: str = ""
    loop_frame: int | None = None
    follows_gap: bool = False


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the frames that have one, in their order.

    Attributes
    ----------
    indices : ndarray, shape (F,)
        Numbers of the frames.
    timestamps_s : ndarray, shape (F,)
        Their time stamps in seconds.
    cam_from_world : tuple of Pose
        Their poses.
    """

    indices: NDArray[np.int64]
    timestamps_s: Array
    cam_from_world: tuple[Pose, ...]

    @property
    def positions(self) -> Array:
        """Positions (F, 3) of the camera in the world."""
        centers = [-(pose.rotation.T @ pose.translation) for pose in self.cam_from_world]
        return np.array(centers).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class MapPoints:
    """Points of the map with the key frames that see them.

    Attributes
    ----------
    positions : ndarray, shape (P, 3)
        In the world of the poses.
    colors : ndarray, shape (P, 3)
        RGB.
    point_index, key_frame_index : ndarray, shape (K,)
        Row of the point and of the key frame (in `Odometry.key_frames`) of each observation.
    pixels : ndarray, shape (K, 2)
        Where the key frame sees the point, in continuous pixels.
    """

    positions: Array
    colors: NDArray[np.uint8]
    point_index: NDArray[np.int64]
    key_frame_index: NDArray[np.int64]
    pixels: Array


@dataclass(frozen=True, eq=False)
class FrameTracks:
    """Points seen in one frame, by the identity of their track."""

    index: int
    ids: NDArray[np.int64]
    bearings: Array
    pixels: Array = field(default_factory=lambda: np.zeros((0, 2)))
    is_repeat: bool = False  # the picture is that of the frame before: no view of its own

    def thinned(self, count: int) -> FrameTracks:
        """Tracks with the lowest identities, which have been followed longest."""
        if len(self.ids) <= count:
            return self
        rows = np.argsort(self.ids, kind="stable")[:count]
        return replace(
            self, ids=self.ids[rows], bearings=self.bearings[rows], pixels=self.pixels[rows]
        )


def shared_rows(
    a: NDArray[np.int64], b: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows in both arrays of the identities that both have; the first of those that repeat."""
    # Two tracks may show one landmark once a loop is closed, so that its identity repeats.
    _, rows_a, rows_b = np.intersect1d(a, b, return_indices=True)
    return rows_a, rows_b
