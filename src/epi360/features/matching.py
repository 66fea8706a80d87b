# SPDX-License-Identifier: BSD-3-Clause
"""Descriptors of two images to matches: ratio test and mutual nearest neighbours."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360 import _core
from epi360.features.detection import Features

Similarities = NDArray[np.float32]
_BLOCK_BYTES = 8 * 2**20  # of similarities: stays in the cache, and memory stays bounded
# Descriptors are rounded to multiples of 2^-11: sums of their products are exact in float32, in any
# order, so that a match depends neither on the library that multiplies nor on its threads. They are
# whole numbers of 12 bits, too, which the core multiplies in a quarter of BLAS's time.
_STEPS = 2048.0
# Rounded descriptors are not quite of unit length: the product of two equal ones may exceed 1, yet
# nothing is nearer than equal.
_SMALLEST = 2e-6
_WORTH_A_THREAD = 10**6  # products: some milliseconds


def match_features(
    features1: Features, features2: Features, *, ratio: float = 0.8, mutual: bool = True
) -> NDArray[np.int64]:
    """Matches between two sets of features with unit descriptors.

    Parameters
    ----------
    features1, features2 : Features
        What `extract_features` returns.
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
        If ratio is not in (0, 1], or one of the features is something else.
    """
    if not 0.0 < ratio <= 1.0:
        raise ValueError(f"ratio must be in (0, 1], got {ratio}")
    for name, given in (("features1", features1), ("features2", features2)):
        if not isinstance(given, Features):
            raise ValueError(
                f"{name} must be Features, as extract_features gives them, got "
                f"{type(given).__name__}"
            )
    half = len(features1) // 2
    if half * len(features2) < _WORTH_A_THREAD:
        return look(features1, features2).matches(ratio, mutual=mutual)
    halves = (features1.first(half), features1.chosen(slice(half, None)))
    with ThreadPoolExecutor(2) as pool:
        looks = pool.map(lambda some: look(some, features2), halves)
    return _both(*looks).matches(ratio, mutual=mutual)


@dataclass(frozen=True, eq=False)
class Look:
    """What the products of two images' descriptors say.

    Of each query (N,): the nearest target, its similarity, and the runner-up's. Of each target
    (M,): the largest similarity to a query that another target is the nearest of.
    """

    nearest: NDArray[np.int64]
    best: Similarities
    second: Similarities
    others: Similarities

    def matches(self, ratio: float = 0.8, *, mutual: bool = True) -> NDArray[np.int64]:
        """Matches as `match_features` gives them."""
        if len(self.nearest) < 2 or len(self.others) < 2:
            return np.zeros((0, 2), dtype=np.int64)
        kept = _passes(self.best, self.second, ratio)
        if mutual:
            is_nearest, second_back = _back(self.nearest, self.best, self.others)
            kept = is_nearest & (kept | _passes(self.best, second_back, ratio))
        first = np.flatnonzero(kept)
        return np.stack([first, self.nearest[first]], axis=1)


def look(features1: Features, features2: Features, before: Look | None = None) -> Look:
    """Compare the descriptors of two images.

    ``before`` is a look at the first ones of both: its products are not made again.
    """
    d1, d2 = features1.descriptors, features2.descriptors
    if before is None:
        return _two_nearest(d1, d2)
    num1, num2 = len(before.nearest), len(before.others)
    wider = _wider(before, _two_nearest(d1[:num1], d2[num2:]))
    return _both(wider, _two_nearest(d1[num1:], d2))


def _both(look1: Look, look2: Look) -> Look:
    """Two looks of different queries at the same targets."""
    return Look(
        np.concatenate([look1.nearest, look2.nearest]),
        np.concatenate([look1.best, look2.best]),
        np.concatenate([look1.second, look2.second]),
        np.maximum(look1.others, look2.others),
    )


def _wider(look1: Look, look2: Look) -> Look:
    """Two looks of the same queries at different targets, those of the second behind the first."""
    num_first = len(look1.others)
    second_wins = look2.best > look1.best  # of equal ones the first counts, as in one look
    nearest = np.where(second_wins, look2.nearest + num_first, look1.nearest)
    losers = np.where(second_wins, look1.nearest, look2.nearest + num_first)
    lost = np.minimum(look1.best, look2.best)
    others = np.concatenate([look1.others, look2.others])
    if len(look2.others):
        np.maximum.at(others, losers, lost)
    second = np.maximum(np.maximum(look1.second, look2.second), lost)
    return Look(nearest, np.maximum(look1.best, look2.best), second, others)


def rounded_descriptors(descriptors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit descriptors as they are matched; half precision holds them exactly."""
    return np.asarray(np.round(descriptors * np.float32(_STEPS)) / np.float32(_STEPS))


def _passes(
    best: NDArray[np.float32], second: NDArray[np.float32], ratio: float
) -> NDArray[np.bool_]:
    # |a - b|^2 = 2 - 2 a.b for unit descriptors
    return np.asarray(np.maximum(1.0 - best, _SMALLEST) < ratio**2 * (1.0 - second))


def _two_nearest(queries: NDArray[np.float32], targets: NDArray[np.float32]) -> Look:
    found = _core.two_nearest(queries, targets)
    if found is None:
        return _two_nearest_by_blas(rounded_descriptors(queries), rounded_descriptors(targets))
    return Look(*found)


def _two_nearest_by_blas(queries: NDArray[np.float32], targets: NDArray[np.float32]) -> Look:
    """The same as the core, for processors and numbers that it does not take."""
    nearest = np.zeros(len(queries), dtype=np.int64)
    best = np.full(len(queries), -1.0, dtype=np.float32)
    second = np.full(len(queries), -1.0, dtype=np.float32)
    others = np.full(len(targets), -1.0, dtype=np.float32)
    rows = max(1, _BLOCK_BYTES // (4 * max(len(targets), 1)))
    transposed = np.ascontiguousarray(targets.T)
    buffer = np.empty((rows, len(targets)), dtype=np.float32)
    for start in range(0, len(queries) if len(targets) else 0, rows):
        block = queries[start : start + rows]
        similarity = np.matmul(block, transposed, out=buffer[: len(block)])
        everyone = np.arange(len(block))
        stop = start + len(block)
        nearest[start:stop] = similarity.argmax(axis=1)
        best[start:stop] = similarity[everyone, nearest[start:stop]]
        similarity[everyone, nearest[start:stop]] = -1.0
        second[start:stop] = similarity.max(axis=1)
        np.maximum(others, similarity.max(axis=0), out=others)
    return Look(nearest, best, second, others)


def _back(
    nearest: NDArray[np.int64], best: Similarities, others: Similarities
) -> tuple[NDArray[np.bool_], Similarities]:
    """Which queries are the nearest of their target, and the runner-up's similarity."""
    order = np.lexsort((-best, nearest))  # by target, the most similar first
    targets = nearest[order]
    leads = np.append(True, targets[1:] != targets[:-1])
    rivals = np.full(len(nearest), -1.0, dtype=np.float32)
    follows = np.flatnonzero(~leads[1:])
    rivals[follows] = best[order[follows + 1]]
    second = np.empty_like(best)
    second[order] = np.maximum(rivals, others[targets])
    is_nearest = np.empty(len(nearest), dtype=bool)
    is_nearest[order] = leads
    return is_nearest & (best >= second), second
