# SPDX-License-Identifier: BSD-3-Clause
"""Brightness of image files: 16 bits to 8, and the lit circle of a fisheye lens.

The 16-bit pictures of TUM-VI are linear in light and mostly dark: divided by 257 they would keep
a few dozen grey values. One pair of levels per sequence, not per frame, keeps a surface's value
the same from frame to frame, which is what Lucas and Kanade's tracker assumes. Between the levels
the square root is taken: it makes the noise of counted photons equally large at all
brightnesses, so that dark corners show their texture and not their noise.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features import read_image
from epi360.features.image_files import MAX_PIXELS, decode_image_file

NUM_SAMPLED_FRAMES = 16  # spread over the sequence; 16 of 2800 frames of a room take 0.1 s
DARK_PERCENT, BRIGHT_PERCENT = 1.0, 99.5  # lamps and dead pixels must not set the range
# Share of the median brightness below which a pixel is rim: no lit part is as dark after the
# maximum over the frames.
RIM_SHARE = 0.1
RIM_MARGIN = 0.98  # share of the radius that is used: the last pixels are blurred and coloured


def eight_bit_image(path: Path, levels: tuple[float, float] | None) -> NDArray[np.uint8]:
    """8-bit RGB of an image file; 16-bit values become 0 and 255 at the two levels."""
    if levels is None:
        return read_image(path)
    raw = decode_image_file(path, MAX_PIXELS, "image")
    if raw.dtype != np.uint16:
        return read_image(path)
    black, white = levels
    ramp = np.clip((np.arange(2**16) - black) / (white - black), 0.0, 1.0)
    table = np.round(255 * np.sqrt(ramp)).astype(np.uint8)
    return np.ascontiguousarray(table[raw[:, :, 2::-1]])


def intensity_levels(paths: Sequence[Path]) -> tuple[float, float] | None:
    """Values of 16-bit images that should become black and white; None for 8-bit images."""
    samples = [_gray(path) for path in _sampled(paths)]
    if any(sample.dtype != np.uint16 for sample in samples):
        return None
    values = np.concatenate([sample[sample > 0] for sample in samples])
    if not len(values):
        raise ValueError(f"{paths[0].parent} must hold pictures, got black images only")
    black, white = np.percentile(values, (DARK_PERCENT, BRIGHT_PERCENT))
    return float(black), float(max(white, black + 1))


def lens_circle_mask(paths: Sequence[Path], camera: Camera) -> NDArray[np.bool_]:
    """Pixels inside the lit circle of a fisheye lens, where the camera also has a ray."""
    brightest = np.max([_gray(path, camera) for path in _sampled(paths)], axis=0)
    center = camera.pixels_from_bearings([[0.0, 0.0, 1.0]])[0]
    x = np.arange(camera.width) + 0.5 - center[0]
    y = np.arange(camera.height) + 0.5 - center[1]
    radii = np.hypot(x[None, :], y[:, None])
    rings = radii.astype(np.intp).ravel()
    lit = (brightest > RIM_SHARE * np.median(brightest[radii < 0.25 * camera.width])).ravel()
    # The circle ends where less than a quarter of the visible circumference is lit.
    share = np.bincount(rings, lit) / np.maximum(np.bincount(rings), 1)
    radius = float(np.flatnonzero(share >= 0.25).max(initial=0) + 1)
    if radius < rings.max():  # else nothing is dark: there is no rim to stay away from
        radius *= RIM_MARGIN
    return np.asarray(camera.field_of_view_mask() & (radii <= radius), dtype=np.bool_)


def mean_brightness(path: Path, mask: NDArray[np.bool_] | None = None) -> float:
    """Mean of the grey values of an image file, in its own unit, over the pixels of a mask."""
    gray = _gray(path)
    return float(gray.mean() if mask is None else gray[mask].mean())


def _sampled(paths: Sequence[Path]) -> list[Path]:
    count = min(len(paths), NUM_SAMPLED_FRAMES)
    return [paths[index] for index in np.linspace(0, len(paths) - 1, count).round().astype(int)]


def _gray(path: Path, camera: Camera | None = None) -> NDArray[Any]:
    """Grey values of a file, in the type of its pixels."""
    raw = decode_image_file(path, MAX_PIXELS, "image")
    if camera is not None and raw.shape[:2] != (camera.height, camera.width):
        raise ValueError(
            f"{path} must have the camera's size {camera.width}x{camera.height}, got "
            f"{raw.shape[1]}x{raw.shape[0]}; use the calibration of these images"
        )
    return np.asarray(cv2.cvtColor(raw[:, :, :3], cv2.COLOR_BGR2GRAY))
