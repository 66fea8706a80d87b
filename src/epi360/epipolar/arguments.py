# SPDX-License-Identifier: BSD-3-Clause
"""Checks of bearings at the public boundary: one place, one wording."""

import reprlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def bearings_array(bearings: ArrayLike, name: str) -> Array:
    """Return unit bearings as float64 (N, 3); rows with NaN, or masked, are NaN."""
    array = plain_array(bearings, name)
    check_rows_of_three(array, name)
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


def plain_array(values: ArrayLike, name: str) -> Array:
    """Return float64 values; NaN where a masked array hides one. ValueError for other things."""
    try:
        if np.iscomplexobj(values):
            raise TypeError
        if isinstance(values, np.ma.MaskedArray):
            return np.ma.filled(values.astype(np.float64), np.nan)
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be real numbers of shape (N, 3), got {reprlib.repr(values)}"
        ) from None


def check_rows_of_three(array: Array, name: str) -> None:
    """Raise ValueError if an array is not (N, 3); (N, 2) are pixels, and the message says so."""
    if array.ndim == 2 and array.shape[1] == 3:
        return
    are_pixels = array.ndim == 2 and array.shape[1] == 2
    remedy = "; turn pixels into bearings with camera.bearings_from_pixels" if are_pixels else ""
    raise ValueError(f"{name} must have shape (N, 3), got {array.shape}{remedy}")


def bearing_pair(bearings1: ArrayLike, bearings2: ArrayLike) -> tuple[Array, Array]:
    """Return the unit bearings of both views; row i of both is match i."""
    b1 = bearings_array(bearings1, "bearings1")
    b2 = bearings_array(bearings2, "bearings2")
    if len(b1) != len(b2):
        raise ValueError(
            f"bearings1 and bearings2 must have the same length, got {len(b1)} and {len(b2)}"
        )
    return b1, b2


def usable_matches(
    bearings1: ArrayLike, bearings2: ArrayLike, weights: ArrayLike | None
) -> tuple[Array, Array, Array | None]:
    """Return the eight or more matches without NaN and of positive weight, and their weights."""
    b1, b2 = bearing_pair(bearings1, bearings2)
    w = weights_array(weights, len(b1))
    usable = np.isfinite(b1).all(axis=1) & np.isfinite(b2).all(axis=1)
    if w is not None:
        usable &= w > 0.0
    if usable.sum() < 8:
        raise ValueError(f"the eight-point algorithm needs at least 8 matches, got {usable.sum()}")
    return b1[usable], b2[usable], None if w is None else w[usable]


def weights_array(weights: ArrayLike | None, num_matches: int) -> Array | None:
    """Return weights as float64 (N,), none of them negative; None stays None."""
    if weights is None:
        return None
    array = np.ascontiguousarray(weights, dtype=np.float64)
    if array.shape != (num_matches,):
        raise ValueError(f"weights must have shape ({num_matches},), got {array.shape}")
    if not np.isfinite(array).all() or (array < 0.0).any():
        raise ValueError("weights must be finite and not negative")
    return array


def unit_of_weights(weights: Array) -> float:
    """Return by what to divide weights so that they sum to (sum w)^2 / sum w^2 (Kish 1965)."""
    largest = float(weights.max())
    shares = weights / largest  # first, so that squares neither overflow nor vanish
    return largest * float(shares @ shares) / float(shares.sum())


def jacobians_array(jacobians: ArrayLike | None, num_matches: int, name: str) -> Array | None:
    """Return derivatives of each bearing by its pixel as float64 (N, 3, 2); None stays None."""
    if jacobians is None:
        return None
    array = np.ascontiguousarray(jacobians, dtype=np.float64)
    if array.shape != (num_matches, 3, 2):
        raise ValueError(f"{name} must have shape ({num_matches}, 3, 2), got {array.shape}")
    return array


def direction_array(vector: ArrayLike, name: str) -> Array:
    """Return a direction of any positive length as a unit vector, float64 (3,)."""
    array = np.ascontiguousarray(vector, dtype=np.float64)
    if array.shape != (3,):
        raise ValueError(f"{name} must have shape (3,), got {array.shape}")
    largest = float(np.abs(array).max())
    if not (np.isfinite(largest) and largest > 0.0):
        raise ValueError(f"{name} must be a finite direction, got {array.tolist()}")
    array = array / largest  # so that squares neither overflow nor vanish
    return np.asarray(array / np.linalg.norm(array))
