# SPDX-License-Identifier: BSD-3-Clause
"""Which tool a file belongs to: found from its content, or from the name it is to have."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Kind = Literal["reconstruction", "matches"]


@dataclass(frozen=True)
class Format:
    """A file format of a tool.

    Attributes
    ----------
    title : str
        What a message calls it.
    kind : "reconstruction" or "matches"
        What is in it.
    keeps : frozenset of str
        What it has a place for beside poses, or key points and matches.
    """

    title: str
    kind: Kind
    keeps: frozenset[str]


_COLMAP_MODEL = frozenset(("cameras", "points", "observations", "rigs"))
FORMATS = {
    "colmap": Format("COLMAP model", "reconstruction", _COLMAP_MODEL),
    "colmap-text": Format("COLMAP model, text", "reconstruction", _COLMAP_MODEL),
    "opensfm": Format(
        "OpenSfM reconstruction", "reconstruction", frozenset(("cameras", "points", "time stamps"))
    ),
    "nerfstudio": Format(
        "nerfstudio transforms", "reconstruction", frozenset(("cameras", "points"))
    ),
    "tum": Format("TUM trajectory", "reconstruction", frozenset(("time stamps",))),
    "colmap-database": Format(
        "COLMAP database", "matches", frozenset(("cameras", "poses of pairs", "rig"))
    ),
    "hloc": Format("hloc matches", "matches", frozenset(("descriptors",))),
}
SUFFIXES = {
    ".db": "colmap-database", ".h5": "hloc", ".hdf5": "hloc", ".txt": "tum", ".tum": "tum",
}  # fmt: skip
MODEL_FILES = ("images.bin", "images.txt")
SQLITE, HDF5 = b"SQLite format 3\0", b"\x89HDF\r\n\x1a\n"
BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def format_of_file(path: str | os.PathLike[str]) -> str:
    """Format of a file or folder that is there, from its content.

    Parameters
    ----------
    path : path-like
        Any of `FORMATS`.

    Returns
    -------
    name : str
        Key of `FORMATS`; "colmap" for both forms of a model. Whether the rest of the file fits is
        left to its reader.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is none of them.
    """
    path = Path(path)
    if holds_colmap_model(path):
        return "colmap"
    if path.is_dir():
        raise ValueError(f"folder {path} must hold a COLMAP model: cameras, images and points3D")
    try:
        with path.open("rb") as file:
            start = file.read(4096)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist") from None
    for name, magic in (("colmap-database", SQLITE), ("hloc", HDF5)):
        if start.startswith(magic):
            return name
    text = start.removeprefix(BYTE_ORDER_MARK).lstrip()
    for name, bracket in (("opensfm", b"["), ("nerfstudio", b"{")):
        if text.startswith(bracket):
            return name
    if _is_trajectory(text):
        return "tum"
    raise ValueError(
        f"{path} is no file that can be converted: a COLMAP model (folder) or database, OpenSfM's "
        "reconstruction.json, nerfstudio's transforms.json, a TUM trajectory, or hloc's matches"
    )


def holds_colmap_model(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder has the files of a COLMAP model, text or binary.

    Parameters
    ----------
    folder : path-like
        It need not exist.
    """
    return any((Path(folder) / name).is_file() for name in MODEL_FILES)


def format_of_name(path: str | os.PathLike[str]) -> str:
    """Format that a file is to have, from its name.

    Parameters
    ----------
    path : path-like
        ``*.db``: COLMAP database; ``*.h5``: hloc matches; ``*.txt``, ``*.tum``: TUM trajectory;
        ``transforms*.json``: nerfstudio; ``reconstruction*.json``: OpenSfM; without an extension,
        or a folder: COLMAP model.

    Returns
    -------
    name : str
        Key of `FORMATS`.

    Raises
    ------
    ValueError
        If the name does not say.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir() or not suffix:
        return "colmap"
    if suffix in SUFFIXES:
        return SUFFIXES[suffix]
    for name, beginning in (("nerfstudio", "transforms"), ("opensfm", "reconstruction")):
        if suffix == ".json" and path.name.lower().startswith(beginning):
            return name
    known = ", ".join(FORMATS)
    raise ValueError(f"the name {path.name} does not say its format; give it (--format): {known}")


def _is_trajectory(text: bytes) -> bool:
    """Whether the first row that is no comment has eight words, the first one a number."""
    for line in text.splitlines():
        words = line.split()
        if words and not line.startswith(b"#"):
            try:
                float(words[0])
            except ValueError:
                return False
            return len(words) == 8
    return False
