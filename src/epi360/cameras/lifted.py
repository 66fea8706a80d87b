# SPDX-License-Identifier: BSD-3-Clause
"""What the models that project through spheres and ellipsoids have in common."""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Array, FocalCamera

RIM_TOLERANCE = 1e-12  # at the rim: of x^2 + y^2 in the plane, and of z of a unit direction


@dataclass(frozen=True)
class LiftedCamera(FocalCamera):
    """Camera in which the point (x, y) of the image plane looks along (x, y, h(x^2 + y^2))."""

    def field_of_view_mask(self) -> NDArray[np.bool_]:
        """Return whether the centre of each pixel has a ray, shape (height, width)."""
        x, y = self._plane_grid()
        return np.asarray(x * x + y * y <= self._largest_square)

    @property
    @abstractmethod
    def _largest_square(self) -> float:
        """Largest x^2 + y^2 that has a ray, infinite if all of the plane has rays."""

    @property
    @abstractmethod
    def _lowest_z(self) -> float:
        """Smallest z of the unit directions that are seen."""

    @abstractmethod
    def _heights(self, squares: Array) -> tuple[Array, Array]:
        """Heights h at x^2 + y^2 and their derivatives; NaN stays NaN."""

    @abstractmethod
    def _depths(self, squares: Array, z: Array) -> Array:
        """What x and y of unit directions are divided by to get to the plane."""

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
        # The unit ray changes by the part of (dx, dy, 2 h' (x dx + y dy)) perpendicular to it.
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
            else:  # at the end of the field of view the divisor is zero
                seen = z > self._lowest_z
            depths = np.where(seen, self._depths(x * x + y * y, z), np.nan)
            x /= depths
            y /= depths
            return self._keep_inside(self._pixels_of_plane(x, y))


def rim(square: float) -> float:
    """Return the largest x^2 + y^2 of a model whose rays end at ``square``, with the tolerance."""
    return square * (1 + RIM_TOLERANCE)
