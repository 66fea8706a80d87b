# SPDX-License-Identifier: BSD-3-Clause
"""The unified camera of Mei and Rives: a sphere, a shifted pinhole and lens distortion."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Array
from epi360.cameras.lifted import LiftedCamera, rim
from epi360.cameras.radial_tangential import RadialTangential


@dataclass(frozen=True)
class UnifiedCamera(LiftedCamera):
    """Unit sphere seen by a pinhole xi behind its centre, with radial and tangential distortion.

    A unit direction goes to ``(x, y) / (z + xi)``, is distorted by
    ``x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2)`` (y likewise), then scaled by fx, fy.
    These are OpenCV's ``omnidir``, Kalibr's ``omni-radtan`` and, with xi = 0, the ordinary
    pinhole with distortion: OpenCV's first four coefficients, Kalibr's ``pinhole-radtan``,
    COLMAP's ``SIMPLE_RADIAL``, ``RADIAL`` and ``OPENCV``.

    If xi <= 1, directions down to z = -xi are seen, and every pixel has a ray if there is no
    distortion. If xi > 1, directions down to z = -1 / xi are seen, in a circle of pixels. The field
    of view is over 180 degrees if xi > 0. Distortion is used up to the radius where its polynomial
    may fold, so that two directions would share a pixel. Pixels and directions beyond are NaN.

    Parameters
    ----------
    width, height, fx, fy, cx, cy
        As in `Pinhole`, but near the axis one radian is fx / (1 + xi) pixels.
    xi : float
        Distance of the pinhole from the centre of the sphere, above -1; 0 is a pinhole camera.
    k1, k2, p1, p2 : float
        Radial and tangential distortion.

    Raises
    ------
    ValueError
        If a size or focal length is not positive or xi not above -1.

    Notes
    -----
    Mei & Rives, "Single view point omnidirectional camera calibration from planar grids", ICRA
    2007, section II. The distortion is inverted by Newton's method to 1e-12.
    """

    xi: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.xi <= -1:
            raise ValueError(f"xi must be above -1, got {self.xi}")

    def field_of_view_mask(self) -> NDArray[np.bool_]:
        """Return whether the centre of each pixel has a ray, shape (height, width)."""
        inner, outer = self._distortion.radius_bounds(np.sqrt(self._largest_square))
        if np.isinf(inner):
            return np.ones((self.height, self.width), dtype=np.bool_)
        radii = np.hypot(*self._plane_grid())
        mask: NDArray[np.bool_] = radii <= inner
        rows, columns = np.nonzero((radii > inner) & (radii <= outer))
        bearings = self.bearings_from_pixels(np.column_stack([columns, rows]) + 0.5)
        mask[rows, columns] = ~np.isnan(bearings[:, 0])
        return mask

    @cached_property
    def _distortion(self) -> RadialTangential:
        return RadialTangential(self.k1, self.k2, self.p1, self.p2)

    @cached_property
    def _largest_square(self) -> float:
        fold = self._distortion.max_radius**2
        stretch = self.xi * self.xi - 1
        return rim(min(fold, 1 / stretch) if stretch > 0 else fold)

    @property
    def _lowest_z(self) -> float:
        return -self.xi if self.xi <= 1 else -1 / self.xi

    def _heights(self, squares: Array) -> tuple[Array, Array]:
        squeeze = 1 - self.xi * self.xi
        roots = np.sqrt(np.maximum(1 + squeeze * squares, 0))
        scales = 1 / (self.xi + roots)
        spans = (1 + squares) * scales
        slopes = scales * (1 - spans * squeeze / (2 * roots))
        return 1 - self.xi * spans, -self.xi * slopes

    def _depths(self, squares: Array, z: Array) -> Array:
        return z + self.xi

    def _plane_points(self, u: Array, v: Array) -> tuple[Array, Array]:
        return self._distortion.undistort(*super()._plane_points(u, v))

    def _jacobians(self, u: Array, v: Array) -> Array:
        # Chain rule, with the inverse of the distortion's symmetric 2 x 2 Jacobian.
        x, y = self._plane_points(u, v)
        by_x, by_y = np.moveaxis(self._ray_jacobians(x, y), 2, 0)
        jacobians = np.empty((len(x), 3, 2))
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # infinite at the fold
            xx, xy, yy = (entries[:, None] for entries in self._distortion.derivatives(x, y))
            determinants = xx * yy - xy * xy
            jacobians[:, :, 0] = (yy * by_x - xy * by_y) / determinants
            jacobians[:, :, 1] = (xx * by_y - xy * by_x) / determinants
        jacobians /= (self.fx, self.fy)
        return jacobians

    def _pixels_of_plane(self, x: Array, y: Array) -> Array:
        x[x * x + y * y > self._largest_square] = np.nan
        return super()._pixels_of_plane(*self._distortion.distort(x, y))
