# SPDX-License-Identifier: BSD-3-Clause
"""The files of a folder and its sub-folders, in natural order."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from epi360.image_folders import natural_order

# Folders that match, map and the cubemap export wrote: their pictures are no input.
OUTPUT_RECORDS = ("epi360-match.json", "mapping.json", "cubemap.json")


def files_below(folder: Path) -> Iterator[tuple[str, Path]]:
    """Name and path of each file: those of a folder first, then its sub-folders one by one.

    Hidden files and folders are left out, and so are sub-folders that this package wrote. Linked
    folders are entered once. Names have "/" between their parts and are spelt as on disk.
    """
    try:
        yield from _files(folder, "", set())
    except OSError as error:
        raise ValueError(f"folder {error.filename} cannot be read: {error.strerror}") from None


def _files(folder: Path, prefix: str, entered: set[tuple[int, int]]) -> Iterator[tuple[str, Path]]:
    status = folder.stat()
    identity = status.st_dev, status.st_ino
    visible = [path for path in folder.iterdir() if not path.name.startswith(".")]
    is_output = any(path.name in OUTPUT_RECORDS for path in visible)
    if identity in entered or (prefix and is_output):
        return
    entered.add(identity)
    visible.sort(key=natural_order)
    folders = [path for path in visible if path.is_dir()]
    yield from ((prefix + path.name, path) for path in visible if not path.is_dir())
    for path in folders:
        yield from _files(path, f"{prefix}{path.name}/", entered)
