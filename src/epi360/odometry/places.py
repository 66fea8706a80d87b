# SPDX-License-Identifier: BSD-3-Clause
"""Which key frames show the same place: a bag of words over ORB descriptors.

Sivic and Zisserman, "Video Google" (ICCV 2003). The words are descriptors of the sequence itself,
so that there is nothing to train or to ship. A bag knows no directions: a panorama that is turned
about any axis has the same one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from epi360.features.binary_features import DESCRIPTOR_BYTES, nearest_descriptors
from epi360.features.visual_words import evenly_spread, rarity

Descriptors = NDArray[np.uint8]

# Of the strongest descriptors of a frame. On walks through rendered homes (revisits within 1 m,
# 215 queries) the first candidate is right for 99 % of them and one of the first five for all;
# k-means or VLAD on SIFT are not better, and the strongest 1000 descriptors are worse.
NUM_DESCRIPTORS = 300
_NUM_WORDS, _NUM_LEARNING_FRAMES = 2048, 32
_WORDS_PER_FRAME = _NUM_WORDS // _NUM_LEARNING_FRAMES
_ROOTS = np.sqrt(np.arange(256.0))
_NO_WORD = _NUM_WORDS  # fills rows with fewer words up; its weight is zero


class PlaceIndex:
    """Key frames, found again by what they show.

    A key frame takes 0.9 kB. The words are taken from the first 32 key frames and stay after that.
    """

    def __init__(self) -> None:
        self._key_frames = np.zeros(0, dtype=np.int64)
        self._words = np.zeros((0, NUM_DESCRIPTORS), dtype=np.uint16)
        self._counts = np.zeros((0, NUM_DESCRIPTORS), dtype=np.uint8)
        self._size = 0
        self._num_with_word = np.zeros(_NUM_WORDS + 1, dtype=np.int64)
        self._vocabulary = np.zeros((0, DESCRIPTOR_BYTES), dtype=np.uint8)
        self._learning: list[Descriptors] = []

    def __len__(self) -> int:
        return self._size

    def add(self, key_frame: int, descriptors: Descriptors) -> None:
        """Remember a key frame by its ORB descriptors (N, 32), strongest first.

        ``ValueError`` if the descriptors have another shape or the key frame's number is not
        above those before it.
        """
        strongest = _checked(descriptors)
        if self._size and key_frame <= self._key_frames[self._size - 1]:
            last = self._key_frames[self._size - 1]
            raise ValueError(f"key_frame must be above the last one, {last}, got {key_frame}")
        row = self._new_row(key_frame)
        if len(self._learning) < _NUM_LEARNING_FRAMES and self._size == len(self._learning) + 1:
            self._learn(strongest)
        else:
            self._describe(row, strongest)

    @property
    def has_learned(self) -> bool:
        """Whether the words stay as they are."""
        return len(self._learning) == _NUM_LEARNING_FRAMES

    def take_in(self, numbers: Mapping[int, int], others: Mapping[int, Descriptors]) -> None:
        """Renumber key frames, and remember others with any numbers, once the words are learned."""
        own = self._key_frames[: self._size]
        own[:] = [numbers[number] for number in own.tolist()]
        for number, descriptors in others.items():
            self._describe(self._new_row(number), _checked(descriptors))
        order = np.argsort(self._key_frames[: self._size], kind="stable")
        for table in (self._key_frames, self._words, self._counts):
            table[: self._size] = table[order]

    def most_similar(
        self, descriptors: Descriptors, count: int, *, not_after: int | None = None
    ) -> list[tuple[int, float]]:
        """Key frames that look most alike with their similarity in [0, 1], best first.

        Key frames above ``not_after`` are left out: neighbours in time look alike always.
        """
        strongest = _checked(descriptors)
        last = self._size
        if not_after is not None:
            last = int(np.searchsorted(self._key_frames[: self._size], not_after, side="right"))
        if last == 0 or len(strongest) == 0 or count < 1:
            return []
        similarities = self._similarities(*self._bag(strongest), last)
        order = np.argsort(-similarities, kind="stable")[:count]
        return [(int(self._key_frames[row]), float(similarities[row])) for row in order]

    def similar_before(self, key_frame: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Key frames before one that is remembered, in order, with their similarities to it."""
        row = int(np.searchsorted(self._key_frames[: self._size], key_frame))
        used = self._words[row] != _NO_WORD
        words, counts = self._words[row, used], self._counts[row, used]
        return self._key_frames[:row], self._similarities(words, counts, row)

    def _similarities(
        self, words: NDArray[np.integer], counts: NDArray[np.integer], num_rows: int
    ) -> NDArray[np.float64]:
        """Similarity of a bag to the first rows; a weight is a count's root times a frequency."""
        inverse_frequency = self._inverse_document_frequency()
        query = np.zeros(_NUM_WORDS + 1)
        query[words] = _ROOTS[counts] * inverse_frequency[words]
        bags, roots = self._words[:num_rows], np.take(_ROOTS, self._counts[:num_rows])
        weights = roots * np.take(inverse_frequency, bags)
        products = np.einsum("kw,kw->k", weights, np.take(query, bags))
        squares = np.einsum("kw,kw->k", weights, weights)
        lengths = np.sqrt(squares) * np.linalg.norm(query)
        return np.asarray(products / np.maximum(lengths, 1e-12))

    def _learn(self, strongest: Descriptors) -> None:
        """Take words of one of the first frames; their bags are made anew at every doubling."""
        self._learning.append(strongest)
        number = len(self._learning)
        if number & (number - 1):
            self._describe(number - 1, strongest)
            return
        words = [evenly_spread(one, _WORDS_PER_FRAME) for one in self._learning]
        self._vocabulary = np.ascontiguousarray(np.concatenate(words))
        self._num_with_word[:] = 0
        for row, one in enumerate(self._learning):
            self._describe(row, one)
        if number == _NUM_LEARNING_FRAMES:
            self._learning = [np.zeros((0, DESCRIPTOR_BYTES), np.uint8)] * number  # not needed now

    def _describe(self, row: int, strongest: Descriptors) -> None:
        words, counts = self._bag(strongest)
        self._words[row], self._counts[row] = _NO_WORD, 0
        self._words[row, : len(words)] = words
        self._counts[row, : len(counts)] = counts
        self._num_with_word[words] += 1

    def _bag(self, strongest: Descriptors) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Nearest words of descriptors, each once, and how often."""
        if len(strongest) == 0 or len(self._vocabulary) == 0:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        nearest, _ = nearest_descriptors(strongest, self._vocabulary, 1)
        words, counts = np.unique(nearest, return_counts=True)
        return words, np.minimum(counts, 255)

    def _inverse_document_frequency(self) -> NDArray[np.float64]:
        weights = rarity(self._size, self._num_with_word)
        weights[_NO_WORD] = 0.0
        return weights

    def _new_row(self, key_frame: int) -> int:
        """Row of one more key frame, in tables that grow to hold it."""
        if self._size == len(self._key_frames):
            more = max(64, self._size // 2)
            self._key_frames = np.append(self._key_frames, np.zeros(more, np.int64))
            padding = ((0, more), (0, 0))
            self._words = np.pad(self._words, padding, constant_values=_NO_WORD)
            self._counts = np.pad(self._counts, padding)
        self._key_frames[self._size] = key_frame
        self._size += 1
        return self._size - 1


def _checked(descriptors: Descriptors) -> Descriptors:
    array = np.asarray(descriptors)
    if array.ndim != 2 or array.shape[1] != DESCRIPTOR_BYTES or array.dtype != np.uint8:
        raise ValueError(
            f"descriptors must be uint8 of shape (N, {DESCRIPTOR_BYTES}), got {array.dtype} "
            f"{array.shape}"
        )
    return np.ascontiguousarray(array[:NUM_DESCRIPTORS])
