# SPDX-License-Identifier: BSD-3-Clause
"""Arguments of the robust estimator: the arrays of one pair or of many, checked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360 import _core
from epi360.epipolar.arguments import (
    check_rows_of_three,
    direction_array,
    jacobians_array,
    plain_array,
    weights_array,
)

Array = NDArray[np.float64]

_FEWEST_PIXELS, _LARGEST_SLOPE = 5, 30.0


def native_pair(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    scores: ArrayLike | None = None,
    jacobians: tuple[ArrayLike | None, ArrayLike | None] = (None, None),
    uses_jacobians: bool = False,
    gravity: tuple[ArrayLike | None, ArrayLike | None] = (None, None),
    gravity_sigma: float = 0.0,
    elevation_sigma: float = 0.0,
    seed: int = 0,
    min_noise: float = 0.0,
    max_noise: float = 0.0,
) -> _core.Pair:
    """Return the arrays of one pair as the core takes them, or name what is wrong."""
    b1 = _rows(bearings1, "bearings1")
    b2 = _rows(bearings2, "bearings2")
    if len(b1) != len(b2):
        raise ValueError(
            f"bearings1 and bearings2 must have the same length, got {len(b1)} and {len(b2)}"
        )
    gravity1, gravity2 = gravity
    if (gravity1 is None) != (gravity2 is None):
        raise ValueError("gravity1 and gravity2 must be given together, got only one")
    J1 = jacobians_array(jacobians[0], len(b1), "jacobians1")
    J2 = jacobians_array(jacobians[1], len(b1), "jacobians2")
    return _core.Pair(
        b1,
        b2,
        weights=weights_array(weights, len(b1)),
        scores=_scores(scores, len(b1)),
        jacobians1=J1 if uses_jacobians else None,
        jacobians2=J2 if uses_jacobians else None,
        gravity1=None if gravity1 is None else direction_array(gravity1, "gravity1"),
        gravity2=None if gravity2 is None else direction_array(gravity2, "gravity2"),
        gravity_sigma=gravity_sigma,
        elevation_sigma=elevation_sigma,
        seed=seed % 2**64,
        min_noise=min_noise,
        max_noise=max_noise,
    )


def _rows(bearings: ArrayLike, name: str) -> Array:
    array = np.ascontiguousarray(plain_array(bearings, name))
    if array.shape == (0,):  # an empty list
        array = array.reshape(0, 3)
    check_rows_of_three(array, name)
    if _look_like_pixels(array):
        raise ValueError(
            f"{name} must be directions of rays, got what looks like pixels (u, v, 1); turn pixels "
            "into bearings with camera.bearings_from_pixels"
        )
    return array


def _look_like_pixels(rows: Array) -> bool:
    """Whether rows are (u, v, 1) with numbers that no ray of a pinhole has: 88 degrees and more."""
    if len(rows) < _FEWEST_PIXELS or not (rows[:, 2] == 1.0).all():
        return False
    return float(np.median(np.abs(rows[:, :2]).max(axis=1))) > _LARGEST_SLOPE


def _scores(scores: ArrayLike | None, num_matches: int) -> Array | None:
    if scores is None:
        return None
    array = np.asarray(scores, dtype=np.float64, order="C")
    if array.shape != (num_matches,):
        raise ValueError(f"match_scores must have shape ({num_matches},), got {array.shape}")
    return array


def listed_pairs(pairs: object) -> list[tuple[ArrayLike, ArrayLike]]:
    """List of the pairs that an iterable gives.

    Parameters
    ----------
    pairs : iterable of (bearings1, bearings2)
        Not checked further here.

    Raises
    ------
    ValueError
        If it cannot be iterated over.
    """
    if not isinstance(pairs, Iterable):
        raise ValueError(f"pairs must be a sequence of (bearings1, bearings2), got {pairs!r}")
    return list(pairs)


def values_per_pair(
    values: Sequence[ArrayLike] | ArrayLike | None, num_pairs: int, name: str
) -> list[ArrayLike | None]:
    """List of one array for each pair, of None where there are no values.

    Parameters
    ----------
    values : sequence of array_like, optional
        Weights or scores.
    num_pairs : int
        How many there must be.
    name : str
        Of the argument, for messages.

    Raises
    ------
    ValueError
        If some pairs have none, or the number is wrong.
    """
    if values is None:
        return [None] * num_pairs
    listed: list[ArrayLike | None] = list(values)  # type: ignore[arg-type]
    if len(listed) != num_pairs:
        raise ValueError(
            f"{name} must have one array for each of {num_pairs} pairs, got {len(listed)}"
        )
    for k, array in enumerate(listed):
        if array is None:
            raise ValueError(f"{name} must have an array for every pair or none, pair {k} has none")
    return listed


def cut_pairs(
    bearings1: object,
    bearings2: ArrayLike | None,
    offsets: ArrayLike,
    scores: object,
    weights: object,
) -> tuple[list[tuple[ArrayLike, ArrayLike]], list[ArrayLike | None], list[ArrayLike | None]]:
    """Pairs, scores and weights out of concatenated arrays.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        Of all pairs, one after the other.
    offsets : array_like, shape (P + 1,), int
        Pair k has the rows offsets[k] to offsets[k + 1].
    scores, weights : array_like, shape (N,), optional
        Of all matches.

    Raises
    ------
    ValueError
        If a shape is wrong, or the offsets do not rise from 0 to N.
    """
    if bearings2 is None:
        raise ValueError("offsets need bearings1 and bearings2 as two arrays of shape (N, 3)")
    b1, b2 = _rows(bearings1, "bearings1"), _rows(bearings2, "bearings2")  # type: ignore[arg-type]
    cuts = np.asarray(offsets)
    if cuts.ndim != 1 or not len(cuts) or not np.issubdtype(cuts.dtype, np.integer):
        raise ValueError(
            f"offsets must be integers of shape (P + 1,), got {cuts.dtype} {cuts.shape}"
        )
    if cuts[0] != 0 or cuts[-1] != len(b1) or (np.diff(cuts) < 0).any() or len(b2) != len(b1):
        raise ValueError(
            "offsets must rise from 0 to the length of bearings1 and bearings2, got "
            f"{cuts[0]} to {cuts[-1]} for {len(b1)} and {len(b2)} rows"
        )
    all_scores = _scores(scores, len(b1))  # type: ignore[arg-type]
    all_weights = weights_array(weights, len(b1))  # type: ignore[arg-type]
    parts = [slice(int(a), int(b)) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    return (
        [(b1[part], b2[part]) for part in parts],
        [None if all_scores is None else all_scores[part] for part in parts],
        [None if all_weights is None else all_weights[part] for part in parts],
    )
