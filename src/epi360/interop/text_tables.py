# SPDX-License-Identifier: BSD-3-Clause
"""Tables in text files; an error message names the bad row by its file and line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.runs.input_files import read_text

UNIT_TOLERANCE = 1e-2  # of a quaternion's length; files hold four digits or more


@dataclass(frozen=True)
class Table:
    """Rows of a text file, not yet taken for numbers, and the line of each as an editor counts.

    ``header`` is the first line if that is a comment or starts with a letter, else "".
    """

    path: Path
    columns: tuple[str, ...]
    header: str
    lines: tuple[int, ...]
    cells: tuple[list[str], ...]

    def integers(self, column: int) -> NDArray[np.int64]:
        """Whole numbers of a column; ``ValueError`` where a cell is none."""
        numbers = np.empty(len(self.cells), np.int64)
        for index, row in enumerate(self.cells):
            try:
                numbers[index] = int(row[column])
            except (ValueError, OverflowError):
                wanted = f"a whole number as {self.columns[column]}"
                raise self.error(index, wanted) from None
        return numbers

    def floats(self, start: int, stop: int) -> NDArray[np.float64]:
        """Finite numbers of some columns; ``ValueError`` where a cell is none."""
        numbers = np.empty((len(self.cells), stop - start))
        for index, row in enumerate(self.cells):
            try:
                numbers[index] = [float(cell) for cell in row[start:stop]]
            except ValueError:
                numbers[index] = np.nan
            if not np.isfinite(numbers[index]).all():
                raise self.error(index, f"the numbers {','.join(self.columns[start:stop])}")
        return numbers

    def quaternions(self, start: int) -> NDArray[np.float64]:
        """Four columns as quaternions of unit length; ``ValueError`` where they are far from it."""
        numbers = self.floats(start, start + 4)
        with np.errstate(over="ignore"):  # infinite is far from one
            lengths = np.linalg.norm(numbers, axis=1)
        bad = np.flatnonzero(np.abs(lengths - 1) > UNIT_TOLERANCE)
        if len(bad):
            raise self.error(bad[0], f"a unit quaternion {','.join(self.columns[start:])}")
        return np.asarray(numbers / lengths[:, None])

    def error(self, index: int, wanted: str) -> ValueError:
        """Exception that names the row with this index."""
        row = ",".join(self.cells[index])
        return ValueError(f"row {self.lines[index]} of {self.path} must hold {wanted}, got {row!r}")


def read_table(path: Path, columns: tuple[str, ...], delimiter: str | None) -> Table:
    """Rows of a text file without empty lines, "#" comments and header; None is any white space."""
    names = ",".join(columns)
    try:
        lines = read_text(path).splitlines()
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist; its rows must hold {names}") from None
    except (UnicodeDecodeError, OSError):
        raise ValueError(f"{path} must be a text file with rows {names}") from None
    header = lines[0] if lines and (lines[0][:1] == "#" or lines[0][:1].isalpha()) else ""
    start = 1 if header else 0
    kept = [
        (number, [cell.strip() for cell in line.split(delimiter)])
        for number, line in enumerate(lines[start:], start=start + 1)
        if line.strip() and not line.startswith("#")
    ]
    table = Table(path, columns, header, tuple(n for n, _ in kept), tuple(row for _, row in kept))
    if not kept:
        raise ValueError(f"{path} has no rows; it must hold {names}")
    for index, row in enumerate(table.cells):
        if len(row) != len(columns):
            raise table.error(index, f"{len(columns)} values {names}")
    return table
