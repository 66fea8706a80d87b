# SPDX-License-Identifier: BSD-3-Clause
"""The rotation between two frames, and how much motion it leaves unexplained."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.poses import angles_of_units, vector_from_rotation

Array = NDArray[np.float64]
_ROUNDS = 6  # with weights of Cauchy's loss, more rounds change the median by less than 1 %


def rotation_between(bearings1: Array, bearings2: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) that takes bearings 1 to 2 best, and the angles (N,) that it leaves.

    Points that move on their own have little weight (Cauchy's loss at the median).
    """
    weights = np.ones(len(bearings1))
    rotation, angles = np.eye(3), angles_of_units(bearings1, bearings2)
    for _ in range(_ROUNDS):
        u, _, vt = np.linalg.svd((bearings2 * weights[:, None]).T @ bearings1)
        rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
        angles = angles_of_units(bearings1 @ rotation.T, bearings2)
        scale = max(float(np.median(angles)), 1e-9)
        weights = 1.0 / (1.0 + np.square(angles / scale))
    return rotation, angles


def rotation_angle(rotation: Array) -> float:
    """Angle of a rotation in radians."""
    return float(np.linalg.norm(vector_from_rotation(rotation)))


def nearest_rotation(matrix: Array) -> Array:
    """Rotation nearest to a product of rotations, which rounding has bent a little."""
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)
