# SPDX-License-Identifier: BSD-3-Clause
"""How the camera has moved last, and where its next frame should be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.odometry.frame_result import FrameTracks, shared_rows
from epi360.odometry.segment import Segment
from epi360.odometry.turning import nearest_rotation, rotation_between
from epi360.poses import Pose

_FEWEST_TO_TURN = 20  # tracks that predict how the camera turns


class Motion:
    """Predicts turn and place of the next frame from the last ones."""

    def __init__(self) -> None:
        self.turn: NDArray[np.float64] | None = None  # cam_now_from_before of the last frame
        self._before: FrameTracks | None = None
        self._recent: list[int] = []  # the last two frames with a pose, if nothing lies between

    def look(self, tracks: FrameTracks) -> None:
        """See how the camera has turned since the frame before; the next one should turn alike."""
        before, self._before = self._before, tracks
        self.turn = None
        if before is None:
            return
        rows1, rows2 = shared_rows(before.ids, tracks.ids)
        if len(rows1) >= _FEWEST_TO_TURN:
            self.turn, _ = rotation_between(before.bearings[rows1], tracks.bearings[rows2])

    def follow(self, index: int) -> None:
        """Count a frame that got its pose after the one before."""
        self._recent = [*self._recent[-1:], index]

    def restart(self, *indices: int) -> None:
        """Go on from these frames alone, at most two that follow each other."""
        self._recent = list(indices)

    def skip(self) -> None:
        """Count a frame that cannot be used."""
        self._recent = self._recent[-1:]

    def guess(self, segment: Segment) -> Pose | None:
        """Where the frame should be if the camera goes on, turned as its tracks have turned."""
        if not self._recent:
            return None
        last = segment.pose_of(self._recent[-1])
        turn = np.eye(3) if self.turn is None else self.turn
        center = -(last.rotation.T @ last.translation)
        if len(self._recent) > 1:
            before = segment.pose_of(self._recent[-2])
            center = 2 * center + before.rotation.T @ before.translation
        rotation = nearest_rotation(turn @ last.rotation)
        return Pose(rotation, -(rotation @ center))
