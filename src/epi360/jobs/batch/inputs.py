# SPDX-License-Identifier: BSD-3-Clause
"""Inputs of a batch: opened by their kind, and checked for pairs that are there twice."""

from __future__ import annotations

from contextlib import AbstractContextManager

import numpy as np

from epi360.jobs.batch.file_matches import open_colmap, open_hloc
from epi360.jobs.batch.parquet_matches import open_parquet
from epi360.jobs.batch.sources import MatchSource, OpenMatches, pair_seed


def open_matches(source: MatchSource) -> AbstractContextManager[OpenMatches]:
    """Open an input and check its schema; ValueError where it cannot be used."""
    if source.kind == "parquet":
        return open_parquet(source)
    return open_colmap(source) if source.kind == "colmap" else open_hloc(source)


def check_names(path: str, matches: OpenMatches) -> None:
    """Raise where there is no pair, or one is there twice, or is of an image with itself.

    Of the input, only names are read.
    """

    def hashed(row: int, pair: tuple[str, str]) -> int:
        if pair[0] == pair[1]:
            raise ValueError(f"{path}: row {row} is a pair of {pair[0]} with itself")
        return pair_seed(0, *pair)

    pairs = (pair for names in matches.names() for pair in zip(*names, strict=True))
    # Eight bytes a pair are kept.
    hashes = np.fromiter((hashed(*each) for each in enumerate(pairs)), dtype=np.uint64)
    if not len(hashes):
        raise ValueError(f"{path} has no pairs")
    order = np.argsort(hashes, kind="stable")
    again = np.flatnonzero(hashes[order][1:] == hashes[order][:-1])
    if len(again):
        first, second = order[again[0]], order[again[0] + 1]
        pair = _names_of(matches, int(second))
        raise ValueError(
            f"{path}: the pair {pair[0]} {pair[1]} is there twice, in rows {first} and {second}"
        )


def _names_of(matches: OpenMatches, row: int) -> tuple[str, str]:
    for image1, image2 in matches.names():
        if row < len(image1):
            return image1[row], image2[row]
        row -= len(image1)
    raise IndexError(row)
