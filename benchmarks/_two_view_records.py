# SPDX-License-Identifier: BSD-3-Clause
"""Raw results of the two-view benchmark: one row a problem and method, appended and resumed."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import subprocess
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import epi360
from epi360 import _core

_FIRST_LINE = "# made by "


@dataclass(frozen=True)
class Row:
    """One method on one problem; NaN where there is no error or no covariance."""

    cell: str
    problem: int
    method: str
    rotation_error_deg: float
    translation_error_deg: float
    best_error_deg: float  # larger error of the best of the pose and its alternatives
    accepted: bool
    has_warnings: bool
    status: str
    normalised_squared_error: float
    seconds: float
    cpu_seconds: float  # of the process: other work on the machine counts less

    @property
    def key(self) -> tuple[str, int, str]:
        """What a row is found by."""
        return self.cell, self.problem, self.method


class RawTable:
    """Rows in a CSV file that a stopped run leaves complete up to the last problem.

    Raises
    ------
    ValueError
        If the file exists and was made by another program, version of a peer, or seed.
    """

    def __init__(self, path: Path, fingerprint: str) -> None:
        self.path = path
        self.rows: dict[tuple[str, int, str], Row] = {}
        if path.exists():
            self._load(fingerprint)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            header = ",".join(field.name for field in fields(Row))
            path.write_text(f"{_FIRST_LINE}{fingerprint}\n{header}\n", encoding="utf-8")

    def append(self, rows: Iterable[Row]) -> None:
        """Add the rows of one problem in one write."""
        text = io.StringIO()
        for row in rows:
            self.rows[row.key] = row
            csv.writer(text, lineterminator="\n").writerow(astuple(row))
        with self.path.open("ab", buffering=0) as file:
            file.write(text.getvalue().encode())

    def _load(self, fingerprint: str) -> None:
        data = self.path.read_bytes()
        whole = data[: data.rfind(b"\n") + 1]
        first, _, rest = whole.decode().partition("\n")
        if first != _FIRST_LINE + fingerprint:
            raise ValueError(
                f"{self.path} must be made by {fingerprint!r} to go on with it, it was by "
                f"{first.removeprefix(_FIRST_LINE)!r}: give --fresh or another --out"
            )
        if len(whole) < len(data):  # the last write was cut
            os.truncate(self.path, len(whole))
        for record in csv.DictReader(io.StringIO(rest)):
            row = _row(record)
            self.rows[row.key] = row


def _row(record: dict[str, str]) -> Row:
    return Row(
        cell=record["cell"],
        problem=int(record["problem"]),
        method=record["method"],
        rotation_error_deg=float(record["rotation_error_deg"]),
        translation_error_deg=float(record["translation_error_deg"]),
        best_error_deg=float(record["best_error_deg"]),
        accepted=record["accepted"] == "True",
        has_warnings=record["has_warnings"] == "True",
        status=record["status"],
        normalised_squared_error=float(record["normalised_squared_error"]),
        seconds=float(record["seconds"]),
        cpu_seconds=float(record["cpu_seconds"]),
    )


def package_commit() -> str:
    """Commit of the imported epi360, ``-dirty`` if it differs, or ``unknown``."""
    command = ["git", "--no-optional-locks", "describe", "--always", "--dirty", "--exclude=*"]
    folder = Path(epi360.__file__).parent
    try:
        answer = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return answer.stdout.strip()


def package_digest() -> str:
    """Twelve digits that change with the estimator, the scenes or the problems.

    The native module, the rooms that the benchmark uses and the benchmark's own problems.
    """
    package, here = Path(epi360.__file__).parent, Path(__file__).parent
    # Where the package is installed to be edited, the native module lies elsewhere.
    files = [Path(_core.__file__), *package.glob("*.py")]
    files += [here / f"_two_view_{name}.py" for name in ("problems", "records")]
    files += package.parent.glob("epi360_paper/paper_ransac.py")
    for room in ("cameras", "epipolar", "estimation", "synthetic"):
        files += package.glob(f"{room}/**/*.py")
    digest = hashlib.sha256()
    for path in sorted(files, key=lambda path: path.name):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:12]
