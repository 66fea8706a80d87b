# SPDX-License-Identifier: BSD-3-Clause
"""Radial and tangential lens distortion with its inverse: OpenCV's k1, k2, p1, p2."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Pixels are inverted in blocks that fit the cache: a million take 0.21 s instead of 0.28 s.
BLOCK = 8192
MAX_ITERATIONS = 100  # an ordinary lens needs four, strong pincushion distortion many more
STEP_TOLERANCE = 1e-8  # of Newton's last step, relative to 1 + radius; the rest is its square
RESIDUAL_TOLERANCE = 1e-13  # of a point that counts as inverted, relative to 1 + radius
SMALLEST_DAMPING = 1e-4  # without progress at a step this short the disc has no solution
NEGLIGIBLE = 1e-30  # a coefficient that folds the distortion only at 10^7 focal lengths
BORDER_TOLERANCE = 1e-9  # the bounds of the distorted disc are rounded


@dataclass(frozen=True)
class RadialTangential:
    """OpenCV's distortion of the image plane, used on the disc on which it cannot fold."""

    k1: float
    k2: float
    p1: float
    p2: float

    @property
    def is_none(self) -> bool:
        """Whether nothing is distorted."""
        return self.k1 == self.k2 == self.p1 == self.p2 == 0

    @cached_property
    def max_radius(self) -> float:
        """Radius of the disc on which the distortion is one-to-one; infinite if it never folds."""
        # The Jacobian is symmetric. Its radial part has the eigenvalues dr_d/dr = 1 + 3 k1 r^2 +
        # 5 k2 r^4 and r_d / r = 1 + k1 r^2 + k2 r^4; the tangential part adds at least
        # -6 r |(p1, p2)|. Where the sum is positive on a disc, the distortion is the gradient of a
        # strictly convex function there, and so one-to-one.
        decenter = 6 * float(np.hypot(self.p1, self.p2))
        radii = [np.inf]
        for slope, curvature in ((3 * self.k1, 5 * self.k2), (self.k1, self.k2)):
            polynomial = np.array([curvature, 0.0, slope, -decenter, 1.0])
            polynomial[np.abs(polynomial) < NEGLIGIBLE] = 0  # `np.roots` divides by the first
            roots = np.roots(polynomial)
            is_real = np.abs(roots.imag) <= 1e-9 * np.abs(roots)
            radii.extend(roots.real[is_real & (roots.real > 0)])
        return float(min(radii))

    def radius_bounds(self, radius: float) -> tuple[float, float]:
        """Radii of a circle inside the distorted disc, and of one around it."""
        if not np.isfinite(radius):
            return np.inf, np.inf
        square = radius * radius
        distorted = radius * (1 + square * (self.k1 + square * self.k2))
        decenter = 3 * square * float(np.hypot(self.p1, self.p2))
        inner = max(0.0, (distorted - decenter) * (1 - BORDER_TOLERANCE))
        return inner, (distorted + decenter) * (1 + BORDER_TOLERANCE)

    def distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Distorted points."""
        squares = x * x + y * y
        decenter = 2 * (self.p2 * x + self.p1 * y)
        stretch = 1 + squares * (self.k1 + squares * self.k2) + decenter
        return x * stretch + self.p2 * squares, y * stretch + self.p1 * squares

    def derivatives(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Entries dx_d/dx, dx_d/dy = dy_d/dx and dy_d/dy of the Jacobian."""
        squares = x * x + y * y
        slopes = 2 * (self.k1 + 2 * self.k2 * squares)
        stretch = 1 + squares * (self.k1 + squares * self.k2) + 2 * (self.p2 * x + self.p1 * y)
        return (
            stretch + x * (slopes * x + 4 * self.p2),
            slopes * x * y + 2 * (self.p1 * x + self.p2 * y),
            stretch + y * (slopes * y + 4 * self.p1),
        )

    def undistort(self, x_d: Array, y_d: Array) -> tuple[Array, Array]:
        """Points of the disc that are distorted to these, NaN if there is none."""
        if self.is_none:
            return x_d, y_d
        x, y = np.empty_like(x_d), np.empty_like(y_d)
        for start in range(0, len(x_d), BLOCK):
            block = slice(start, start + BLOCK)
            x[block], y[block] = self._solve(x_d[block], y_d[block])
        return x, y

    def _solve(self, x_d: Array, y_d: Array) -> tuple[Array, Array]:
        """Damped Newton in the disc, on which the problem is strictly convex."""
        with np.errstate(all="ignore"):
            squares = x_d * x_d + y_d * y_d
            squares[squares > self.radius_bounds(self.max_radius)[1] ** 2] = np.nan
            state = self._start(x_d, y_d, squares)
            damping = np.ones_like(x_d)
            tolerances = RESIDUAL_TOLERANCE**2 * (1 + squares)
            for _ in range(MAX_ITERATIONS):
                x, y, error_x, error_y, errors = state
                xx, xy, yy = self.derivatives(x, y)
                factor = damping / (xx * yy - xy * xy)
                step_x = factor * (yy * error_x - xy * error_y)
                step_y = factor * (xx * error_y - xy * error_x)
                trial = self._state(x + step_x, y + step_y, x_d, y_d)
                better = trial[4] < errors
                for kept, new in zip(state, trial, strict=True):
                    np.copyto(kept, new, where=better)
                long = step_x**2 + step_y**2 > STEP_TOLERANCE**2 * (1 + squares)
                moving = (long | (errors > tolerances)) & (damping > SMALLEST_DAMPING)
                if not moving.any():
                    break
                damping = np.where(better, np.minimum(1, 2 * damping), 0.25 * damping)
            x, y, _, _, errors = state
            x[~(errors <= tolerances)] = np.nan
        y[np.isnan(x)] = np.nan
        return x, y

    def _start(self, x_d: Array, y_d: Array, squares: Array) -> tuple[Array, ...]:
        """State at first points inside the disc, near the solution if the distortion is small."""
        scales = 1 / np.maximum(1 + squares * (self.k1 + squares * self.k2), 0.5)
        scales = np.minimum(scales, 0.9 * self.max_radius / np.sqrt(squares))
        scales[squares == 0] = 1.0
        return self._state(scales * x_d, scales * y_d, x_d, y_d)

    def _state(self, x: Array, y: Array, x_d: Array, y_d: Array) -> tuple[Array, ...]:
        """Points moved into the disc, the errors when they are distorted, and their squares."""
        if np.isfinite(self.max_radius):
            pull = np.minimum(1, self.max_radius / np.sqrt(x * x + y * y))
            pull[np.isnan(pull)] = 1.0
            x, y = x * pull, y * pull
        distorted_x, distorted_y = self.distort(x, y)
        error_x, error_y = x_d - distorted_x, y_d - distorted_y
        return x, y, error_x, error_y, error_x * error_x + error_y * error_y
