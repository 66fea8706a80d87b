# SPDX-License-Identifier: BSD-3-Clause
"""Tables of a COLMAP database, read without touching the file.

sqlite3 reads them, because pycolmap writes to the file when it opens a database: it upgrades the
tables of an older COLMAP, and fails if the file is read-only. Tables and blobs are described in
https://colmap.github.io/database.html.
"""

import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.calibration import fields
from epi360.runs.whole_files import PathLike

Blob = tuple[int, int, bytes | None]  # rows, columns, data

NEEDED_COLUMNS = {
    "cameras": {"camera_id", "model", "width", "height", "params"},
    "images": {"image_id", "name", "camera_id"},
    "keypoints": {"image_id", "rows", "cols", "data"},
    "descriptors": {"image_id", "rows", "cols", "data"},
    "matches": {"pair_id", "rows", "cols", "data"},
    "two_view_geometries": {"pair_id", "rows", "cols", "data", "config"},
}
USED_TABLES = {*NEEDED_COLUMNS, "rigs", "rig_sensors", "frames", "frame_data"}
# SQLite does not check types. Columns that are in neither of these sets hold integers.
TEXTS = {"name"}
BLOBS = {"params", "data", "E", "qvec", "tvec", "sensor_from_rig"}  # bytes or nothing
LONGEST_STEP_S = 120.0  # from one row to the next; a second even where SQLite has to sort
LONGEST_REASON = 200  # SQLite's messages may quote a whole table


class ColmapTables:
    """COLMAP database opened read-only, for one thread; use it in a ``with``."""

    def __init__(self, path: PathLike) -> None:
        self.path = Path(path)
        self._connection = _connect(self.path)
        self._num_bytes = sum(file.stat().st_size for file in _files(self.path))
        self._deadline = 0.0
        self._connection.set_progress_handler(self._is_late, 1_000_000)
        try:
            self._check_tables()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def rows(self, query: str, *values: Any) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of an SQL query; raise ``ValueError`` for damage or a wrong type."""
        try:
            self._deadline = time.monotonic() + LONGEST_STEP_S
            cursor = self._connection.execute(query, values)
            columns = [(name, *_type_of(name)) for name, *_ in cursor.description]
            for count, row in enumerate(cursor):
                if count > self._num_bytes:  # damaged pages may lead back to each other
                    raise self.error("it has more rows than bytes")
                self._deadline = time.monotonic() + LONGEST_STEP_S
                for value, (name, kind, words) in zip(row, columns, strict=True):
                    if not isinstance(value, kind):
                        got = fields.shortened(value)
                        raise self.error(f"column {name} must hold {words}, got {got}")
                yield row
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            reason = " ".join(str(error).split())[:LONGEST_REASON]
            raise self.error(f"it cannot be read: {reason}") from None

    def has_columns(self, table: str, *columns: str) -> bool:
        """Return whether the database has these columns, which older ones may lack."""
        query = "SELECT name FROM pragma_table_info(?)"
        return {name for (name,) in self.rows(query, table)} >= set(columns)

    def _check_tables(self) -> None:
        """Raise for a view in place of a table: it may compute its rows without end."""
        query = "SELECT name FROM sqlite_master WHERE type = 'view' OR sql LIKE 'CREATE VIRTUAL%'"
        for (name,) in self.rows(query):
            if name.lower() in USED_TABLES:
                raise self.error(f"{name} must be a plain table, got a view or a virtual table")
        for table, columns in NEEDED_COLUMNS.items():
            if not self.has_columns(table, *columns):
                raise self.error(
                    f"it must have a table {table} with {', '.join(sorted(columns))}; "
                    "is it a database of COLMAP?"
                )

    def _is_late(self) -> bool:
        return time.monotonic() > self._deadline

    def array(self, blob: Blob, dtype: Any, what: str) -> NDArray[Any]:
        """Return the array of (rows, cols, data); an empty one has two columns."""
        num_rows, num_columns, data = blob
        if num_rows == 0:
            return np.zeros((0, 2), dtype)
        expected = num_rows * num_columns * np.dtype(dtype).itemsize
        if num_rows < 0 or len(data or b"") != expected:
            raise self.error(f"{what} must be {expected} bytes, got {len(data or b'')}")
        return np.frombuffer(data or b"", dtype).reshape(num_rows, num_columns)

    def error(self, what: str) -> ValueError:
        """Return an error that names the database."""
        return ValueError(f"COLMAP database {self.path}: {what}")


def _type_of(column: str) -> tuple[Any, str]:
    if column in TEXTS:
        return str, "text"
    return (bytes | None, "bytes") if column in BLOBS else (int, "an integer")


def _connect(path: Path) -> sqlite3.Connection:
    """Read-only connection to a file that is not truncated."""
    if not path.exists():
        raise FileNotFoundError(f"COLMAP database {path} does not exist")
    if not path.is_file():
        raise ValueError(f"COLMAP database {path} must be a file")
    # A writer or a crash may have left changes in a second file. Only SQLite's usual mode sees
    # them, and it needs a writable folder; "immutable" needs none and leaves no file behind.
    pending = any(file.stat().st_size for file in _files(path)[1:])
    if not pending:
        _check_length(path)
    options = "mode=ro" if pending else "mode=ro&immutable=1"
    try:
        return sqlite3.connect(f"{path.resolve().as_uri()}?{options}", uri=True)
    except sqlite3.DatabaseError as error:
        raise ValueError(f"COLMAP database {path} cannot be opened: {error}") from None


def _files(path: Path) -> list[Path]:
    """The file, and those beside it with changes that are not in it yet."""
    beside = [Path(f"{path.resolve()}{end}") for end in ("-wal", "-journal")]
    return [path, *(file for file in beside if file.is_file())]


def _check_length(path: Path) -> None:
    """Raise unless the file is as long as its header says (https://sqlite.org/fileformat.html)."""
    # SQLite notices a truncated file only when it reads there; its own check reads the whole file.
    with path.open("rb") as file:
        header = file.read(100)
    if not header.startswith(b"SQLite format 3\0"):
        raise ValueError(f"COLMAP database {path} must be an SQLite file, got something else")
    page_size = int.from_bytes(header[16:18], "big")
    length = int.from_bytes(header[28:32], "big") * (65536 if page_size == 1 else page_size)
    is_valid = len(header) < 100 or header[24:28] == header[92:96]  # an old SQLite leaves it wrong
    size, expected = path.stat().st_size, max(100, length * is_valid)
    if size < expected:
        raise ValueError(f"COLMAP database {path} is truncated: it has {size} of {expected} bytes")
