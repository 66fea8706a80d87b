# SPDX-License-Identifier: BSD-3-Clause
"""Matches in files with key points per image: COLMAP databases, hloc's features and matches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.interop.colmap_pairs import ColmapPairs
from epi360.interop.hloc_pairs import HlocPairs
from epi360.jobs.batch.sources import (
    MatchSource,
    PairMatches,
    bearings_of,
    cameras_of,
    named_camera,
    parts_of,
)
from epi360.jobs.matching.check_keypoints import check_filled
from epi360.runs.storage import fingerprint_of_file

Array = NDArray[np.float64]

_LOOKED_AT = 8  # pairs whose key points tell whether all were found in smaller pictures
_CACHED_IMAGES = 64  # matchers list a pair's neighbours beside it, so few images are in use at once


@contextmanager
def open_colmap(source: MatchSource) -> Iterator[FileMatches]:
    """Open a COLMAP database, with its own cameras, or others in their place.

    Panoramas for which pycolmap has made up a camera need another one.
    """
    given = cameras_of(source)
    with ColmapPairs(source.path) as database:
        if not given:
            database.check_panoramas()

        def view(image: str) -> tuple[Array, Camera]:
            camera = database.camera(image)
            if given:
                camera = named_camera(image, (camera.width, camera.height), given)
            return database.keypoints(image), camera

        def bearings(image: str) -> Array:
            return bearings_of(*view(image), image, source)

        _check_some(database.names, view)
        counts = (
            (table, list(database.rows(f"SELECT {key}, rows FROM {table} ORDER BY {key}")))
            for table, key in (("keypoints", "image_id"), ("matches", "pair_id"))
        )
        fingerprint = fingerprint_of_file(source.path, [*counts, given or database.cameras])
        yield FileMatches(database.names, bearings, database.matches, source, fingerprint)


@contextmanager
def open_hloc(source: MatchSource) -> Iterator[FileMatches]:
    """Open hloc's features and matches; an image that is no panorama needs a camera."""
    if source.features is None:
        raise ValueError(f"{source.path}: hloc's matches need the key points; give --features FILE")
    cameras = cameras_of(source)
    with HlocPairs(source.features, source.path, pairs=source.pairs) as files:

        def view(image: str) -> tuple[Array, Camera]:
            return files.keypoints(image), named_camera(image, files.image_size(image), cameras)

        def bearings(image: str) -> Array:
            return bearings_of(*view(image), image, source)

        pairs = files.pairs()
        _check_some(pairs, view)
        extra = (fingerprint_of_file(source.features), pairs, cameras)
        fingerprint = fingerprint_of_file(source.path, extra)
        yield FileMatches(
            pairs, bearings, lambda index: files.matches(*pairs[index]), source, fingerprint
        )


def _check_some(
    pairs: Sequence[tuple[str, str]], view: Callable[[str], tuple[Array, Camera]]
) -> None:
    """Raise where the key points of the first images were found in smaller pictures."""
    names = dict.fromkeys(name for pair in pairs[:_LOOKED_AT] for name in pair)
    views = ((name, *view(name)) for name in names)
    check_filled((name, camera, keypoints) for name, keypoints, camera in views)


class FileMatches:
    """Matches in an open file that keeps key points per image; see `OpenMatches`.

    ``bearings`` gives those (N, 3) of the key points of an image by its name, ``matches`` the
    indices (M, 2) of a pair by its number.
    """

    def __init__(
        self,
        pairs: Sequence[tuple[str, str]],
        bearings: Callable[[str], Array],
        matches: Callable[[int], NDArray[np.int64]],
        source: MatchSource,
        fingerprint: str,
    ) -> None:
        self._pairs = pairs
        self._bearings = lru_cache(_CACHED_IMAGES)(bearings)
        self._matches = matches
        self._parts = parts_of(len(pairs), source.pairs_per_part)
        self.fingerprint = fingerprint

    @property
    def part_sizes(self) -> list[int]:
        """Pairs in each part, in the order of the file."""
        return [len(rows) for rows in self._parts]

    @property
    def part_groups(self) -> list[int]:
        """One group for all: whoever opens the file must read the list of all pairs."""
        return [0] * len(self._parts)

    def names(self) -> Iterator[tuple[Sequence[str], Sequence[str]]]:
        """Names of the first and second images, in order."""
        if self._pairs:
            image1, image2 = zip(*self._pairs, strict=True)
            yield image1, image2

    def read(self, parts: Sequence[int]) -> Iterator[PairMatches]:
        """Pairs of these parts, in any order, one part at a time."""
        for part in parts:
            rows = self._parts[part]
            names = [self._pairs[row] for row in rows]
            matches = [self._matches(row) for row in rows]
            views = [
                [
                    self._bearings(pair[view])[indices[:, view]]
                    for pair, indices in zip(names, matches, strict=True)
                ]
                for view in range(2)
            ]
            image1, image2 = ([pair[view] for pair in names] for view in range(2))
            yield PairMatches(rows.start, image1, image2, *views)
