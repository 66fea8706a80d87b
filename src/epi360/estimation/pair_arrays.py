# SPDX-License-Identifier: BSD-3-Clause
"""Arguments of the robust estimator: the arrays of one pair or of many, checked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import direction_array, jacobians_array, weights_array

Array = NDArray[np.float64]


class PairArrays:
    """Arrays of all pairs as the native core takes them; what nobody gave stays empty.

    Attributes
    ----------
    bearings1, bearings2 : list of ndarray, shape (M, 3)
        One a pair.
    weights, scores : list of ndarray, shape (M,)
        One a pair, or none.
    jacobians1, jacobians2 : list of ndarray, shape (M, 3, 2)
        One a pair, or none.
    gravity1, gravity2 : list of ndarray, shape (3,)
        One a pair, or none.
    """

    def __init__(self) -> None:
        self.bearings1: list[Array] = []
        self.bearings2: list[Array] = []
        self.weights: list[Array] = []
        self.scores: list[Array] = []
        self.jacobians1: list[Array] = []
        self.jacobians2: list[Array] = []
        self.gravity1: list[Array] = []
        self.gravity2: list[Array] = []

    def append(
        self,
        bearings1: ArrayLike,
        bearings2: ArrayLike,
        weights: ArrayLike | None = None,
        scores: ArrayLike | None = None,
        jacobians1: ArrayLike | None = None,
        jacobians2: ArrayLike | None = None,
        gravity1: ArrayLike | None = None,
        gravity2: ArrayLike | None = None,
    ) -> None:
        """Add a pair.

        Parameters
        ----------
        bearings1, bearings2 : array_like, shape (M, 3)
            Row i of both is one match.
        weights, scores : array_like, shape (M,), optional
            Of the matches.
        jacobians1, jacobians2 : array_like, shape (M, 3, 2), optional
            Of the bearings by their pixels.
        gravity1, gravity2 : array_like, shape (3,), optional
            Down, in both cameras.

        Raises
        ------
        ValueError
            If a shape is wrong.
        """
        b1 = _rows(bearings1, "bearings1")
        b2 = _rows(bearings2, "bearings2")
        if len(b1) != len(b2):
            raise ValueError(
                f"bearings1 and bearings2 must have the same length, got {len(b1)} and {len(b2)}"
            )
        if (gravity1 is None) != (gravity2 is None):
            raise ValueError("gravity1 and gravity2 must be given together, got only one")
        self.bearings1.append(b1)
        self.bearings2.append(b2)
        for kept, given in (
            (self.weights, weights_array(weights, len(b1))),
            (self.scores, _scores(scores, len(b1))),
            (self.jacobians1, jacobians_array(jacobians1, len(b1), "jacobians1")),
            (self.jacobians2, jacobians_array(jacobians2, len(b1), "jacobians2")),
            (self.gravity1, None if gravity1 is None else direction_array(gravity1, "gravity1")),
            (self.gravity2, None if gravity2 is None else direction_array(gravity2, "gravity2")),
        ):
            if given is not None:
                kept.append(given)


def _rows(bearings: ArrayLike, name: str) -> Array:
    array = np.ascontiguousarray(bearings, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (N, 3), got {array.shape}")
    return array


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
