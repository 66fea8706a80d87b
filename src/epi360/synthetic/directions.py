# SPDX-License-Identifier: BSD-3-Clause
"""Directions on the unit sphere: normalised, uniform over a cap, tangents."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def unit(vectors: Array) -> Array:
    """Rows of an array, each divided by its length; NaN rows where that is zero."""
    with np.errstate(invalid="ignore"):
        units: Array = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return units


def tangents(directions: Array) -> tuple[Array, Array]:
    """Two unit vectors that make an orthonormal frame with each direction."""
    # The cross product with the axis of the smallest coordinate is never near zero.
    axis = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    tangent1 = unit(np.cross(directions, axis))
    return tangent1, np.cross(directions, tangent1)


def cap_directions(rng: np.random.Generator, num: int, half_angle: float) -> Array:
    """Unit vectors uniform over the spherical cap of a half angle about +z."""
    z = 1.0 - rng.random(num) * (1.0 - np.cos(half_angle))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, num)
    radius = np.sqrt(np.maximum(0.0, 1.0 - z * z))
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
