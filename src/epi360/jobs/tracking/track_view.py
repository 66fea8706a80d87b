# SPDX-License-Identifier: BSD-3-Clause
"""The growing trajectory and map in Rerun: a window, a file, or both."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360.odometry import FrameResult, Odometry

_PICTURE_WIDTH = 512  # of the frames in a recording: the file stays a few MB a minute
_MAP_EVERY = 10  # key frames between two looks at all points, which would fill the file
_PORT = 9876  # of Rerun's viewer
_MOST_SECONDS = 30.0  # that the end of a run waits for a viewer which has stopped answering
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
_INSTEAD = "leave it out, and open what --recording FILE.rrd writes on a machine with a display"


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
    ValueError
        If a window is asked for where there is no display, the viewer does not open, or the
        recording cannot be written.
    """

    def __init__(self, *, window: bool, recording: Path | None) -> None:
        self._rr: Any = extra_library("rerun", extra="viz", purpose="views of a trajectory")
        self._stream = self._rr.RecordingStream("epi360 track")
        sinks = []
        if window:
            _open_viewer(self._stream)
            sinks.append(self._rr.GrpcSink(f"rerun+http://127.0.0.1:{_PORT}/proxy"))
        if recording is not None:
            sinks.append(self._rr.FileSink(str(recording)))
        try:
            self._stream.set_sinks(*sinks)
        except RuntimeError as error:
            raise ValueError(f"recording {recording} cannot be written: {error}") from None
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
        try:
            self._stream.flush(timeout_sec=_MOST_SECONDS)
        except RuntimeError:  # the window was closed meanwhile, which must not end the run
            pass
        self._stream.disconnect()


def _open_viewer(stream: Any) -> None:
    """Open Rerun's viewer; without a display it would start and end again without a word."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in _DISPLAYS):
        raise ValueError(f"--view opens a window, and there is no display here: {_INSTEAD}")
    try:
        stream.spawn(port=_PORT, connect=False)
    except RuntimeError as error:  # its program is missing
        raise ValueError(f"--view cannot open Rerun's viewer: {error}") from None
    if not _is_listening():
        raise ValueError(f"--view: Rerun's viewer did not open a window here: {_INSTEAD}")


def _is_listening() -> bool:
    try:
        socket.create_connection(("127.0.0.1", _PORT), timeout=1.0).close()
    except OSError:
        return False
    return True
