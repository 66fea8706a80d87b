# SPDX-License-Identifier: BSD-3-Clause
"""The index over a map's images in a file beside the map, so that it is made once only.

The file is never needed: where it is missing, damaged, of another state of the map, or cannot be
written, the index is made of the features again.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np

from epi360.features.visual_words import NUM_WORDS, Signature
from epi360.jobs.localization.view_index import ViewIndex
from epi360.runs.arrays import Arrays, npz_bytes, read_arrays
from epi360.runs.made_from import fingerprint
from epi360.runs.whole_files import write_file

INDEX_FILE = "localize-index.npz"
# Raise it when the same features give another index than before.
_VERSION = 1
_TYPES = {
    "key": ("U", 0), "numbers": ("i", 1), "words": ("f", 2), "ends": ("i", 1),
    "image_words": ("u", 1), "image_signs": ("u", 2),
}  # fmt: skip


def index_key(*pieces: object) -> str:
    """Hash of what an index is made of."""
    return fingerprint((_VERSION, *pieces))


def read_index(path: Path, key: str, num_images: int) -> tuple[ViewIndex, list[int]] | None:
    """Index with this key and the numbers of its images, or None."""
    arrays = read_arrays(path) if path.is_file() else None  # a pipe would be waited for
    if arrays is None or not _is_whole(arrays, num_images) or str(arrays["key"]) != key:
        return None
    starts = np.concatenate([[0], arrays["ends"][:-1]])
    parts = [slice(*ends) for ends in zip(starts, arrays["ends"], strict=True)]
    signatures = [Signature(arrays["image_words"][p], arrays["image_signs"][p]) for p in parts]
    return ViewIndex(arrays["words"], signatures), [int(k) for k in arrays["numbers"]]


def write_index(path: Path, key: str, index: ViewIndex, numbers: list[int]) -> None:
    """Keep an index where that is possible."""
    arrays: Arrays = {
        "key": np.array(key),
        "numbers": np.array(numbers, np.int64),
        "words": index.words,
        "ends": np.cumsum([len(each.words) for each in index.signatures]),
        "image_words": np.concatenate([each.words for each in index.signatures]),
        "image_signs": np.concatenate([each.signs for each in index.signatures]),
    }
    if path.is_file() or not path.exists():
        with suppress(OSError):  # of a map that this user only reads
            write_file(path, npz_bytes(arrays))


def _is_whole(arrays: Arrays, num_images: int) -> bool:
    """Whether these are the arrays of an index, so that nothing else can go wrong with them."""
    if set(arrays) != set(_TYPES):
        return False
    if any((arrays[n].dtype.kind, arrays[n].ndim) != kind for n, kind in _TYPES.items()):
        return False
    ends, numbers, words = arrays["ends"], arrays["numbers"], arrays["words"]
    image_words, image_signs = arrays["image_words"], arrays["image_signs"]
    return bool(
        0 < len(numbers) == len(ends)
        and ((numbers >= 0) & (numbers < num_images)).all()
        and (np.diff(ends, prepend=0) >= 0).all()
        and ends[-1] == len(image_words) == len(image_signs)
        and image_words.max(initial=0) < min(NUM_WORDS, max(len(words), 1))
        and image_signs.shape[1] == -(-words.shape[1] // 8)
    )
