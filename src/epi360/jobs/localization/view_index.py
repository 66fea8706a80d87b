# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a map look like a new one: a bag of words over its own descriptors.

Sivic and Zisserman, "Video Google" (ICCV 2003), as `odometry.places` does it with binary
descriptors: a bag knows no directions, so that a panorama that is turned has the same one.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags

from epi360.features.visual_words import evenly_spread, rarity

Array = NDArray[np.float64]
Descriptors = NDArray[np.float32]

_PER_IMAGE = 400  # descriptors of an image that are counted
_NUM_WORDS = 4096
_STEPS = 255.0  # descriptors of a thousand images wait in bytes until the words are chosen


class ViewIndex:
    """Bags of words of the images of a map."""

    def __init__(self, descriptors: Iterable[Descriptors]) -> None:
        chosen = [_in_bytes(evenly_spread(each, _PER_IMAGE)) for each in descriptors]
        everything = [each for each in chosen if len(each)]
        lengths_of = sorted({each.shape[1] for each in everything})
        if len(lengths_of) > 1:
            raise ValueError(
                "descriptors of the map's images must have one length, got "
                + " and ".join(map(str, lengths_of))
            )
        per_image = max(1, _NUM_WORDS // max(len(everything), 1))
        self._words = np.concatenate(
            [evenly_spread(_from_bytes(each), per_image) for each in everything]
            or [np.zeros((0, 1), np.float32)]
        )
        rows = [self._counted(_from_bytes(each)) for each in chosen]
        bags = csr_matrix(np.stack(rows)) if rows else csr_matrix((0, len(self._words)))
        num_with_word = np.asarray((bags > 0).sum(axis=0)).ravel()
        self._importance = rarity(len(chosen), num_with_word)
        weighted = bags @ diags(self._importance)
        lengths = np.sqrt(np.asarray(weighted.multiply(weighted).sum(axis=1)).ravel())
        self._bags = diags(1.0 / np.maximum(lengths, 1e-12)) @ weighted

    def most_similar(self, descriptors: Descriptors) -> NDArray[np.int64]:
        """All images, the most similar first; ValueError for features of another kind."""
        if len(self._words) and self._words.shape[1] != descriptors.shape[1]:
            raise ValueError(
                f"features of the map have {self._words.shape[1]} numbers each, those of the new "
                f"image {descriptors.shape[1]}: they are not of one kind"
            )
        bag = self._counted(evenly_spread(descriptors, _PER_IMAGE)) * self._importance
        return np.asarray(np.argsort(-(self._bags @ bag), kind="stable"))

    def _counted(self, descriptors: Descriptors) -> Array:
        """Root of how often each word is the nearest of a descriptor."""
        if not len(descriptors) or not len(self._words):
            return np.zeros(len(self._words))
        nearest = np.asarray((descriptors @ self._words.T).argmax(axis=1))
        return np.asarray(np.sqrt(np.bincount(nearest, minlength=len(self._words))))


def _in_bytes(descriptors: Descriptors) -> NDArray[np.int8]:
    return np.asarray(np.clip(np.round(descriptors * _STEPS), -127, 127), np.int8)


def _from_bytes(descriptors: NDArray[np.int8]) -> Descriptors:
    return np.asarray(descriptors / np.float32(_STEPS), np.float32)
