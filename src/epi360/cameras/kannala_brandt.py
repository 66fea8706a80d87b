# SPDX-License-Identifier: BSD-3-Clause
"""The fisheye model of Kannala and Brandt with four coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Camera, check_positive

ANGLE_TOLERANCE_RAD = 1e-12  # convergence, and rounding at the border of the field of view
MAX_ITERATIONS = 100  # bisection alone needs 45


@dataclass(frozen=True)
class KannalaBrandt(Camera):
    """Fisheye whose image radius is a polynomial of the angle from the optical axis.

    A direction at the angle a from +z is seen at the distance
    ``r(a) = a (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8)`` from the principal point, in units of the
    focal length. These are OpenCV's ``fisheye``, Kalibr's ``pinhole-equidistant`` and
    COLMAP's ``OPENCV_FISHEYE``. Fields of view over 180 degrees are fine: nothing divides by z.

    The model holds up to its largest angle: ``max_angle_deg`` where given, else 180 degrees, and
    never beyond the first extremum of r, where two angles would share a pixel. Pixels and
    directions beyond it are NaN. Pixels outside the image but within that angle have a ray;
    ``pixels_from_bearings`` is NaN where it would leave the image.

    Parameters
    ----------
    width, height : int
        Size of the image in pixels.
    fx, fy : float
        Focal lengths in pixels (per radian on the axis).
    cx, cy : float
        Principal point in continuous pixels: OpenCV's values plus 0.5, COLMAP's as they are.
    k1, k2, k3, k4 : float
        Coefficients of the polynomial.
    max_angle_deg : float, optional
        Largest angle from the axis that the lens images, at most 180; half the field of view.

    Raises
    ------
    ValueError
        If a size or focal length is not positive or ``max_angle_deg`` not in (0, 180].

    Notes
    -----
    Kannala & Brandt, "A generic camera model and calibration method for conventional, wide-angle,
    and fish-eye lenses", PAMI 2006, eq. 6.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    max_angle_deg: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        check_positive(self, "fx", "fy")
        if self.max_angle_deg is not None and not 0 < self.max_angle_deg <= 180:
            raise ValueError(f"max_angle_deg must be in (0, 180], got {self.max_angle_deg}")

    def field_of_view_mask(self) -> NDArray[np.bool_]:
        """Whether the centre of each pixel has a ray, shape (height, width)."""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        mask: NDArray[np.bool_] = np.hypot(x[None, :], y[:, None]) <= self._max_radius
        return mask

    @cached_property
    def _max_angle(self) -> float:
        """Largest angle in radians for which the model holds."""
        limit = np.pi if self.max_angle_deg is None else np.deg2rad(self.max_angle_deg)
        squares = np.roots([9 * self.k4, 7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        extrema = np.sqrt(squares.real[(np.abs(squares.imag) < 1e-12) & (squares.real > 0)])
        return float(min([limit, *extrema]))

    @cached_property
    def _max_radius(self) -> float:
        return float(self._radii(np.array(self._max_angle)))

    def _stretch(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """r(a) / a, which is 1 on the axis."""
        a2 = angles * angles
        return 1 + a2 * (self.k1 + a2 * (self.k2 + a2 * (self.k3 + a2 * self.k4)))

    def _radii(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """r(a), the distance from the principal point for unit focal length."""
        return angles * self._stretch(angles)

    def _slopes(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """dr/da."""
        a2 = angles * angles
        k1, k2, k3, k4 = 3 * self.k1, 5 * self.k2, 7 * self.k3, 9 * self.k4
        return 1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))

    def _angles(self, radii: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angles a with r(a) = radii, NaN beyond the largest: Newton kept in a bracket."""
        angles = np.where(radii <= self._max_radius, np.minimum(radii, self._max_angle), np.nan)
        active = np.flatnonzero(~np.isnan(angles))
        low = np.zeros(len(active))
        high = np.full(len(active), self._max_angle)
        for _ in range(MAX_ITERATIONS):
            before = angles[active]
            errors = self._radii(before) - radii[active]
            np.copyto(high, before, where=errors > 0)
            np.copyto(low, before, where=errors <= 0)
            with np.errstate(divide="ignore", invalid="ignore"):
                after = before - errors / self._slopes(before)
            after = np.where((after >= low) & (after <= high), after, 0.5 * (low + high))
            angles[active] = after
            moving = np.abs(after - before) > 1e-2 * ANGLE_TOLERANCE_RAD
            if not moving.any():
                break
            active, low, high = active[moving], low[moving], high[moving]
        return angles

    def _polar(
        self, u: NDArray[np.float64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Angles and unit image directions x, y, which are zero at the principal point."""
        x = (u - self.cx) / self.fx
        y = (v - self.cy) / self.fy
        radii = np.hypot(x, y)
        angles = self._angles(radii)
        radii[radii == 0] = 1.0  # x = y = 0 there
        x /= radii
        y /= radii
        return angles, x, y

    def _bearings(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        angles, x, y = self._polar(u, v)
        sines = np.sin(angles)
        bearings = np.empty((len(u), 3))
        np.multiply(sines, x, out=bearings[:, 0])
        np.multiply(sines, y, out=bearings[:, 1])
        np.cos(angles, out=bearings[:, 2])
        return bearings

    def _pixels(
        self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        axis_distances = np.hypot(x, y)
        angles = np.arctan2(axis_distances, z)
        angles[angles > self._max_angle + ANGLE_TOLERANCE_RAD] = np.nan
        radii = self._radii(np.minimum(angles, self._max_angle))
        on_axis = axis_distances == 0  # straight back is a whole circle of pixels: take its right
        axis_distances[on_axis] = 1.0
        x[on_axis] = 1.0
        radii /= axis_distances
        pixels = np.empty((len(x), 2))
        pixels[:, 0] = self.fx * (x * radii) + self.cx
        pixels[:, 1] = self.fy * (y * radii) + self.cy
        return self._keep_inside(pixels)

    def _jacobians(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
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
