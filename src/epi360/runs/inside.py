# SPDX-License-Identifier: BSD-3-Clause
"""Names from other people's files, which must not lead out of the folder that is written."""

from __future__ import annotations

from pathlib import Path, PurePath


def inside(folder: Path, name: str) -> Path:
    """Path of a named file in a folder or its sub-folders.

    Parameters
    ----------
    folder : path
        Folder that is written.
    name : str
        Path below it, with "/" between its parts.

    Raises
    ------
    ValueError
        If the name is absolute, goes up ("..") or names no file.
    """
    path = PurePath(name)
    if path.drive or path.root or ".." in path.parts or not path.parts:
        raise ValueError(
            f"the name {name!r} leads out of {folder}; names must be paths below the folder of the "
            'images, without ".."'
        )
    return folder / name
