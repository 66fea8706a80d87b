# SPDX-License-Identifier: BSD-3-Clause
"""Which frames of a video to keep: sharp ones, between which the camera has moved far enough."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import resized_camera
from epi360.features.tracking import track_features
from epi360.odometry.turning import rotation_between

Picture = NDArray[np.uint8]

TRACKED_WIDTH = 640  # half a degree a pixel: enough to measure degrees of parallax
_LOOKS = 8  # frames that are looked at between two choices, about
_RUNS = (4, 8, 16, 32)  # frames after which the tracks are looked at; the last is the memory
# Below this share of the points, two frames have too little in common for the next one to wait.
_LEAST_SURVIVAL = 0.4
_LEAST_TRACKS = 20  # of a frame that can be compared at all: a black one has none
# Frames whose parallax is this near the wanted one compete by their sharpness.
_TOLERANCE = 0.25


@dataclass(frozen=True)
class ChosenFrame:
    """A frame that was chosen, and its parallax to the one before, NaN for the first."""

    index: int
    timestamp_s: float
    parallax_deg: float


@dataclass(frozen=True)
class _Candidate:
    index: int
    timestamp_s: float
    picture: Picture  # small
    sharpness: float


@dataclass
class FrameChooser:
    """Chooses frames one after the other from a stream of them, in constant memory.

    ``camera`` and ``mask`` are those of the frames; a frame is chosen when half of the points of
    the last one have moved by ``parallax_deg``, what the camera turned taken out, or when more than
    half of them are lost. The sharpest of the frames around there is taken.
    """

    camera: Camera
    parallax_deg: float
    mask: NDArray[np.bool_] | None = None
    _waiting: list[_Candidate] = field(default_factory=list)
    _anchor_parallax_deg: float = float("nan")
    _stride: int = 1  # a camera that moves slowly: one frame in so many is looked at
    _pending: _Candidate | None = None
    _count: int = 0

    def __post_init__(self) -> None:
        width = min(TRACKED_WIDTH, self.camera.width)
        self._small = resized_camera(self.camera, width)
        size = (self._small.width, self._small.height)
        if self.mask is not None:
            small = cv2.resize(self.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
            self.mask = small > 0

    def add(self, index: int, timestamp_s: float, image: Picture) -> Iterator[ChosenFrame]:
        """Frames that are chosen now that this one is known; most often none."""
        size = (self._small.width, self._small.height)
        picture = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        candidate = _Candidate(index, timestamp_s, picture, _sharpness(picture))
        # Of the frames in a stride, the sharpest is kept.
        if self._pending is None or candidate.sharpness > self._pending.sharpness:
            self._pending = candidate
        self._count += 1
        if self._count < self._stride and self._waiting:
            return
        self._waiting.append(self._pending)
        self._pending, self._count = None, 0
        if len(self._waiting) in _RUNS:
            yield from self._choose()
        if len(self._waiting) >= _RUNS[-1]:
            self._thin()

    def finish(self) -> Iterator[ChosenFrame]:
        """Frames that are left at the end of the video."""
        if self._pending is not None:
            self._waiting.append(self._pending)
        yield from self._choose()
        if self._waiting and not np.isnan(self._moved()[1]).all():
            yield self._chosen(self._waiting[0])
        self._waiting = []

    def _chosen(self, candidate: _Candidate) -> ChosenFrame:
        return ChosenFrame(candidate.index, candidate.timestamp_s, self._anchor_parallax_deg)

    def _choose(self) -> Iterator[ChosenFrame]:
        """Take the first waiting frame, and go on from the next choice, as long as there is one."""
        while len(self._waiting) > 1:
            parallax_deg, survival = self._moved()
            if np.isnan(survival).all():  # nothing to track, as in a black frame: it is not used
                self._waiting.pop(0)
                continue
            next_one = self._next(parallax_deg, survival)
            if next_one is None:
                return
            yield self._chosen(self._waiting[0])
            self._anchor_parallax_deg = float(parallax_deg[next_one])
            self._waiting = self._waiting[next_one:]
            # The next choice is likely to take about as long.
            self._stride = max(1, self._stride * next_one // _LOOKS)

    def _moved(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Median parallax of each waiting frame to the first, and the share of points left."""
        pictures = [candidate.picture for candidate in self._waiting]
        pictures = pictures * 2 if len(pictures) == 1 else pictures
        tracks = track_features(pictures, self._small, self.mask, min_distance_deg=2.0)
        num, count = tracks.keypoints.shape[:2]
        parallax_deg, survival = np.zeros(num), np.full(num, np.nan)
        if count < _LEAST_TRACKS:
            return parallax_deg, survival
        bearings = self._small.bearings_from_pixels(tracks.keypoints.reshape(-1, 2))
        bearings = bearings.reshape(num, count, 3)
        for index in range(num):
            seen = np.isfinite(bearings[index]).all(axis=1)
            survival[index] = seen.mean()
            if seen.sum() >= 3:
                first, now = bearings[0, seen], bearings[index, seen]
                parallax_deg[index] = np.degrees(np.median(rotation_between(first, now)[1]))
        return parallax_deg, survival

    def _next(self, parallax_deg: NDArray[np.float64], survival: NDArray[np.float64]) -> int | None:
        """Position of the frame to choose after the first, None while none is far enough."""
        lost = survival < _LEAST_SURVIVAL
        far = (parallax_deg >= self.parallax_deg) & ~lost
        reached = np.flatnonzero(far | lost)
        if len(reached) == 0:
            return None
        first = int(reached[0])
        low, high = (1 - _TOLERANCE) * self.parallax_deg, (1 + _TOLERANCE) * self.parallax_deg
        near = (parallax_deg >= low) & (parallax_deg <= high) & ~lost
        if lost[first]:  # the last frame that still shares enough, if it is another one
            near = np.zeros(len(lost), np.bool_)
            near[max(1, first - 1)] = True
        near[first] |= not near.any()
        near[0] = False
        candidates = np.flatnonzero(near)
        sharpness = [self._waiting[position].sharpness for position in candidates]
        return int(candidates[int(np.argmax(sharpness))])

    def _thin(self) -> None:
        """Keep the first frame, and of each two that follow the sharper one."""
        first, *rest = self._waiting
        pairs = [rest[start : start + 2] for start in range(0, len(rest), 2)]
        self._waiting = [first, *(max(pair, key=lambda c: c.sharpness) for pair in pairs)]
        self._stride *= 2


def _sharpness(picture: Picture) -> float:
    """Variance of the Laplacian over that of the picture: exposure does not change it."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    edges = cv2.Laplacian(grey, cv2.CV_32F)
    return float(edges.var() / (float(grey.var()) + 1.0))
