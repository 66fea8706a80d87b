# SPDX-License-Identifier: BSD-3-Clause
"""Matches in a Parquet file: one row a pair, lists of bearings or pixels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import groupby
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360.jobs.batch.sources import (
    MatchSource,
    PairMatches,
    bearings_of,
    cameras_of,
    check_rows,
    named_camera,
    parts_of,
)
from epi360.runs import storage

Array = NDArray[np.float64]

_NAMES = ("image1", "image2")
_UNIT_TOLERANCE = 0.01  # of the length of a bearing; 32-bit numbers, and some rounding
# Pages are read one after the other: without this a row group is read as a whole.
_STREAMING = {"pre_buffer": False, "buffer_size": 1 << 22}


@contextmanager
def open_parquet(source: MatchSource) -> Iterator[ParquetMatches]:
    """Open a Parquet file of matches and check its columns."""
    with storage.open_read(source.path) as file:
        yield ParquetMatches(source, file)


class ParquetMatches:
    """A Parquet file of matches that is open; see `OpenMatches`.

    With a camera file the columns are ``pixels1`` and ``pixels2``, without one ``bearings1`` and
    ``bearings2``.
    """

    def __init__(self, source: MatchSource, file: IO[bytes]) -> None:
        parquet = extra_library("pyarrow.parquet", extra="batch", purpose="Parquet files")
        self._source, self._path = source, source.path
        self._width = 2 if source.camera else 3
        self._cameras = cameras_of(source)
        with _reading(self._path):
            self._file = parquet.ParquetFile(file, **_STREAMING)
        self._columns = ["pixels1", "pixels2"] if source.camera else ["bearings1", "bearings2"]
        self._check_columns()
        # (row group, slice in it, rows of the file), one for each part
        self._parts: list[tuple[int, int, range]] = []
        self._pairs_per_part = source.pairs_per_part
        start, metadata = 0, self._file.metadata
        for group in range(metadata.num_row_groups):
            num_rows = metadata.row_group(group).num_rows
            for index, rows in enumerate(parts_of(num_rows, source.pairs_per_part)):
                self._parts.append((group, index, range(start + rows.start, start + rows.stop)))
            start += num_rows

    @property
    def fingerprint(self) -> str:
        """Hash of the footer with all statistics, some blocks, and the cameras."""
        size = storage.file_size(self._path)
        (end,) = storage.read_ranges(self._path, [(size - 8, size)])
        footer = int.from_bytes(end[:4], "little")
        extra = storage.read_ranges(self._path, [(max(size - 8 - footer, 0), size)])
        return storage.fingerprint_of_file(self._path, [*extra, self._cameras])

    @property
    def part_sizes(self) -> list[int]:
        """Pairs in each part, in the order of the file."""
        return [len(rows) for _, _, rows in self._parts]

    @property
    def part_groups(self) -> list[int]:
        """Row group of each part, which is decoded from its start."""
        return [group for group, _, _ in self._parts]

    def names(self) -> Iterator[tuple[list[str], list[str]]]:
        """Names of the first and second images, some pairs at a time, in order."""
        start = 0
        with _reading(self._path):
            for batch in self._file.iter_batches(columns=list(_NAMES)):
                yield self._batch_names(batch, start)
                start += len(batch)

    def read(self, parts: Sequence[int]) -> Iterator[PairMatches]:
        """Pairs of these parts, given in rising order, one part at a time.

        In a row group the slices before those that are wanted are decoded and dropped.
        """
        wanted = [self._parts[part] for part in parts]
        for group, slices in groupby(wanted, key=lambda part: part[0]):
            batches = enumerate(self._batches(group))
            for _, index, rows in slices:
                with _reading(self._path):
                    batch = next((batch for number, batch in batches if number == index), None)
                if batch is None or len(batch) != len(rows):
                    raise ValueError(f"{self._path} is damaged: row group {group} is too short")
                yield self._pairs(batch, rows.start)

    def _batches(self, group: int) -> Iterator[Any]:
        columns = [*_NAMES, *self._columns]
        return iter(
            self._file.iter_batches(
                batch_size=self._pairs_per_part, row_groups=[group], columns=columns
            )
        )

    def _pairs(self, batch: Any, first_row: int) -> PairMatches:
        image1, image2 = self._batch_names(batch, first_row)
        views = [self._arrays(batch.column(name), name, first_row) for name in self._columns]
        pairs = PairMatches(first_row, image1, image2, *views)
        check_rows(self._path, pairs)
        if not self._cameras:
            for name, view in zip(self._columns, views, strict=True):
                self._check_bearings(name, view, first_row)
            return pairs
        return replace(
            pairs,
            bearings1=[self._bearings(*each) for each in zip(image1, views[0], strict=True)],
            bearings2=[self._bearings(*each) for each in zip(image2, views[1], strict=True)],
        )

    def _check_bearings(self, name: str, view: Sequence[Array], first_row: int) -> None:
        """Raise for what is no list of rays: pixels, or all x before all y and z."""
        for row, bearings in enumerate(view, start=first_row):
            rays = bearings[np.isfinite(bearings).all(axis=1)]
            lengths = np.linalg.norm(rays, axis=1)
            is_unit = np.abs(lengths - 1.0) < _UNIT_TOLERANCE
            of_plane = rays[:, 2] == 1.0  # rays of a pinhole camera that were not normalised
            if not len(rays) or max(is_unit.mean(), of_plane.mean()) > 0.5:
                continue
            raise ValueError(
                f"{self._path}: {name} must hold unit vectors, x, y, z of one match after the "
                f"other; those of row {row} have lengths of {lengths.min():.3g} to "
                f"{lengths.max():.3g}. Pixels go into pixels1 and pixels2, with a camera"
            )

    def _bearings(self, image: str, pixels: Array) -> Array:
        return bearings_of(pixels, named_camera(image, None, self._cameras), image, self._source)

    def _batch_names(self, batch: Any, first_row: int) -> tuple[list[str], list[str]]:
        names = []
        for name in _NAMES:
            column = batch.column(name)
            if column.null_count:
                row = first_row + column.is_null().to_pylist().index(True)
                raise ValueError(f"{self._path}: {name} must be a name, row {row} is null")
            names.append(column.cast("string").to_pylist())
        return names[0], names[1]

    def _arrays(self, column: Any, name: str, first_row: int) -> list[Array]:
        """Array (M, 2) or (M, 3) of each row of a column of flat or nested lists."""
        compute = extra_library("pyarrow.compute", extra="batch", purpose="Parquet files")
        if column.null_count:
            row = first_row + column.is_null().to_pylist().index(True)
            raise ValueError(f"{self._path}: {name} must be a list, row {row} is null")
        lengths = _numpy(compute.list_value_length(column))
        values, width = column.flatten(), self._width
        if _is_list(values.type):
            inner = _numpy(compute.list_value_length(values), -1)
            bad = np.flatnonzero(inner != width)
            if len(bad):
                row = first_row + int(np.searchsorted(np.cumsum(lengths), bad[0], side="right"))
                raise ValueError(
                    f"{self._path}: {name} must be lists of {width} numbers, row {row} has one of "
                    f"{max(inner[bad[0]], 0)}"
                )
            values = values.flatten()
        else:
            bad = np.flatnonzero(lengths % width)
            if len(bad):
                raise ValueError(
                    f"{self._path}: {name} must have {width} numbers a match, row "
                    f"{first_row + bad[0]} has {lengths[bad[0]]}"
                )
            lengths = lengths // width
        # A null number becomes NaN: missing data.
        flat = _numpy(values.cast("double"), np.nan).reshape(-1, width)
        return np.split(flat, np.cumsum(lengths)[:-1])

    def _check_columns(self) -> None:
        schema = self._file.schema_arrow
        if (
            self._width == 3
            and {"pixels1", "pixels2"} <= set(schema.names)
            and not ({"bearings1", "bearings2"} & set(schema.names))
        ):
            raise ValueError(f"{self._path} has pixels; say with --camera FILE of which cameras")
        missing = [name for name in (*_NAMES, *self._columns) if name not in schema.names]
        if missing:
            raise ValueError(
                f"{self._path} must have the columns {', '.join((*_NAMES, *self._columns))}; "
                f"it lacks {', '.join(missing)}"
            )
        for name in _NAMES:
            if not _is_text(schema.field(name).type):
                raise ValueError(
                    f"{self._path}: {name} must be text, got {schema.field(name).type}"
                )
        for name in self._columns:
            if not _holds_numbers(schema.field(name).type):
                raise ValueError(
                    f"{self._path}: {name} must be lists of numbers, got {schema.field(name).type}"
                )


def _numpy(array: Any, missing: float = 0) -> NDArray[Any]:
    """NumPy array of numbers, read-only.

    The method to_numpy of pyarrow would import pandas if there is one: half a second and 30 MB.
    """
    return np.from_dlpack(array.fill_null(missing) if array.null_count else array)


def _is_list(kind: Any) -> bool:
    types = extra_library("pyarrow.types", extra="batch", purpose="Parquet files")
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _is_text(kind: Any) -> bool:
    types = extra_library("pyarrow.types", extra="batch", purpose="Parquet files")
    kind = kind.value_type if types.is_dictionary(kind) else kind
    return bool(types.is_string(kind) or types.is_large_string(kind))


def _holds_numbers(kind: Any) -> bool:
    """Whether a type is a list, or a list of lists, of floats or integers."""
    types = extra_library("pyarrow.types", extra="batch", purpose="Parquet files")
    if not _is_list(kind):
        return False
    inner = kind.value_type
    inner = inner.value_type if _is_list(inner) else inner
    return bool(types.is_floating(inner) or types.is_integer(inner))


@contextmanager
def _reading(path: str) -> Iterator[None]:
    """Turn what pyarrow says of a damaged file into one sentence."""
    arrow = extra_library("pyarrow", extra="batch", purpose="Parquet files")
    try:
        yield
    except (arrow.ArrowException, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise ValueError(f"{path} is no Parquet file, or truncated or damaged: {error}") from None
