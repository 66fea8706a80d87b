# SPDX-License-Identifier: BSD-3-Clause
"""Names from other people's files, which must not lead out of the folder that is written."""

from pathlib import Path, PurePath


def inside(folder: Path, name: str) -> Path:
    """Path of a named file in a folder; ValueError where the name is absolute or goes up ("..")."""
    path = PurePath(name)
    if path.drive or path.root or ".." in path.parts or not path.parts:
        raise ValueError(
            f"the name {name!r} leads out of {folder}; names must be paths below the folder of the "
            'images, without ".."'
        )
    return folder / name
