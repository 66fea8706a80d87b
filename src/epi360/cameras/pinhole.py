# SPDX-License-Identifier: BSD-3-Clause
"""The pinhole camera without distortion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Camera, check_positive


@dataclass(frozen=True)
class Pinhole(Camera):
    """Perspective camera without distortion: u = fx x / z + cx, v = fy y / z + cy.

    Every finite pixel has a ray, also outside the image. ``pixels_from_bearings`` is NaN for
    directions behind the camera (z <= 0) and for those that meet the image plane outside the
    image.

    Parameters
    ----------
    width, height : int
        Size of the image in pixels.
    fx, fy : float
        Focal lengths in pixels.
    cx, cy : float
        Principal point in continuous pixels: OpenCV's values plus 0.5, COLMAP's as they are.

    Raises
    ------
    ValueError
        If a size or focal length is not positive.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        check_positive(self, "fx", "fy")

    def _bearings(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        bearings = np.empty((len(u), 3))
        bearings[:, 0] = (u - self.cx) / self.fx
        bearings[:, 1] = (v - self.cy) / self.fy
        bearings[:, 2] = 1.0
        bearings /= np.sqrt(np.einsum("ij,ij->i", bearings, bearings))[:, None]
        return bearings

    def _pixels(
        self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        z[z <= 0] = np.nan
        pixels = np.empty((len(x), 2))
        with np.errstate(over="ignore"):  # nearly sideways: far outside the image
            pixels[:, 0] = self.fx * (x / z) + self.cx
            pixels[:, 1] = self.fy * (y / z) + self.cy
        return self._keep_inside(pixels)

    def _jacobians(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        bearings = self._bearings(u, v)
        inverse_lengths = bearings[:, 2, None]  # z of the unit bearing: 1 / |(x/z, y/z, 1)|
        jacobians = np.empty((len(u), 3, 2))
        for k, focal_length in ((0, self.fx), (1, self.fy)):
            jacobians[:, :, k] = -bearings * bearings[:, k, None]
            jacobians[:, k, k] += 1.0
            jacobians[:, :, k] *= inverse_lengths / focal_length
        return jacobians
