# SPDX-License-Identifier: BSD-3-Clause
"""Folders of images: which files are images, and the order of their names."""

import os
import re
from pathlib import Path

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")


def existing_folder(folder: str | os.PathLike[str], what: str) -> Path:
    """Path of a folder; ``FileNotFoundError`` if it is missing, ``ValueError`` for a file."""
    path = Path(folder)
    if not path.exists():
        raise FileNotFoundError(f"{what} {path} does not exist")
    if not path.is_dir():
        raise ValueError(f"{what} {path} is a file, expected a folder")
    return path


def natural_order(path: Path) -> tuple[list[tuple[bool, int, str]], str]:
    """Sort key of a path by its name: digits as numbers, the rest as text."""
    parts = re.findall(r"\d+|\D+", path.stem)
    key = [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]
    return key, path.name
