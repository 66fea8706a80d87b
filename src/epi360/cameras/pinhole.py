# SPDX-License-Identifier: BSD-3-Clause
"""The pinhole camera without distortion."""

from dataclasses import dataclass

import numpy as np

from epi360.cameras.base import Array, FocalCamera


@dataclass(frozen=True)
class Pinhole(FocalCamera):
    """Perspective camera without distortion: u = fx x / z + cx, v = fy y / z + cy.

    Every finite pixel has a ray, also outside the image. ``pixels_from_bearings`` gives NaN for
    directions behind the camera (z <= 0) and for those that meet the image plane outside the image.

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

    def _bearings(self, u: Array, v: Array) -> Array:
        bearings = np.empty((len(u), 3))
        bearings[:, 0], bearings[:, 1] = self._plane_points(u, v)
        bearings[:, 2] = 1.0
        with np.errstate(over="ignore"):
            lengths = np.sqrt(np.einsum("ij,ij->i", bearings, bearings))
        if np.isinf(lengths).any():  # so far outside that squares overflow
            bearings /= np.abs(bearings).max(axis=1, keepdims=True)
            lengths = np.sqrt(np.einsum("ij,ij->i", bearings, bearings))
        bearings /= lengths[:, None]
        return bearings

    def _pixels(self, x: Array, y: Array, z: Array) -> Array:
        z[z <= 0] = np.nan
        with np.errstate(over="ignore"):  # a direction nearly sideways is far outside the image
            pixels = self._pixels_of_plane(x / z, y / z)
        return self._keep_inside(pixels)

    def _jacobians(self, u: Array, v: Array) -> Array:
        bearings = self._bearings(u, v)
        inverse_lengths = bearings[:, 2, None]  # z of the unit bearing: 1 / |(x/z, y/z, 1)|
        jacobians = np.empty((len(u), 3, 2))
        for k, focal_length in ((0, self.fx), (1, self.fy)):
            jacobians[:, :, k] = -bearings * bearings[:, k, None]
            jacobians[:, k, k] += 1.0
            jacobians[:, :, k] *= inverse_lengths / focal_length
        return jacobians
