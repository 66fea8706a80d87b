# SPDX-License-Identifier: BSD-3-Clause
"""What the pictures of a camera show along bearings, across the seam of a panorama as well."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_PADDING_PX = 4  # more than bicubic interpolation reads beyond a pixel
_NOWHERE = -2.0 * _PADDING_PX  # a pixel that reads nothing


class Resampling:
    """Where the pixels of a new picture look in the pictures of a camera.

    Parameters
    ----------
    camera : Camera
    bearings : iterable of ndarray, shape (N, 3)
        Directions of the new picture's pixels, row by row, in as many parts as memory asks for.
    shape : tuple of int
        Height and width of the new picture.

    Attributes
    ----------
    seen : ndarray of bool, shape (height, width)
        Pixels whose direction the camera sees.
    """

    def __init__(self, camera: Camera, bearings: Iterable[Array], shape: tuple[int, int]) -> None:
        self._wraps = camera.wraps
        self._u, self._v = np.empty((2, *shape), np.float32)
        count = 0
        for part in bearings:
            # OpenCV counts from the centre of the first pixel: half a pixel less.
            pixels = camera.pixels_from_bearings(part) + (_PADDING_PX - 0.5)
            rows = slice(count, count + len(part))
            self._u.reshape(-1)[rows], self._v.reshape(-1)[rows] = pixels.T
            count = rows.stop
        self.seen: NDArray[np.bool_] = np.isfinite(self._u)
        self._u[~self.seen] = self._v[~self.seen] = _NOWHERE

    def picture(self, image: Picture, interpolation: int = cv2.INTER_LINEAR) -> Picture:
        """The new picture (H, W) or (H, W, C) of the camera's; 0 where it sees nothing."""
        pad = _PADDING_PX
        tall = cv2.copyMakeBorder(image, pad, pad, 0, 0, cv2.BORDER_REPLICATE)
        border = cv2.BORDER_WRAP if self._wraps else cv2.BORDER_REPLICATE
        padded = cv2.copyMakeBorder(tall, 0, 0, pad, pad, border)
        return np.asarray(cv2.remap(padded, self._u, self._v, interpolation), np.uint8)


def pixel_centers(width: int, height: int) -> Array:
    """Middles (H W, 2) of all pixels, row by row."""
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.column_stack([u.ravel(), v.ravel()])
