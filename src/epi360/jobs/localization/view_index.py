# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a map look like a new one, by the signatures that choose pairs as well."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from epi360.features.visual_words import (
    NUM_DESCRIPTORS,
    Signature,
    evenly_spread,
    learn_words,
    signature,
)
from epi360.jobs.pairs.retrieval import Looks

Descriptors = NDArray[np.float32]

# That words are learnt from: half as many words as for pairs, and fewer of a few images, which is a
# quarter of the time and finds as much.
_NUM_SAMPLES, _MOST_PER_IMAGE = 20480, 400
_STEPS = 255.0  # descriptors of a thousand images wait in bytes until the words are known


class ViewIndex:
    """Signatures of the images of a map, one at least, and the words that they are made of."""

    def __init__(self, words: Descriptors, signatures: Sequence[Signature]) -> None:
        self.words, self.signatures = words, signatures
        self._looks = Looks(signatures)

    @classmethod
    def of(cls, descriptors: Iterable[Descriptors]) -> ViewIndex:
        """Learn the words of the images of a map; ValueError if their features are of two kinds."""
        strongest = [_in_bytes(each[:NUM_DESCRIPTORS]) for each in descriptors]
        numbers = sorted({each.shape[1] for each in strongest if len(each)})
        if len(numbers) > 1:
            raise ValueError(
                "descriptors of the map's images must have one length, got "
                + " and ".join(map(str, numbers))
            )
        per_image = min(-(-_NUM_SAMPLES // max(len(strongest), 1)), _MOST_PER_IMAGE)
        samples = [evenly_spread(each, per_image) for each in strongest]
        words = learn_words(_from_bytes(np.concatenate(samples)))
        return cls(words, [signature(_from_bytes(each), words) for each in strongest])

    def most_similar(self, descriptors: Descriptors) -> NDArray[np.int64]:
        """All images, the most similar first; ValueError for features of another kind."""
        if len(self.words) and self.words.shape[1] != descriptors.shape[1]:
            raise ValueError(
                f"features of the map have {self.words.shape[1]} numbers each, those of the new "
                f"image {descriptors.shape[1]}: they are not of one kind"
            )
        scores = self._looks.scores_of(signature(descriptors, self.words))
        return np.asarray(np.argsort(-scores, kind="stable"))


def _in_bytes(descriptors: Descriptors) -> NDArray[np.int8]:
    return np.asarray(np.clip(np.round(descriptors * _STEPS), -127, 127), np.int8)


def _from_bytes(descriptors: NDArray[np.int8]) -> Descriptors:
    return np.asarray(descriptors / np.float32(_STEPS), np.float32)
