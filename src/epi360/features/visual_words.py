# SPDX-License-Identifier: BSD-3-Clause
"""Visual words of SIFT descriptors, and the signature of an image that is made of them.

Tolias, Avrithis and Jégou, "To aggregate or not to aggregate" (ICCV 2013): of all descriptors of an
image that are nearest to one word, the signature keeps the signs of the sum of what they differ by.
The words come from the images themselves, so that there is nothing to train or to ship. A signature
knows no directions: a panorama that is turned about any axis has the same one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from epi360.features.matching import rounded_descriptors

Descriptors = NDArray[np.float32]
Number = TypeVar("Number", bound=np.generic)

# The strongest of each image; with 2000 the partners are no better and cost twice the time.
NUM_DESCRIPTORS = 1000
NUM_WORDS = 4096
SAMPLES_PER_WORD = 10
_ROUNDS = 5
_ROWS = 1024  # of a product: 16 MB


@dataclass(frozen=True, eq=False)
class Signature:
    """Words of an image (K,), ascending, and the packed signs (K, D / 8) of each."""

    words: NDArray[np.uint16]
    signs: NDArray[np.uint8]


def learn_words(samples: Descriptors) -> Descriptors:
    """Words (K, D) of sampled descriptors (N, D): Lloyd's k-means; the same on any machine.

    The products of rounded descriptors are exact, and so are their comparisons.
    """
    samples = rounded_descriptors(samples)
    count = min(NUM_WORDS, len(samples) // SAMPLES_PER_WORD)
    words = samples[np.linspace(0, len(samples) - 1, count).astype(int)]
    for _ in range(_ROUNDS if count else 0):
        nearest = _nearest(samples, words)
        sizes = np.bincount(nearest, minlength=count)[:, None]
        means = (_sums(samples, nearest, count) / np.maximum(sizes, 1)).astype(np.float32)
        words = np.where(sizes > 0, rounded_descriptors(means), words)
    return np.asarray(words)


def signature(descriptors: Descriptors, words: Descriptors) -> Signature:
    """Signature of an image by its descriptors (N, D), strongest first."""
    strongest = rounded_descriptors(descriptors[:NUM_DESCRIPTORS])
    if len(strongest) == 0 or len(words) == 0:
        return Signature(np.zeros(0, np.uint16), np.zeros((0, -(-words.shape[1] // 8)), np.uint8))
    nearest = _nearest(strongest, words)
    present, row = np.unique(nearest, return_inverse=True)
    sums = _sums(strongest - words[nearest], row, len(present))
    return Signature(present.astype(np.uint16), np.packbits(sums > 0, axis=1))


def evenly_spread(descriptors: NDArray[Number], count: int) -> NDArray[Number]:
    """Some of an image's descriptors, at even distances in the order of their strength."""
    count = min(count, len(descriptors))
    return np.asarray(descriptors[np.linspace(0, len(descriptors) - 1, count).astype(int)])


def rarity(num_images: int, num_with_word: NDArray[np.int64]) -> NDArray[np.float64]:
    """Weight of words by how many images have them (Sivic and Zisserman, ICCV 2003)."""
    # One more image than there are: a word that all of them have still counts a little.
    return np.asarray(np.log((num_images + 1.0) / np.maximum(num_with_word, 1)))


def _sums(rows: Descriptors, group: NDArray[np.int64], count: int) -> Descriptors:
    """Sum of the rows of each group."""
    sums = np.zeros((count, rows.shape[1]), np.float32)
    np.add.at(sums, group, rows)
    return sums


def _nearest(descriptors: Descriptors, words: Descriptors) -> NDArray[np.int64]:
    """Nearest word of each descriptor."""
    half_squares = (words * words).sum(axis=1) / 2
    transposed = np.ascontiguousarray(words.T)
    found = np.zeros(len(descriptors), np.int64)
    for start in range(0, len(descriptors), _ROWS):
        block = descriptors[start : start + _ROWS]
        found[start : start + _ROWS] = (block @ transposed - half_squares).argmax(axis=1)
    return found
