# SPDX-License-Identifier: BSD-3-Clause
"""Files of raw trials: CSV tables whose first line says which run they belong to."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.runs.made_from import first_difference
from epi360.runs.whole_files import write_file

Row = Mapping[str, float | int | str]

# Nine digits: 1e-9 of an error is below what any method means, and files stay half as large.
_FORMATS: dict[str, Callable[[Any], str]] = {
    "float": "{:.9g}".format,
    "int": "{:d}".format,
    "str": str,
}
_TYPES: dict[str, Callable[[str], Any]] = {"float": float, "int": int, "str": str}


@dataclass(frozen=True)
class Fingerprint:
    """What determines the numbers of a part."""

    name: str
    protocol: str
    seed: int
    version: str  # of the package
    cell: str
    value: str  # ``repr`` of the cell's value
    settings: str  # what else the experiment depends on

    def difference(self, other: Mapping[str, Any]) -> str:
        """First difference to the header of a part, in words; "" where there is none."""
        different = first_difference(other, asdict(self))
        if different is None:
            return ""
        return f"{different.name} {different.before!r}, not {different.now!r}"


@dataclass(frozen=True)
class Trials:
    """Raw results of an experiment, one row a trial (or several)."""

    # (N,) by name; "cell" and "trial" come first.
    columns: dict[str, NDArray[Any]] = field(default_factory=dict)
    seconds: float = 0.0  # processor time of all parts together

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), []))

    def __getitem__(self, column: str) -> NDArray[Any]:
        return self.columns[column]

    def where(self, **equal: str | int | float) -> Trials:
        """Rows in which the named columns have the given values."""
        mask = np.ones(len(self), dtype=bool)
        for column, value in equal.items():
            mask &= self.columns[column] == value
        return Trials({name: values[mask] for name, values in self.columns.items()}, self.seconds)


def csv_bytes(heading: Iterable[str], rows: Iterable[Iterable[Any]]) -> bytes:
    """Content of a CSV file."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(heading)
    lines.writerows(rows)
    return text.getvalue().encode()


def write_part(path: Path, fingerprint: Fingerprint, rows: Sequence[Row], seconds: float) -> None:
    """Write the trials of a part; readers never see half of it."""
    if not rows:
        raise ValueError(f"a trial of {fingerprint.name} must give a row, got none")
    names = list(rows[0])
    uneven = next((row for row in rows if list(row) != names), None)
    if uneven is not None:
        raise ValueError(f"all rows of {fingerprint.name} must have {names}, got {list(uneven)}")
    kinds = {name: _kind([row[name] for row in rows]) for name in names}
    header = {**asdict(fingerprint), "seconds": round(seconds, 3), "columns": kinds}
    formats = [_FORMATS[kind] for kind in kinds.values()]
    lines = (
        [form(value) for form, value in zip(formats, row.values(), strict=True)] for row in rows
    )
    write_file(path, f"# {json.dumps(header)}\n".encode() + csv_bytes(names, lines))


def read_part(path: Path, fingerprint: Fingerprint) -> dict[str, Any] | None:
    """Header of a part; None if it is missing or damaged, ``ValueError`` if of another run."""
    try:
        with path.open(encoding="utf-8") as file:
            header: dict[str, Any] = json.loads(file.readline().removeprefix("# "))
    except (FileNotFoundError, ValueError):
        return None
    difference = fingerprint.difference(header)
    if difference:
        raise ValueError(
            f"{path.parent} keeps trials of another run ({difference}); give another --out or "
            "remove that folder"
        )
    return header


def join_parts(parts: Sequence[tuple[Path, Fingerprint]]) -> Trials:
    """Trials of several parts in the order given."""
    pieces: dict[str, list[NDArray[Any]]] = {}
    seconds = 0.0
    for path, fingerprint in parts:
        header = read_part(path, fingerprint) or {}
        seconds += header.get("seconds", 0.0)
        columns = _read_columns(path, header.get("columns", {}))
        if pieces and list(columns) != list(pieces):
            raise ValueError(f"{path} must have the columns {list(pieces)}, got {list(columns)}")
        for name, values in columns.items():
            pieces.setdefault(name, []).append(values)
    return Trials({name: np.concatenate(values) for name, values in pieces.items()}, seconds)


def _read_columns(path: Path, kinds: Mapping[str, str]) -> dict[str, NDArray[Any]]:
    with path.open(encoding="utf-8", newline="") as file:
        file.readline()
        lines = csv.reader(file)
        names = next(lines)
        values = list(zip(*lines, strict=True))
    return {
        name: np.array([_TYPES[kinds[name]](value) for value in column])
        for name, column in zip(names, values, strict=True)
    }


def _kind(values: Sequence[float | int | str]) -> str:
    if any(isinstance(value, str) for value in values):
        return "str"
    whole = all(isinstance(value, int | np.integer | np.bool_) for value in values)
    return "int" if whole else "float"
