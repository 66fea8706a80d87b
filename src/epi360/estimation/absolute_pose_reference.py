# SPDX-License-Identifier: BSD-3-Clause
"""The perspective-three-point problem in plain NumPy: the readable twin of the native core."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.poses import Pose

Array = NDArray[np.float64]

POLISHING_STEPS = 5


def p3p_reference(bearings: ArrayLike, points: ArrayLike) -> list[Pose]:
    """Return all ``cam_from_world`` that put three points on their bearings, at most four.

    Grunert's quartic in the ratio v of the third distance to the first (as in Haralick et al.,
    IJCV 1994), then Newton's method on the three cosine theorems.
    """
    b, X = np.asarray(bearings, dtype=np.float64), np.asarray(points, dtype=np.float64)
    cosines = np.array([b[1] @ b[2], b[0] @ b[2], b[0] @ b[1]])
    squares = np.array([np.sum((X[i] - X[j]) ** 2) for i, j in ((1, 2), (0, 2), (0, 1))])
    ca, cb, cg = cosines.tolist()
    p, q = (float(squares[k] / squares[1]) for k in (0, 2))
    # With u = s2 / s1 and v = s3 / s1, two of the three theorems are linear in u up to u^2:
    # u^2 = A(v) + B(v) u and u^2 = C(v) + 2 cg u. So u = (C - A) / (B - 2 cg).
    one, v = np.poly1d([1.0]), np.poly1d([1.0, 0.0])
    side = one + v * v - 2 * cb * v  # of the triangle's side 1-3, in units of s1 squared
    A, B, C = p * side - v * v, 2 * ca * v, q * side - one
    numerator, denominator = C - A, B - 2 * cg
    quartic = numerator**2 - C * denominator**2 - 2 * cg * numerator * denominator
    poses = []
    for root in quartic.roots:
        if abs(root.imag) > 1e-4 * abs(root) or root.real <= 0.0:
            continue
        ratio = root.real
        first = np.sqrt(squares[1] / side(ratio))
        distances = first * np.array([1.0, numerator(ratio) / denominator(ratio), ratio])
        distances = _polished(distances, cosines, squares)
        if (distances > 0.0).all():
            poses.append(_aligned(X, distances[:, None] * b))
    return poses


def _polished(distances: Array, cosines: Array, squares: Array) -> Array:
    d = distances
    for _ in range(POLISHING_STEPS):
        error, slopes = np.zeros(3), np.zeros((3, 3))
        for k, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
            error[k] = d[i] ** 2 + d[j] ** 2 - 2 * cosines[k] * d[i] * d[j] - squares[k]
            slopes[k, i] = 2 * (d[i] - cosines[k] * d[j])
            slopes[k, j] = 2 * (d[j] - cosines[k] * d[i])
        d = d - np.linalg.lstsq(slopes, error, rcond=None)[0]
    return d


def _aligned(points: Array, points_in_camera: Array) -> Pose:
    """Return the pose that takes one triangle to a congruent one."""
    frames = []
    for corners in (points, points_in_camera):
        side, other = corners[1] - corners[0], corners[2] - corners[0]
        normal = np.cross(side, other)
        first, third = side / np.linalg.norm(side), normal / np.linalg.norm(normal)
        frames.append(np.stack([first, np.cross(third, first), third], axis=1))
    rotation = frames[1] @ frames[0].T
    return Pose(rotation, points_in_camera[0] - rotation @ points[0])
