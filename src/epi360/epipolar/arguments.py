# SPDX-License-Identifier: BSD-3-Clause
"""Checks of bearings at the public boundary: one place, one wording."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def bearings_array(bearings: ArrayLike, name: str) -> Array:
    """Return unit bearings as float64 (N, 3); rows with NaN stay NaN.

    Parameters
    ----------
    bearings : array_like, shape (N, 3)
        Directions of any positive length.
    name : str
        Name of the argument for the message.

    Raises
    ------
    ValueError
        If the shape is not (N, 3), or a row is infinite or has zero length.
    """
    array = np.asarray(bearings, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (N, 3), got {array.shape}")
    if np.isinf(array).any():
        row = int(np.flatnonzero(np.isinf(array).any(axis=1))[0])
        raise ValueError(f"{name} must be finite (NaN marks a missing row), row {row} is infinite")
    largest = np.abs(array).max(axis=1, initial=0.0)
    if (largest == 0.0).any():
        row = int(np.flatnonzero(largest == 0.0)[0])
        raise ValueError(
            f"{name} must have non-zero length (NaN marks a missing row), row {row} is zero"
        )
    array = array / largest[:, None]  # so that squares neither overflow nor vanish
    norms = np.sqrt(np.einsum("ij,ij->i", array, array))
    return np.ascontiguousarray(array / norms[:, None])


def bearing_pair(bearings1: ArrayLike, bearings2: ArrayLike) -> tuple[Array, Array]:
    """Return both views' unit bearings; row i of both is match i.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions of any positive length.

    Raises
    ------
    ValueError
        If one is no valid array of bearings or the lengths differ.
    """
    b1 = bearings_array(bearings1, "bearings1")
    b2 = bearings_array(bearings2, "bearings2")
    if len(b1) != len(b2):
        raise ValueError(
            f"bearings1 and bearings2 must have the same length, got {len(b1)} and {len(b2)}"
        )
    return b1, b2


def weights_array(weights: ArrayLike | None, num_matches: int) -> Array | None:
    """Return weights as float64 (N,), or None.

    Parameters
    ----------
    weights : array_like, shape (N,), or None
        Non-negative, finite.
    num_matches : int
        N.

    Raises
    ------
    ValueError
        If the shape is wrong or a weight is negative or not finite.
    """
    if weights is None:
        return None
    array = np.ascontiguousarray(weights, dtype=np.float64)
    if array.shape != (num_matches,):
        raise ValueError(f"weights must have shape ({num_matches},), got {array.shape}")
    if not np.isfinite(array).all() or (array < 0.0).any():
        raise ValueError("weights must be finite and not negative")
    return array


def jacobians_array(jacobians: ArrayLike | None, num_matches: int, name: str) -> Array | None:
    """Return unprojection Jacobians as float64 (N, 3, 2), or None.

    Parameters
    ----------
    jacobians : array_like, shape (N, 3, 2), or None
        Derivative of each bearing by its pixel, as ``camera.bearing_jacobians`` gives it.
    num_matches : int
        N.
    name : str
        Name of the argument for the message.

    Raises
    ------
    ValueError
        If the shape is wrong.
    """
    if jacobians is None:
        return None
    array = np.ascontiguousarray(jacobians, dtype=np.float64)
    if array.shape != (num_matches, 3, 2):
        raise ValueError(f"{name} must have shape ({num_matches}, 3, 2), got {array.shape}")
    return array


def direction_array(vector: ArrayLike, name: str) -> Array:
    """Return a unit vector as float64 (3,).

    Parameters
    ----------
    vector : array_like, shape (3,)
        A direction of any positive length.
    name : str
        Name of the argument for the message.

    Raises
    ------
    ValueError
        If the shape is wrong, or the vector is zero or not finite.
    """
    array = np.ascontiguousarray(vector, dtype=np.float64)
    if array.shape != (3,):
        raise ValueError(f"{name} must have shape (3,), got {array.shape}")
    largest = float(np.abs(array).max())
    if not (np.isfinite(largest) and largest > 0.0):
        raise ValueError(f"{name} must be a finite direction, got {array.tolist()}")
    array = array / largest  # so that squares neither overflow nor vanish
    return np.asarray(array / np.linalg.norm(array))
