# SPDX-License-Identifier: BSD-3-Clause
"""The picture of any camera as a full panorama in its frame, and which part of that it shows.

So panoramas, parts of them, fisheye and perspective images can be compared direction by direction.
"""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.resizing import pixels_per_radian, resized_camera
from epi360.features.images import shrunk
from epi360.features.resampling import Resampling, pixel_centers
from epi360.features.sphere_cells import even_directions

Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

# Of the side of a picture, how large its corners are; and the brightest grey value that may be what
# a lens does not light: 24 of black and 8 of noise, such as JPEG and glare leave.
_CORNER, _BRIGHTEST_BLACK = 1 / 40, 40
_RIM = np.ones((3, 3), np.uint8)  # pixels at the edge of a lens or of a mask show both sides
_NUM_DIRECTIONS = 6000  # that the share of the sphere is counted by


class SpherePicture(NamedTuple):
    """Grey values (H, W) of a full panorama, and which of its pixels show something."""

    grey: Grey
    seen: Mask

    @classmethod
    def of(
        cls, grey: Grey, camera: Camera, mask: Mask | None, panorama: Equirectangular
    ) -> SpherePicture:
        """Look up the grey values that a camera has in the directions of a panorama's pixels.

        ``mask`` is of the picture's size, and says what may be used. What is black from a
        corner of the picture on shows nothing. The picture is made as coarse as the panorama first.
        """
        coarse = round(camera.width * pixels_per_radian(panorama) / pixels_per_radian(camera))
        grey, _ = shrunk(grey, max(1, coarse))
        height, width = grey.shape
        around = _around(resized_camera(camera, width), panorama)
        shown = lit_part(grey)
        if mask is not None:
            kept = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
            shown = shown & (kept > 0)
        seen = around.picture(shown.astype(np.uint8), cv2.INTER_NEAREST)
        inner = cv2.erode(seen, _RIM, borderValue=1)
        return cls(around.picture(grey), np.asarray(inner > 0))


def lit_part(grey: Grey) -> Mask:
    """What a lens lights: all that is not black, up to its noise, from a corner of the picture on.

    Grey values (H, W) and the pixels (H, W) that show something.
    """
    lit = np.ones(grey.shape, dtype=bool)
    height, width = (max(1, round(_CORNER * side)) for side in grey.shape)
    rows, columns = (slice(height), slice(-height, None)), (slice(width), slice(-width, None))
    for corner in itertools.product(rows, columns):
        black, brightest = np.percentile(grey[corner], (50, 95))
        limit = black + max(4.0, 2.0 * (brightest - black))
        if limit <= _BRIGHTEST_BLACK:
            _, parts = cv2.connectedComponents((grey <= limit).astype(np.uint8))
            dark = parts[corner]
            lit &= ~np.isin(parts, np.unique(dark[dark > 0]))
    return lit


@lru_cache(maxsize=8)  # of 4.5 MB: the images of a folder share few cameras
def _around(camera: Camera, panorama: Equirectangular) -> Resampling:
    """A camera's pictures as panoramas."""
    return Resampling(camera, [_directions(panorama)], (panorama.height, panorama.width))


@lru_cache(maxsize=1)
def _directions(panorama: Equirectangular) -> NDArray[np.float64]:
    """Where the pixels of a panorama look, (H W, 3)."""
    return panorama.bearings_from_pixels(pixel_centers(panorama.width, panorama.height))


def share_seen(camera: Camera) -> float:
    """Share of the sphere that a camera sees."""
    pixels = camera.pixels_from_bearings(even_directions(_NUM_DIRECTIONS))
    return float(np.mean(np.isfinite(pixels[:, 0])))
