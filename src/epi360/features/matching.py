# SPDX-License-Identifier: BSD-3-Clause
"""Descriptors of two images to matches: ratio test and mutual nearest neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.features.detection import Features

_BLOCK_BYTES = 8 * 2**20  # of similarities: stays in the cache, and memory stays bounded
# Products of equal unit descriptors differ from 1 by up to 5e-7, and from one another by where in
# the matrix they stand and how many threads multiply it: below this, nothing is nearer.
_ROUNDING = 2e-6


def match_features(
    features1: Features, features2: Features, *, ratio: float = 0.8, mutual: bool = True
) -> NDArray[np.int64]:
    """Matches between two sets of features.

    Parameters
    ----------
    features1, features2 : Features
        With unit descriptors.
    ratio : float
        A match is kept when its descriptor distance is below this share of the distance to the
        second nearest (Lowe 2004), in at least one of the two images: on wide baselines that is
        right more often than asking it of the first or of both (measured).
    mutual : bool
        Keep only pairs that are each other's nearest; otherwise the nearest of each key point of
        the first set, by the ratio test there.

    Returns
    -------
    matches : ndarray, shape (M, 2), int
        Row = (index in features1, index in features2), ascending in the first.

    Raises
    ------
    ValueError
        If ratio is not in (0, 1].
    """
    if not 0.0 < ratio <= 1.0:
        raise ValueError(f"ratio must be in (0, 1], got {ratio}")
    d1, d2 = features1.descriptors, features2.descriptors
    if len(d1) < 2 or len(d2) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    nearest, best, second = _two_nearest(d1, d2)
    distinctive = _passes(best, second, ratio)
    if not mutual:
        first = np.flatnonzero(distinctive)
        return np.stack([first, nearest[first]], axis=1)
    chosen, place = np.unique(nearest, return_inverse=True)
    back, best, second = _two_nearest(d2[chosen], d1)
    first = np.arange(len(d1))
    kept = (back[place] == first) & (distinctive | _passes(best, second, ratio)[place])
    return np.stack([first[kept], nearest[kept]], axis=1)


def _passes(
    best: NDArray[np.float32], second: NDArray[np.float32], ratio: float
) -> NDArray[np.bool_]:
    # |a - b|^2 = 2 - 2 a.b for unit descriptors
    return np.asarray(np.maximum(1.0 - best, _ROUNDING) < ratio**2 * (1.0 - second))


def _two_nearest(
    queries: NDArray[np.float32], targets: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Index of the most similar target, its similarity and that of the runner-up."""
    nearest = np.zeros(len(queries), dtype=np.int64)
    best = np.zeros(len(queries), dtype=np.float32)
    second = np.full(len(queries), -1.0, dtype=np.float32)
    rows = max(1, _BLOCK_BYTES // (4 * len(targets)))
    transposed = np.ascontiguousarray(targets.T)
    buffer = np.empty((rows, len(targets)), dtype=np.float32)
    for start in range(0, len(queries), rows):
        block = queries[start : start + rows]
        similarity = np.matmul(block, transposed, out=buffer[: len(block)])
        everyone = np.arange(len(block))
        stop = start + len(block)
        nearest[start:stop] = similarity.argmax(axis=1)
        best[start:stop] = similarity[everyone, nearest[start:stop]]
        similarity[everyone, nearest[start:stop]] = -1.0
        second[start:stop] = similarity.max(axis=1)
    return nearest, best, second
