# SPDX-License-Identifier: BSD-3-Clause
"""Small pictures of the frames that the report of a sequence shows, kept while frames come in."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.features.picture_writing import encode_picture
from epi360.odometry import FrameResult, Odometry
from epi360.report.html_page import picture_address, shrunk

_KEPT_SIZES = ((300, 640), (10**9, 400))  # up to so many pictures, of this width
_MOST_WITHOUT_POSE = 300  # frames of a long wait look alike
_PICTURE_BYTES = 7_000_000  # of a page, as they stand in it
_PICTURE_SIZES = ((640, 76), (512, 72), (400, 68), (320, 64), (256, 60), (192, 50))


class TrackPictures:
    """Watcher of `track_frames` that keeps pictures of key frames, and of frames without a pose."""

    def __init__(self) -> None:
        self.odometry: Odometry | None = None
        self._pictures: dict[int, bytes] = {}
        self._num_without_pose = 0

    def __call__(
        self, odometry: Odometry, result: FrameResult, image: NDArray[np.uint8] | None
    ) -> None:
        """Keep the picture of a frame that may be shown."""
        # The first frames of a map have waited for it: they become key frames afterwards.
        waits = result.status != "tracked" and self._num_without_pose < _MOST_WITHOUT_POSE
        if image is None or not (result.is_keyframe or waits):
            return
        self._num_without_pose += waits
        size = next(size for most, size in _KEPT_SIZES if len(self._pictures) < most)
        self._pictures[result.index] = encode_picture(shrunk(image, size), ".jpg", jpeg_quality=85)

    def close(self, odometry: Odometry) -> None:
        """Keep the final map."""
        self.odometry = odometry

    def addresses(self, frames: Sequence[int]) -> Mapping[int, str]:
        """Return data addresses of those of the frames that have a picture; all fit one page."""
        known = [frame for frame in frames if frame in self._pictures]
        share = _PICTURE_BYTES / max(len(known), 1)
        return {frame: _fitting(self._pictures[frame], share) for frame in known}


def _fitting(content: bytes, most: float) -> str:
    address = "data:image/jpeg;base64," + base64.b64encode(content).decode("ascii")
    decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    image = np.asarray(cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB), np.uint8)
    for size, quality in _PICTURE_SIZES:
        if len(address) <= most:
            break
        address = picture_address(image, size, quality)
    return address
