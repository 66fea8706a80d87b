# SPDX-License-Identifier: BSD-3-Clause
"""The extended (enhanced) unified camera of Khomutenko, Garcia and Martinet."""

from dataclasses import dataclass

import numpy as np

from epi360.cameras.base import Array, check_positive
from epi360.cameras.lifted import LiftedCamera, rim


@dataclass(frozen=True)
class ExtendedUnified(LiftedCamera):
    """Ellipsoid seen by a shifted pinhole: wide lenses and mirrors with two numbers.

    A direction goes to ``(x, y) / (alpha d + (1 - alpha) z)`` with
    ``d = sqrt(beta (x^2 + y^2) + z^2)``. These are Kalibr's and basalt's ``eucm`` and COLMAP's
    ``EUCM``. With alpha = 0 it is a pinhole; with beta = 1 it is the unified camera without
    distortion, with xi = alpha / (1 - alpha) and focal lengths times 1 / (1 - alpha).

    If alpha <= 0.5 every pixel has a ray; if alpha > 0.5 only those do that are within
    ``r^2 <= 1 / (beta (2 alpha - 1))`` of the principal point. Directions are seen down to
    z = -w d with w = alpha / (1 - alpha), or the inverse of that if alpha > 0.5. Pixels without a
    ray and directions that are not seen give NaN.

    Parameters
    ----------
    width, height, fx, fy, cx, cy
        As in `Pinhole`; on the axis one radian is fx pixels.
    alpha : float
        From 0 (pinhole) to 1 (orthographic).
    beta : float
        Shape of the ellipsoid; 1 is the sphere.

    Raises
    ------
    ValueError
        If a size, focal length or beta is not positive or alpha not in [0, 1].

    Notes
    -----
    Khomutenko, Garcia & Martinet, "An enhanced unified camera model", RA-L 2016; as written in
    Usenko, Demmel & Cremers, "The double sphere camera model", 3DV 2018, section II.C.
    """

    alpha: float
    beta: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_alpha(self.alpha)
        check_positive(self, "beta")

    @property
    def _largest_square(self) -> float:
        return largest_square(self.alpha, self.beta)

    @property
    def _lowest_z(self) -> float:
        # z = -w d on the unit sphere.
        w = half_space(self.alpha)
        return float(-w * np.sqrt(self.beta / (1 - w * w * (1 - self.beta))))

    def _heights(self, squares: Array) -> tuple[Array, Array]:
        return heights(squares, self.alpha, self.beta)

    def _depths(self, squares: Array, z: Array) -> Array:
        return self.alpha * np.sqrt(self.beta * squares + z * z) + (1 - self.alpha) * z


def check_alpha(alpha: float) -> None:
    """Raise ``ValueError`` unless alpha is in [0, 1]."""
    if not 0 <= alpha <= 1:
        raise ValueError(f"alpha must be in [0, 1], got {alpha}")


def half_space(alpha: float) -> float:
    """Return w of the directions z > -w d that an ellipsoid model sees."""
    return alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha


def largest_square(alpha: float, beta: float) -> float:
    """Return the largest x^2 + y^2 with a ray, at which the root in `heights` is zero."""
    return rim(1 / (beta * (2 * alpha - 1))) if alpha > 0.5 else np.inf


def heights(squares: Array, alpha: float, beta: float) -> tuple[Array, Array]:
    """Return z of the ray (x, y, z) at x^2 + y^2, and its derivative."""
    roots = np.sqrt(np.maximum(1 - (2 * alpha - 1) * beta * squares, 0))
    root_slopes = -(2 * alpha - 1) * beta / (2 * roots)
    if alpha > 0.75:  # the same in another form: for alpha = 1 the other divides by 0 at the rim
        return (alpha * roots - (1 - alpha)) / (2 * alpha - 1), -alpha * beta / (2 * roots)
    denominators = alpha * roots + (1 - alpha)
    z = (1 - beta * alpha**2 * squares) / denominators
    return z, -(beta * alpha**2 + z * alpha * root_slopes) / denominators
