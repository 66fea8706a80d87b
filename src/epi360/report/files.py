# SPDX-License-Identifier: BSD-3-Clause
"""Output files: checked before the work, complete or absent after it."""

import os
import stat
from collections.abc import Mapping
from pathlib import Path

from epi360.runs.whole_files import PathLike

FIGURE_FORMATS = ("png", "jpg", "jpeg", "webp", "pdf", "svg")


def check_writable(path: PathLike, *, name: str = "path") -> None:
    """Raise if a file could not be written there, so that long work is not lost at its end.

    It may exist, and ``name`` is what the message calls it. ``ValueError`` if the path is a folder
    or a read-only file, or its folder is missing or not writable.
    """
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{name} must be a file, {path} is a folder")
    if not path.parent.is_dir():
        raise ValueError(f"{name}: folder {path.parent} does not exist; create it first")
    if path.is_file() and not path.stat().st_mode & stat.S_IWUSR:
        raise ValueError(f"{name}: {path} is read-only; choose another name")
    target = path if path.exists() and not path.is_file() else path.parent
    if not os.access(target, os.W_OK):
        raise ValueError(f"{name}: no permission to write to {target}")


def check_distinct(outputs: Mapping[str, Path], inputs: Mapping[str, Path]) -> None:
    """Raise ``ValueError`` if an output is an input or another output, also by way of a link."""
    taken = {os.path.realpath(path): name for name, path in inputs.items()}
    for name, path in outputs.items():
        other = taken.setdefault(os.path.realpath(path), name)
        if other != name:
            raise ValueError(f"{name} must not be the file of {other}, got {path} for both")


def check_figure_name(path: PathLike, *, name: str = "path") -> None:
    """Raise ``ValueError`` if the extension names no format that figures are written in."""
    if Path(path).suffix.lower().removeprefix(".") not in FIGURE_FORMATS:
        known = ", ".join(f".{suffix}" for suffix in FIGURE_FORMATS)
        raise ValueError(f"{name} must end in one of {known}, got {os.fspath(path)!r}")


def check_report_name(path: PathLike, *, name: str = "path") -> None:
    """Raise ``ValueError`` unless the extension says that a browser opens the file."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise ValueError(f"{name} must end in .html, got {os.fspath(path)!r}")
