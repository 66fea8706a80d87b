# SPDX-License-Identifier: BSD-3-Clause
"""What the models that project through spheres and ellipsoids share."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Camera, check_positive

Array = NDArray[np.float64]

RIM_TOLERANCE = 1e-12  # of the squared radius, and of z of a unit direction, at the rim


@dataclass(frozen=True)
class LiftedCamera(Camera):
    """Camera in which the point (x, y) of the image plane looks along (x, y, h(x^2 + y^2)).

    The pixel is (fx x + cx, fy y + cy). A model says its height h with the slope, how far from
    the centre there are rays, and the way back: x and y of a unit direction are divided by a
    depth, which is positive for directions that are seen.
    """

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        check_positive(self, "fx", "fy")

    def field_of_view_mask(self) -> NDArray[np.bool_]:
        """Whether the centre of each pixel has a ray, shape (height, width)."""
        x, y = self._plane_grid()
        mask: NDArray[np.bool_] = x * x + y * y <= self._largest_square
        return mask

    @property
    @abstractmethod
    def _largest_square(self) -> float:
        """x^2 + y^2 at the rim, infinite if all of the plane has rays."""

    @property
    @abstractmethod
    def _lowest_z(self) -> float:
        """Smallest z of the unit directions that are seen."""

    @abstractmethod
    def _heights(self, squares: Array) -> tuple[Array, Array]:
        """H and its derivative at x^2 + y^2, which is at most the largest; may be NaN."""

    @abstractmethod
    def _depths(self, squares: Array, z: Array) -> Array:
        """Divisors of x and y of unit directions, given x^2 + y^2 and z."""

    def _plane_points(self, u: Array, v: Array) -> tuple[Array, Array]:
        return (u - self.cx) / self.fx, (v - self.cy) / self.fy

    def _plane_grid(self) -> tuple[Array, Array]:
        """Points of the plane, without distortion, of all columns (1, W) and of all rows (H, 1)."""
        u, v = (np.arange(size, dtype=np.float64) + 0.5 for size in (self.width, self.height))
        return (u[None, :] - self.cx) / self.fx, (v[:, None] - self.cy) / self.fy

    def _rays(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Unit rays (N, 3), their lengths before that, and slopes of h at points of the plane."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            squares = x * x + y * y
            squares[squares > self._largest_square] = np.nan
            heights, slopes = self._heights(squares)
            lengths = np.sqrt(squares + heights * heights)
            rays = np.empty((len(x), 3))
            for column, values in enumerate((x, y, heights)):
                np.divide(values, lengths, out=rays[:, column])
        rays[np.isnan(lengths)] = np.nan
        return rays, lengths, slopes

    def _bearings(self, u: Array, v: Array) -> Array:
        return self._rays(*self._plane_points(u, v))[0]

    def _ray_jacobians(self, x: Array, y: Array) -> Array:
        """Derivatives (N, 3, 2) of the unit rays with respect to points of the plane."""
        # The ray (x, y, h) / |.| changes by what is across it of (dx, dy, 2 h' (x dx + y dy)).
        rays, lengths, slopes = self._rays(x, y)
        jacobians = np.empty((len(x), 3, 2))
        with np.errstate(over="ignore", invalid="ignore"):  # no derivative at the rim
            for k, coordinate in enumerate((x, y)):
                lift = 2 * slopes * coordinate
                along = rays[:, k] + rays[:, 2] * lift
                jacobians[:, :, k] = -rays * along[:, None]
                jacobians[:, k, k] += 1
                jacobians[:, 2, k] += lift
            jacobians /= lengths[:, None, None]
        return jacobians

    def _jacobians(self, u: Array, v: Array) -> Array:
        jacobians = self._ray_jacobians(*self._plane_points(u, v))
        jacobians /= (self.fx, self.fy)
        return jacobians

    def _pixels(self, x: Array, y: Array, z: Array) -> Array:
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            lengths = np.hypot(np.hypot(x, y), z)
            for column in (x, y, z):
                column /= lengths
            if np.isfinite(self._largest_square):
                seen = z >= self._lowest_z - RIM_TOLERANCE
            else:  # the depth is zero at the end of the field of view
                seen = z > self._lowest_z
            depths = np.where(seen, self._depths(x * x + y * y, z), np.nan)
            x /= depths
            y /= depths
            return self._keep_inside(self._pixels_of_plane(x, y))

    def _pixels_of_plane(self, x: Array, y: Array) -> Array:
        return np.column_stack([self.fx * x + self.cx, self.fy * y + self.cy])


def rim(square: float) -> float:
    """Largest x^2 + y^2 of a model whose rays end at ``square``, with the tolerance."""
    return square * (1 + RIM_TOLERANCE)
