# SPDX-License-Identifier: BSD-3-Clause
"""Pictures and masks of cube faces, cut out of those of any camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, Pinhole
from epi360.cameras.resizing import pixels_per_radian
from epi360.jobs.cubes.cube_faces import FaceName, face_from_cam

_PADDING_PX = 4  # more than bicubic interpolation reads beyond a pixel
_MapPair = tuple[NDArray[np.float32], NDArray[np.float32]]


class FaceSampler:
    """Cuts one face out of the pictures of one camera.

    ``visible`` (size, size) has the pixels whose direction the camera sees.
    """

    def __init__(self, camera: Camera, pinhole: Pinhole, face: FaceName) -> None:
        self._wraps = isinstance(camera, Equirectangular) and camera.horizontal_fov_deg >= 360
        self._size = pinhole.width
        # If a face pixel covers several of the picture, it is the mean of so many samples a side.
        self._samples = max(1, round(pixels_per_radian(camera) / pinhole.fx))
        self._map = self._build_map(camera, pinhole, face)
        seen = np.where(np.isfinite(self._map[0]), np.uint8(255), np.uint8(0))
        for part in self._map:
            part[~np.isfinite(part)] = -2.0 * _PADDING_PX  # samples nothing
        self.visible: NDArray[np.bool_] = self._reduced(seen) == 255

    def picture(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Face of a picture (H, W) or (H, W, C); black where the camera sees nothing."""
        reduced = self._reduced(self._sampled(image, cv2.INTER_CUBIC))
        reduced[~self.visible] = 0
        return reduced

    def mask(self, mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
        """Pixels of the face that the camera sees and the picture's mask (H, W) lets through."""
        if mask is None:
            return self.visible
        white = np.where(mask, np.uint8(255), np.uint8(0))
        return self.visible & (self._reduced(self._sampled(white, cv2.INTER_LINEAR)) > 127)

    def _build_map(self, camera: Camera, pinhole: Pinhole, face: FaceName) -> _MapPair:
        """Where each sample lies in the padded picture, for cv2.remap; NaN where nowhere."""
        count = self._size * self._samples
        axis = (np.arange(count) + 0.5) / self._samples
        u, v = np.empty((count, count), np.float32), np.empty((count, count), np.float32)
        cam_from_face = face_from_cam(face).rotation.T
        rows_per_block = max(1, 2**19 // count)
        for top in range(0, count, rows_per_block):
            rows = axis[top : top + rows_per_block]
            pixels = np.stack(np.meshgrid(axis, rows), axis=-1).reshape(-1, 2)
            bearings = pinhole.bearings_from_pixels(pixels) @ cam_from_face.T
            # OpenCV counts from the centre of the first pixel: half a pixel less.
            found = camera.pixels_from_bearings(bearings) + (_PADDING_PX - 0.5)
            u[top : top + len(rows)] = found[:, 0].reshape(len(rows), count)
            v[top : top + len(rows)] = found[:, 1].reshape(len(rows), count)
        return u, v

    def _sampled(self, image: NDArray[np.uint8], interpolation: int) -> NDArray[np.uint8]:
        return np.asarray(cv2.remap(self._padded(image), *self._map, interpolation), dtype=np.uint8)

    def _padded(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Picture continued beyond its borders, across the seam of a panorama."""
        pad = _PADDING_PX
        tall = cv2.copyMakeBorder(image, pad, pad, 0, 0, cv2.BORDER_REPLICATE)
        border = cv2.BORDER_WRAP if self._wraps else cv2.BORDER_REPLICATE
        return np.asarray(cv2.copyMakeBorder(tall, 0, 0, pad, pad, border), dtype=np.uint8)

    def _reduced(self, sampled: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Mean of the samples of each pixel."""
        if self._samples == 1:
            return sampled
        size = (self._size, self._size)
        reduced = cv2.resize(sampled, size, interpolation=cv2.INTER_AREA)
        return np.asarray(reduced, dtype=np.uint8)
