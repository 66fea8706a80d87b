# SPDX-License-Identifier: BSD-3-Clause
"""The growing trajectory and map in Rerun: a window, a file, or both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360.odometry import FrameResult, Odometry

_PICTURE_WIDTH = 512  # of the frames in a recording: the file stays a few MB a minute
_MAP_EVERY = 10  # key frames between two looks at all points, which would fill the file


class TrackView:
    """Watcher of `track_frames` that logs each frame to Rerun.

    Parameters
    ----------
    window : bool
        Open Rerun's viewer.
    recording : Path, optional
        File (.rrd) that gets everything.

    Raises
    ------
    ImportError
        If rerun-sdk is missing.
    """

    def __init__(self, *, window: bool, recording: Path | None) -> None:
        self._rr: Any = extra_library("rerun", extra="viz", purpose="views of a trajectory")
        self._stream = self._rr.RecordingStream("epi360 track")
        sinks = []
        if window:
            self._stream.spawn(connect=False)
            sinks.append(self._rr.GrpcSink())
        if recording is not None:
            sinks.append(self._rr.FileSink(str(recording)))
        self._stream.set_sinks(*sinks)
        self._stream.log("world", self._rr.ViewCoordinates.RDF, static=True)
        self._num_key_frames = 0

    def __call__(
        self, odometry: Odometry, result: FrameResult, image: NDArray[np.uint8] | None
    ) -> None:
        """Log a frame: its picture, its pose and, after a few key frames, the map."""
        self._stream.set_time("frame", sequence=result.index)
        if image is not None:
            height = round(_PICTURE_WIDTH * image.shape[0] / image.shape[1])
            small = cv2.resize(image, (_PICTURE_WIDTH, height), interpolation=cv2.INTER_AREA)
            self._stream.log("camera/picture", self._rr.Image(small).compress(jpeg_quality=75))
        self._stream.log("status", self._rr.TextLog(f"{result.status} {result.message}".strip()))
        if result.status == "tracked":
            pose = result.cam_from_world.inverse()
            self._stream.log(
                "world/camera",
                self._rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation),
                self._rr.TransformAxes3D(0.3),
            )
        if result.is_keyframe:
            self._num_key_frames += 1
            if self._num_key_frames % _MAP_EVERY == 1:
                self.log_map(odometry)

    def log_map(self, odometry: Odometry) -> None:
        """Log the path of the key frames and all points as they are now."""
        centers = [key_frame.center for key_frame in odometry.key_frames()]
        self._stream.log("world/path", self._rr.LineStrips3D([centers]))
        points = odometry.points()
        self._stream.log("world/points", self._rr.Points3D(points.positions, colors=points.colors))

    def close(self, odometry: Odometry) -> None:
        """Log the final map and bring everything to the file."""
        self.log_map(odometry)
        self._stream.flush()
        self._stream.disconnect()
