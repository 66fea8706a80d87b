# SPDX-License-Identifier: BSD-3-Clause
"""Pictures and masks of cube faces, cut out of those of any camera."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Pinhole
from epi360.cameras.resizing import pixels_per_radian
from epi360.features.resampling import Resampling
from epi360.jobs.cubes.cube_faces import FaceName, face_from_cam

_SAMPLES_AT_ONCE = 2**19  # whose directions are in memory together


class FaceSampler:
    """Cuts one face out of the pictures of one camera.

    ``visible`` (size, size) has the pixels whose direction the camera sees.
    """

    def __init__(self, camera: Camera, pinhole: Pinhole, face: FaceName) -> None:
        self._size = pinhole.width
        # If a face pixel covers several of the picture, it is the mean of so many samples a side.
        self._samples = max(1, round(pixels_per_radian(camera) / pinhole.fx))
        count = self._size * self._samples
        bearings = _bearings(pinhole, face, self._samples)
        self._resampling = Resampling(camera, bearings, (count, count))
        seen = np.where(self._resampling.seen, np.uint8(255), np.uint8(0))
        self.visible: NDArray[np.bool_] = self._reduced(seen) == 255

    def picture(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Face of a picture (H, W) or (H, W, C); black where the camera sees nothing."""
        reduced = self._reduced(self._resampling.picture(image, cv2.INTER_CUBIC))
        reduced[~self.visible] = 0
        return reduced

    def mask(self, mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Pixels of the face that the camera sees and the picture's mask (H, W) lets through."""
        if mask is None:
            return self.visible
        white = np.where(mask, np.uint8(255), np.uint8(0))
        return self.visible & (self._reduced(self._resampling.picture(white)) > 127)

    def _reduced(self, sampled: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Mean of the samples of each pixel."""
        if self._samples == 1:
            return sampled
        size = (self._size, self._size)
        reduced = cv2.resize(sampled, size, interpolation=cv2.INTER_AREA)
        return np.asarray(reduced, dtype=np.uint8)


def _bearings(pinhole: Pinhole, face: FaceName, num_samples: int) -> Iterator[NDArray[np.float64]]:
    """Directions of the samples of a face, so many a side of each pixel, some rows at a time."""
    count = pinhole.width * num_samples
    axis = (np.arange(count) + 0.5) / num_samples
    face_from_cam_rotation = face_from_cam(face).rotation
    rows_at_once = max(1, _SAMPLES_AT_ONCE // count)
    for top in range(0, count, rows_at_once):
        u, v = np.meshgrid(axis, axis[top : top + rows_at_once])
        pixels = np.column_stack([u.ravel(), v.ravel()])
        yield pinhole.bearings_from_pixels(pixels) @ face_from_cam_rotation
