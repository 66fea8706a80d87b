# SPDX-License-Identifier: BSD-3-Clause
"""Matches that repeat another one: where they are many, each counts once.

What is here for points and cameras, native/core/robust/copies.cpp does for pairs of views.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


# Share of the matches that are copies, over which these are left out. Key points with two
# directions make fewer: 4 % of real matches, up to a fifth of rendered ones.
_MANY_COPIES = 0.25


def distinct_rows(*columns: Array) -> tuple[Indices, Indices]:
    """Return the rows that repeat no earlier one, and the place among them of every row's own.

    ``columns``, (N, K) each, are the numbers of a match, which copies share to the last digit.
    Where few rows are copies, all are returned.
    """
    first, own = _firsts(columns)
    if len(own) - len(first) <= _MANY_COPIES * len(own):
        return np.arange(len(own)), np.arange(len(own))
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return first[order], place[own]


def repeat_no_earlier(*columns: Array) -> NDArray[np.bool_]:
    """Which rows of ``columns``, (N, K) each, repeat no earlier one, shape (N,)."""
    first, own = _firsts(columns)
    mask = np.zeros(len(own), dtype=bool)
    mask[first] = True
    return mask


def _firsts(columns: Sequence[Array]) -> tuple[Indices, Indices]:
    """The first of all rows that are equal, in any order, and for each row which of them it is."""
    # Adding zero makes one of its two signs.
    rows = np.ascontiguousarray(np.hstack(columns) + 0.0)
    bytes_of_row = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel()
    _, first, own = np.unique(bytes_of_row, return_index=True, return_inverse=True)
    return first, own


def copies_sentence(num_copies: int, num_matches: int) -> str:
    """Return what a person is told of them."""
    return (
        f"{num_copies} of {num_matches} matches repeat another one exactly: each counts once, "
        "however often it is given"
    )
