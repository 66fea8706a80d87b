# SPDX-License-Identifier: BSD-3-Clause
"""Relative pose from three matches where the direction of gravity is known in both cameras."""

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair, direction_array
from epi360.epipolar.residuals import tangent_basis
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]

_ON_THE_CIRCLE = 1e-6  # largest distance of a root from it; rounding moves double roots by 1e-8


def upright_three_point(
    bearings1: ArrayLike, bearings2: ArrayLike, gravity1: ArrayLike, gravity2: ArrayLike
) -> list[Pose]:
    """Return the poses cam2_from_cam1 that fit three matches and turn gravity into gravity.

    They are up to four poses with |t| = 1, where -t is as good as t; none if a bearing is NaN.
    Bearings, both (3, 3), and directions of gravity (3,) may have any length.

    Raises
    ------
    ValueError
        If there are not three matches, a bearing is infinite or zero, or a gravity is zero or not
        finite.

    Notes
    -----
    Fraundorfer, Tanskanen & Pollefeys, "A minimal case solution to the calibrated relative pose
    problem for the case of two known orientation angles", ECCV 2010. Both cameras are turned so
    that gravity is +y, which leaves one unknown of the rotation, the heading theta. Each match
    makes t perpendicular to the normal of its epipolar plane, (Ry(theta) b1 x b2) . t = 0. Three
    normals that are perpendicular to one t lie in one plane, so that their determinant is zero. The
    paper writes this as a quartic in tan(theta / 2); here it is a quartic in z = exp(i theta),
    whose roots of modulus one are the headings. It finds half turns too, where the tangent is
    infinite.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    if len(b1) != 3:
        raise ValueError(f"upright_three_point needs 3 matches, got {len(b1)}")
    upright1 = _upright_from(direction_array(gravity1, "gravity1"))
    upright2 = _upright_from(direction_array(gravity2, "gravity2"))
    if np.isnan(b1).any() or np.isnan(b2).any():
        return []
    constant, wave = _normals(b1 @ upright1.T, b2 @ upright2.T)
    poses = []
    for heading in _headings(constant, wave):
        t = _perpendicular_to(constant + 2.0 * (np.exp(1j * heading) * wave).real)
        if np.isfinite(t).all():
            turn = rotation_from_vector([0.0, heading, 0.0])
            poses.append(Pose(upright2.T @ turn @ upright1, upright2.T @ t))
    return poses


def _upright_from(gravity: Array) -> Array:
    """Return a rotation that takes a unit direction to +y."""
    x = tangent_basis(gravity)[:, 0]
    return np.stack([x, gravity, np.cross(x, gravity)])


def _normals(b1: Array, b2: Array) -> tuple[Array, NDArray[np.complex128]]:
    """Return n0 and n1 of the normals Ry(theta) b1 x b2 = n0 + z n1 + conj(z n1), row by row."""
    zero = np.zeros(3)
    constant = np.stack([zero, b1[:, 1], zero], axis=1)
    cosine = np.stack([b1[:, 0], zero, b1[:, 2]], axis=1)
    sine = np.stack([b1[:, 2], zero, -b1[:, 0]], axis=1)
    return np.cross(constant, b2), np.cross(0.5 * (cosine - 1j * sine), b2)


def _headings(constant: Array, wave: NDArray[np.complex128]) -> Array:
    # z (n0 + z n1 + conj(n1) / z), component by component
    a, b, c = (
        [Polynomial([n1.conjugate(), n0, n1]) for n0, n1 in zip(*row, strict=True)]
        for row in zip(constant, wave, strict=True)
    )
    determinant = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    # All n1 are perpendicular to (1, 0, i), so that no three of them are independent: the first and
    # the last of the seven coefficients are zero.
    coefficients = np.zeros(7, dtype=np.complex128)
    coefficients[: len(determinant.coef)] = determinant.coef
    roots = np.asarray(Polynomial(coefficients[1:6]).roots(), dtype=np.complex128)
    return np.angle(roots[np.abs(np.abs(roots) - 1.0) < _ON_THE_CIRCLE])


def _perpendicular_to(normals: Array) -> Array:
    products = np.cross(normals, np.roll(normals, -1, axis=0))
    lengths = np.linalg.norm(products, axis=1)
    longest = int(np.argmax(lengths))
    if not lengths[longest] > 0.0:
        return np.full(3, np.nan)
    return np.asarray(products[longest] / lengths[longest])
