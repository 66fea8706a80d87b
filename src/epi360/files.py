# SPDX-License-Identifier: BSD-3-Clause
"""Files written whole or not at all, and folders of images in the order of their names."""

from __future__ import annotations

import os
from pathlib import Path

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")


def write_file(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file under a temporary name beside it and rename: readers never see half of it.

    Parameters
    ----------
    path : str or path
        Written or replaced; a symbolic link is followed, a device or pipe is written to.
    data : bytes
        Content.

    Raises
    ------
    OSError
        If the folder is missing or not writable.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():  # renaming onto /dev/null would replace the device
        path.write_bytes(data)
        return
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(data)
        os.replace(temporary, path)
    except OSError as error:
        if error.errno is not None:  # name what was asked for, not the temporary file
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise
    finally:
        temporary.unlink(missing_ok=True)


def existing_folder(folder: str | os.PathLike[str], what: str) -> Path:
    """Path of a folder; ``FileNotFoundError`` or ``ValueError`` names it where it is none."""
    path = Path(folder)
    if not path.exists():
        raise FileNotFoundError(f"{what} {path} does not exist")
    if not path.is_dir():
        raise ValueError(f"{what} {path} is a file, expected a folder")
    return path


def natural_order(path: Path) -> tuple[list[tuple[bool, int, str]], str]:
    """Sort key of a path by its name: digits as numbers, the rest as text."""
    parts: list[str] = []
    for character in path.stem:
        if parts and parts[-1][-1].isdecimal() == character.isdecimal():
            parts[-1] += character
        else:
            parts.append(character)
    key = [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]
    return key, path.name
