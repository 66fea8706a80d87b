# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a set look alike, by the key points that they have anyway."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from epi360.features.visual_words import (
    NUM_DESCRIPTORS,
    NUM_WORDS,
    SAMPLES_PER_WORD,
    Signature,
    evenly_spread,
    learn_words,
    rarity,
    signature,
)
from epi360.jobs.threads import on_threads
from epi360.progress import Progress, no_progress

Pair = tuple[int, int]
Descriptors = NDArray[np.float32]
Found = TypeVar("Found")
_SAMPLED_FROM = 2 * NUM_DESCRIPTORS
_ROWS = 256  # of scores, each with all images: 20 MB of 10,000 images


def alike_pairs(
    descriptors_of: Callable[[int], Descriptors],
    num_images: int,
    count: int,
    *,
    without: Collection[Pair] = (),
    num_threads: int = 1,
    progress: Progress = no_progress,
) -> list[Pair]:
    """Pairs (a, b), a < b, of each image with the ``count`` that look most like it.

    ``descriptors_of`` gives those of an image, strongest first, or none; it is called twice for
    each, so that they need not be in memory together. Pairs in ``without`` are passed over: the
    next ones take their place. The result does not depend on the number of threads. ``progress`` is
    told of the stage "retrieval".
    """
    per_image = -(-NUM_WORDS * SAMPLES_PER_WORD // max(num_images, 1))

    def sampled(index: int) -> Descriptors:
        return evenly_spread(descriptors_of(index)[:_SAMPLED_FROM], per_image)

    def for_each(work: Callable[[int], Found], done: int) -> list[Found]:
        found: dict[int, Found] = {}
        for index, result in on_threads(work, range(num_images), num_threads):
            found[index] = result
            progress("retrieval", done + len(found), 2 * num_images)
        return [found[index] for index in range(num_images)]

    progress("retrieval", 0, 2 * num_images)
    # Each of our threads multiplies descriptors, as those of `PairWork` do.
    with threadpool_limits(1, user_api="blas"):
        words = learn_words(np.concatenate(for_each(sampled, 0)))
        looks = Looks(for_each(lambda k: signature(descriptors_of(k), words), num_images))
        passed = _passed_over(num_images, without)
        starts = range(0, num_images, _ROWS)
        alike = partial(looks.most_alike, count=count, passed=passed)
        chosen = {pair for _, found in on_threads(alike, starts, num_threads) for pair in found}
    return sorted(chosen)


class Looks:
    """Signatures of images, by their words."""

    def __init__(self, signatures: Sequence[Signature]) -> None:
        self._num_images = len(signatures)
        self._is_blank = np.array([len(each.words) == 0 for each in signatures])
        words = np.concatenate([each.words for each in signatures])
        images = np.repeat(np.arange(len(signatures)), [len(each.words) for each in signatures])
        order = np.argsort(words, kind="stable")  # of one word, the images ascend
        self._images = images[order]
        self._signs = np.concatenate([each.signs for each in signatures])[order]
        counts = np.bincount(words, minlength=NUM_WORDS)
        self._ends = np.cumsum(counts)
        self._starts = self._ends - counts
        self._weights = rarity(self._num_images, counts)
        squares = np.bincount(images, self._weights[words], minlength=self._num_images)
        self._lengths = np.sqrt(np.maximum(squares, 1e-12))

    def most_alike(self, start: int, count: int, passed: Sequence[NDArray[np.int64]]) -> list[Pair]:
        """Pairs of `_ROWS` images from this one on."""
        scores = self._scores(start)
        for row, others in zip(scores, passed[start : start + _ROWS], strict=True):
            row[others] = -1.0
        scores[:, self._is_blank] = scores[self._is_blank[start : start + _ROWS]] = -1.0
        order = np.argsort(-scores, axis=1, kind="stable")[:, :count]
        rows, places = np.nonzero(np.take_along_axis(scores, order, axis=1) >= 0.0)
        ends = zip((rows + start).tolist(), order[rows, places].tolist(), strict=True)
        return [(min(pair), max(pair)) for pair in ends]

    def scores_of(self, other: Signature) -> NDArray[np.float64]:
        """How alike each of the images and another one are, up to a factor."""
        scores = np.zeros(self._num_images)
        for word, packed in zip(other.words, other.signs, strict=True):
            having = slice(self._starts[word], self._ends[word])
            agreement = _agreement(packed[None], self._signs[having])[0]
            scores[self._images[having]] += self._weights[word] * agreement
        return np.asarray(scores / self._lengths)

    def _scores(self, start: int) -> NDArray[np.float64]:
        """How alike some images and all others are: 1 for equal ones, 0 without a common word."""
        stop = min(start + _ROWS, self._num_images)
        scores = np.zeros((stop - start, self._num_images))
        for word in np.flatnonzero(self._ends - self._starts > 1):
            having = slice(self._starts[word], self._ends[word])
            images = self._images[having]
            first, last = np.searchsorted(images, (start, stop))
            if first == last:
                continue
            agreement = _agreement(self._signs[having][first:last], self._signs[having])
            scores[np.ix_(images[first:last] - start, images)] += self._weights[word] * agreement
        return np.asarray(scores / self._lengths[start:stop, None] / self._lengths)


def _agreement(signs: NDArray[np.uint8], others: NDArray[np.uint8]) -> NDArray[np.float32]:
    """How alike descriptors of one word are, by their packed signs."""
    # Sums of ones, and their third powers, are exact in any order.
    rows, columns = (np.unpackbits(s, axis=1).astype(np.float32) * 2 - 1 for s in (signs, others))
    return np.asarray(np.maximum(rows @ columns.T / rows.shape[1], 0.0) ** 3)


def _passed_over(num_images: int, without: Collection[Pair]) -> list[NDArray[np.int64]]:
    """Images that each image is not paired with: itself and those of given pairs."""
    others: list[list[int]] = [[index] for index in range(num_images)]
    for first, second in without:
        others[first].append(second)
        others[second].append(first)
    return [np.array(each) for each in others]
