# SPDX-License-Identifier: BSD-3-Clause
"""hloc's files, opened to be read a pair at a time."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from epi360.interop.hloc_layout import (
    HLOC_TO_CONTINUOUS,
    dataset,
    image_names,
    listed_pairs,
    opened,
    pair_groups,
    reading,
    resolved_pairs,
)
from epi360.interop.pairs_file import read_pairs_file
from epi360.runs.whole_files import PathLike

LARGEST_SIDE = 2**31  # pixels of the width or height of an image


class HlocPairs:
    """hloc's features and matches files, read a pair at a time; use it in a ``with``."""

    def __init__(
        self, features: PathLike, matches: PathLike, *, pairs: PathLike | None = None
    ) -> None:
        self._features_path, self._matches_path = Path(features), Path(matches)
        with ExitStack() as files:
            self._features = files.enter_context(opened(self._features_path))
            self._matches = files.enter_context(opened(self._matches_path))
            # A dict, because it keeps its order and is fast to search.
            self._images = dict.fromkeys(image_names(self._features, self._features_path))
            self._counts: dict[str, int] = {}
            groups = pair_groups(self._matches, self._matches_path)
            listed = None
            if pairs is not None:
                listed = read_pairs_file(pairs, names=self._images, both_orders=True)
            try:
                if listed is None:
                    self._groups = resolved_pairs(groups, self._images)
                else:
                    self._groups = listed_pairs(groups, self._images, listed)
            except ValueError as error:
                raise ValueError(f"{self._matches_path}: {error}") from None
            self._files = files.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files, which may be closed already."""
        self._files.close()

    def images(self) -> list[str]:
        """Return the names of all images of the features file, sorted."""
        return list(self._images)

    def pairs(self) -> list[tuple[str, str]]:
        """Return the names of the two images of each pair."""
        return list(self._groups)

    def keypoints(self, image: str) -> NDArray[np.float64]:
        """Return the key points of an image in continuous pixels, shape (N, 2)."""
        values = self._dataset(image, "keypoints")
        if values is None or not _are_numbers(values) or values.shape[1:] != (2,):
            raise ValueError(
                f"{self._features_path}: keypoints of {image} must be numbers of shape (N, 2), "
                f"got {_described(values)}"
            )
        if not np.isfinite(values).all():
            raise ValueError(f"{self._features_path}: keypoints of {image} must be finite")
        return values.astype(np.float64) + HLOC_TO_CONTINUOUS

    def descriptors(self, image: str) -> NDArray[np.float32] | None:
        """Return the descriptors of an image, shape (N, D), or None if the file has none."""
        values, count = self._dataset(image, "descriptors"), self._num_keypoints(image)
        if values is None:
            return None
        if not _are_numbers(values) or values.ndim != 2 or values.shape[1] != count:
            raise ValueError(
                f"{self._features_path}: descriptors of {image} must be numbers of shape "
                f"(D, {count}), got {_described(values)}"
            )
        return np.ascontiguousarray(values.T, dtype=np.float32)

    def image_size(self, image: str) -> tuple[int, int] | None:
        """Return width and height of an image in pixels, or None if the file does not say."""
        values = self._dataset(image, "image_size")
        if values is None:
            return None
        is_pair = _are_numbers(values) and values.shape == (2,)
        if not (is_pair and ((values > 0) & (values < LARGEST_SIDE)).all()):
            got = values.tolist() if is_pair else _described(values)
            raise ValueError(
                f"{self._features_path}: image_size of {image} must be width and height, got {got}"
            )
        return int(values[0]), int(values[1])

    def matches(self, image1: str, image2: str) -> NDArray[np.int64]:
        """Return the matches of a pair in either order, shape (M, 2): key points of both images."""
        is_listed = (image1, image2) in self._groups
        listed = (image1, image2) if is_listed else (image2, image1)
        if listed not in self._groups:
            raise ValueError(f"{self._matches_path} has no pair {image1} {image2}")
        path, is_swapped = self._groups[listed]
        if is_swapped == is_listed:  # the group has image 2 first
            return self._stored_matches(path, image2, image1)[:, ::-1].copy()
        return self._stored_matches(path, image1, image2)

    def _stored_matches(self, path: str, image1: str, image2: str) -> NDArray[np.int64]:
        what = f"{self._matches_path}: pair {image1} {image2}"
        with reading(self._matches_path):
            group = self._matches[path]
        matches0 = dataset(group, "matches0", self._matches_path)
        count1, count2 = self._num_keypoints(image1), self._num_keypoints(image2)
        if matches0 is None or matches0.shape != (count1,) or matches0.dtype.kind not in "iu":
            raise ValueError(
                f"{what}: matches0 must be {count1} integers, one for each key point of {image1}, "
                f"got {_described(matches0)}; were the features computed anew?"
            )
        indices2 = matches0.astype(np.int64)
        if count1 and not -1 <= indices2.min() <= indices2.max() < count2:
            raise ValueError(
                f"{what}: matches0 must be -1 or one of the {count2} key points of {image2}, "
                f"got {indices2.min()} to {indices2.max()}"
            )
        indices1 = np.flatnonzero(indices2 >= 0)
        return np.column_stack((indices1, indices2[indices1])).astype(np.int64)

    def _image(self, image: str) -> Any:
        if image not in self._images:
            raise ValueError(f"{self._features_path} has no image {image}")
        return self._features[image]

    def _num_keypoints(self, image: str) -> int:
        if image not in self._counts:  # it would take half of the time of reading a pair's matches
            with reading(self._features_path):
                self._counts[image] = int(self._image(image)["keypoints"].shape[0])
        return self._counts[image]

    def _dataset(self, image: str, name: str) -> NDArray[Any] | None:
        with reading(self._features_path):
            group = self._image(image)
        return dataset(group, name, self._features_path)


def _are_numbers(values: NDArray[Any]) -> bool:
    return values.dtype.kind in "fiu"


def _described(values: NDArray[Any] | None) -> str:
    return "none" if values is None else f"{values.dtype} {values.shape}"
