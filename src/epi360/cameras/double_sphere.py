# SPDX-License-Identifier: BSD-3-Clause
"""The double sphere camera of Usenko, Demmel and Cremers."""

from dataclasses import dataclass

import numpy as np

from epi360.cameras.base import Array
from epi360.cameras.extended_unified import check_alpha, half_space, heights, largest_square
from epi360.cameras.lifted import LiftedCamera


@dataclass(frozen=True)
class DoubleSphere(LiftedCamera):
    """Two unit spheres xi apart, the second seen by a shifted pinhole.

    A unit direction is moved to ``q = (x, y, z + xi)``, and goes to
    ``(q_x, q_y) / (alpha |q| + (1 - alpha) q_z)``. These are Kalibr's and basalt's ``ds``. With
    xi = 0 it is `ExtendedUnified` with beta = 1; with alpha = 0 it is `UnifiedCamera` without
    distortion.

    If alpha <= 0.5 every pixel has a ray; if alpha > 0.5 only those do that are within
    r^2 <= 1 / (2 alpha - 1) of the principal point. Exactly the directions of these rays are seen.

    Parameters
    ----------
    width, height, fx, fy, cx, cy
        As in `Pinhole`, but near the axis one radian is fx / (1 + xi) pixels.
    xi : float
        Distance of the spheres, between -1 and 1; mostly a small negative number.
    alpha : float
        From 0 to 1; a little over 0.5 in lenses of 180 degrees and more.

    Raises
    ------
    ValueError
        If a size or focal length is not positive, xi not in (-1, 1) or alpha not in [0, 1].

    Notes
    -----
    Usenko, Demmel & Cremers, "The double sphere camera model", 3DV 2018, eq. 40-51. The paper
    limits directions by z > -w2 with w2 = (w1 + xi) / sqrt(2 w1 xi + xi^2 + 1). Unless xi = 0 or
    alpha = 0.5, that leaves out directions that have a pixel, or takes in directions that have
    none. Here the limit is q_z = -w1 |q|, z = -xi (1 - w1^2) - w1 sqrt(1 - xi^2 (1 - w1^2)).
    """

    xi: float
    alpha: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_alpha(self.alpha)
        if not -1 < self.xi < 1:
            raise ValueError(f"xi must be between -1 and 1, got {self.xi}")

    @property
    def _largest_square(self) -> float:
        return largest_square(self.alpha, 1.0)

    @property
    def _lowest_z(self) -> float:
        w = half_space(self.alpha)
        rest = 1 - w * w
        return float(-self.xi * rest - w * np.sqrt(1 - self.xi**2 * rest))

    def _heights(self, squares: Array) -> tuple[Array, Array]:
        # Back from the second sphere to the first, where the line along q meets the first one.
        z, z_slopes = heights(squares, self.alpha, 1.0)
        xi, squeeze = self.xi, (1 - self.xi) * (1 + self.xi)
        roots = np.sqrt(z * z + squeeze * squares)
        root_slopes = (z * z_slopes + squeeze / 2) / roots
        # The same written twice: a difference of nearly equal numbers has few digits.
        sums, sum_slopes = z + xi * roots, z_slopes + xi * root_slopes
        quotients = (z * z - xi * xi * squares) / sums
        quotient_slopes = (2 * z * z_slopes - xi * xi - quotients * sum_slopes) / sums
        is_sum = xi * z > 0
        return (
            np.where(is_sum, quotients, (z - xi * roots) / squeeze),
            np.where(is_sum, quotient_slopes, (z_slopes - xi * root_slopes) / squeeze),
        )

    def _depths(self, squares: Array, z: Array) -> Array:
        q_z = z + self.xi
        return self.alpha * np.sqrt(squares + q_z * q_z) + (1 - self.alpha) * q_z
