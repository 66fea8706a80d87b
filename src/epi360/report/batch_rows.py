# SPDX-License-Identifier: BSD-3-Clause
"""The poses of `epi360 batch` as arrays for its report, and the pairs that the report lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360.runs import storage

Array = NDArray[np.float64]

_NUMBERS = ("num_matches", "num_inliers", "noise_deg", "parallax_deg", "probability")
_ROWS_AT_ONCE = 5000  # rows that are decoded at a time: a covariance has 25 numbers


@dataclass(frozen=True, eq=False)
class BatchRows:
    """Numbers of all pairs of an output, in its order; NaN where a pair has none."""

    statuses: NDArray[np.str_]
    num_matches: Array
    num_inliers: Array
    noise_deg: Array
    parallax_deg: Array
    probability: Array
    rotation_sigma_deg: Array
    direction_sigma_deg: Array

    @property
    def is_ok(self) -> NDArray[np.bool_]:
        """Which pairs are ok."""
        return np.asarray(self.statuses == "ok")


def read_batch_rows(path: str) -> BatchRows:
    """Read all numbers but the poses of an output of `run_batch`; a path or a URL."""
    statuses: list[str] = []
    columns: dict[str, list[Array]] = {name: [] for name in (*_NUMBERS, "rotation", "direction")}
    for rows in _batches(path, ("status", "covariance", *_NUMBERS)):
        statuses += rows.column("status").to_pylist()
        for name in _NUMBERS:
            columns[name].append(np.array(rows.column(name).to_pylist(), np.float64))
        covariances = np.array(rows.column("covariance").to_pylist(), np.float64)
        variances = covariances.reshape(-1, 25)[:, ::6]
        columns["rotation"].append(_degrees(variances[:, :3]))
        columns["direction"].append(_degrees(variances[:, 3:]))
    joined = {
        name: np.concatenate(parts) if parts else np.zeros(0) for name, parts in columns.items()
    }
    rotation, direction = joined.pop("rotation"), joined.pop("direction")
    return BatchRows(
        np.array(statuses, dtype=np.str_),
        rotation_sigma_deg=rotation,
        direction_sigma_deg=direction,
        **joined,
    )


def names_of(path: str, chosen: NDArray[np.intp]) -> list[tuple[str, str]]:
    """Return the names of the images of some rows, whose numbers rise."""
    names: list[tuple[str, str]] = []
    start = 0
    for rows in _batches(path, ("image1", "image2")):
        inside = chosen[(chosen >= start) & (chosen < start + len(rows))] - start
        if len(inside):
            image1, image2 = (rows.column(name).to_pylist() for name in ("image1", "image2"))
            names += [(image1[i], image2[i]) for i in inside]
        start += len(rows)
    return names


def listed_rows(rows: BatchRows, most: int) -> NDArray[np.intp]:
    """Return all rows, or of more than ``most`` the least certain ok ones, others, and a cross-cut.

    Half are the ok pairs with the lowest probability, a quarter pairs that are not ok, spread over
    the output, and the rest is spread over all pairs.
    """
    count = len(rows.statuses)
    if count <= most:
        return np.arange(count)
    ok, others = np.flatnonzero(rows.is_ok), np.flatnonzero(~rows.is_ok)
    doubt = np.lexsort((-rows.direction_sigma_deg[ok], rows.probability[ok]))
    chosen = np.union1d(ok[doubt[: most // 2]], _spread(others, most // 4))
    rest = np.setdiff1d(np.arange(count), chosen)
    return np.union1d(chosen, _spread(rest, most - len(chosen)))


def _batches(path: str, columns: Sequence[str]) -> Any:
    parquet = extra_library("pyarrow.parquet", extra="batch", purpose="Parquet files")
    with storage.open_read(path) as file:
        reader = parquet.ParquetFile(file)
        yield from reader.iter_batches(_ROWS_AT_ONCE, columns=list(columns))


def _degrees(variances: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return np.asarray(np.degrees(np.sqrt(variances.sum(axis=1))))


def _spread(rows: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    if len(rows) <= count:
        return rows
    return rows[np.linspace(0, len(rows) - 1, count).astype(np.intp)]
