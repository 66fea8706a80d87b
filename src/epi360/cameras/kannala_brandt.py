# SPDX-License-Identifier: BSD-3-Clause
"""The fisheye model of Kannala and Brandt with four coefficients."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Array, FocalCamera

ANGLE_TOLERANCE_RAD = 1e-12  # for convergence, and for rounding at the edge of the field of view
MAX_ITERATIONS = 100  # bisection alone needs 45


@dataclass(frozen=True)
class KannalaBrandt(FocalCamera):
    """Fisheye whose image radius is a polynomial of the angle from the optical axis.

    A direction at the angle a from +z is seen at the distance
    ``r(a) = a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)`` from the principal point, in units of the
    focal length. These are OpenCV's ``fisheye``, Kalibr's ``pinhole-equidistant`` and
    COLMAP's ``OPENCV_FISHEYE``. Nothing divides by z, so that the field of view may be over 180
    degrees.

    The model is used up to a largest angle: ``max_angle_deg`` if it is given, else 180 degrees, and
    never beyond the first extremum of r, where two angles would share a pixel. Pixels and
    directions beyond that angle are NaN. Pixels within it have a ray also outside the image;
    ``pixels_from_bearings`` gives NaN for directions that meet no pixel of the image.

    Parameters
    ----------
    width, height, fx, fy, cx, cy
        As in `Pinhole`; on the axis one radian is fx pixels.
    k1, k2, k3, k4 : float
        Coefficients of the polynomial.
    max_angle_deg : float, optional
        Largest angle from the axis that the lens shows, at most 180: half the field of view.

    Raises
    ------
    ValueError
        If a size or focal length is not positive or ``max_angle_deg`` not in (0, 180].

    Notes
    -----
    Kannala & Brandt, "A generic camera model and calibration method for conventional, wide-angle,
    and fish-eye lenses", PAMI 2006, eq. 6.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    max_angle_deg: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_angle_deg is not None and not 0 < self.max_angle_deg <= 180:
            raise ValueError(f"max_angle_deg must be in (0, 180], got {self.max_angle_deg}")

    def field_of_view_mask(self) -> NDArray[np.bool_]:
        """Return whether the centre of each pixel has a ray, shape (height, width)."""
        return np.asarray(np.hypot(*self._plane_grid()) <= self._max_radius)

    @cached_property
    def _max_angle(self) -> float:
        limit = np.pi if self.max_angle_deg is None else np.deg2rad(self.max_angle_deg)
        squares = np.roots([9 * self.k4, 7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        extrema = np.sqrt(squares.real[(np.abs(squares.imag) < 1e-12) & (squares.real > 0)])
        return float(min([limit, *extrema]))

    @cached_property
    def _max_radius(self) -> float:
        return float(self._radii(np.array(self._max_angle)))

    def _stretch(self, angles: Array) -> Array:
        """r(a) / a, which is 1 on the axis."""
        a2 = angles * angles
        return 1 + a2 * (self.k1 + a2 * (self.k2 + a2 * (self.k3 + a2 * self.k4)))

    def _radii(self, angles: Array) -> Array:
        """r(a), the distance from the principal point for unit focal length."""
        return angles * self._stretch(angles)

    def _slopes(self, angles: Array) -> Array:
        a2 = angles * angles
        k1, k2, k3, k4 = 3 * self.k1, 5 * self.k2, 7 * self.k3, 9 * self.k4
        return 1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))

    def _angles(self, radii: Array) -> Array:
        """Angles a with r(a) = radii by Newton's method in a bracket, NaN beyond the largest."""
        angles = np.where(radii <= self._max_radius, np.minimum(radii, self._max_angle), np.nan)
        active = np.flatnonzero(~np.isnan(angles))
        low = np.zeros(len(active))
        high = np.full(len(active), self._max_angle)
        for _ in range(MAX_ITERATIONS):
            current = angles[active]
            errors = self._radii(current) - radii[active]
            np.copyto(high, current, where=errors > 0)
            np.copyto(low, current, where=errors <= 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                updated = current - errors / self._slopes(current)
            updated = np.where((updated >= low) & (updated <= high), updated, 0.5 * (low + high))
            angles[active] = updated
            moving = np.abs(updated - current) > 1e-2 * ANGLE_TOLERANCE_RAD
            if not moving.any():
                break
            active, low, high = active[moving], low[moving], high[moving]
        return angles

    def _polar(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Angles and unit image directions x, y, which are zero at the principal point."""
        x, y = self._plane_points(u, v)
        radii = np.hypot(x, y)
        angles = self._angles(radii)
        radii[radii == 0] = 1.0  # x = y = 0 there
        x /= radii
        y /= radii
        return angles, x, y

    def _bearings(self, u: Array, v: Array) -> Array:
        angles, x, y = self._polar(u, v)
        sines = np.sin(angles)
        bearings = np.empty((len(u), 3))
        np.multiply(sines, x, out=bearings[:, 0])
        np.multiply(sines, y, out=bearings[:, 1])
        np.cos(angles, out=bearings[:, 2])
        return bearings

    def _pixels(self, x: Array, y: Array, z: Array) -> Array:
        axis_distances = np.hypot(x, y)
        angles = np.arctan2(axis_distances, z)
        angles[angles > self._max_angle + ANGLE_TOLERANCE_RAD] = np.nan
        radii = self._radii(np.minimum(angles, self._max_angle))
        # A whole circle of pixels may look straight back; the one to the right is taken.
        on_axis = axis_distances == 0
        axis_distances[on_axis] = 1.0
        x[on_axis] = 1.0
        radii /= axis_distances
        return self._keep_inside(self._pixels_of_plane(x * radii, y * radii))

    def _jacobians(self, u: Array, v: Array) -> Array:
        # With e = (x, y) / r the bearing is (sin(a) e, cos(a)); de/d(x, y) = (I - e e^T) / r.
        angles, x, y = self._polar(u, v)
        ratios = np.sinc(angles / np.pi) / self._stretch(angles)  # sin(a) / r, 1 on the axis
        with np.errstate(divide="ignore", invalid="ignore"):  # no derivative at the extremum of r
            angle_slopes = 1 / self._slopes(angles)
            radial = np.cos(angles) * angle_slopes - ratios
            backward = -np.sin(angles) * angle_slopes
            jacobians = np.empty((len(u), 3, 2))
            jacobians[:, 0, 0] = ratios + radial * x * x
            jacobians[:, 1, 0] = jacobians[:, 0, 1] = radial * x * y
            jacobians[:, 1, 1] = ratios + radial * y * y
            jacobians[:, 2, 0] = backward * x
            jacobians[:, 2, 1] = backward * y
        jacobians /= (self.fx, self.fy)
        return jacobians
