# SPDX-License-Identifier: BSD-3-Clause
"""Which tool a file belongs to, by its content, or by its name if it is to be written."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from epi360.runs.input_files import read_beginning
from epi360.runs.whole_files import PathLike

Kind = Literal["reconstruction", "matches"]


@dataclass(frozen=True)
class Format:
    """A file format: its title in messages, its kind, and what it keeps beside that."""

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
    "opensfm-folder": Format(
        "OpenSfM project",
        "reconstruction",
        frozenset(("cameras", "points", "observations", "time stamps")),
    ),
    "nerfstudio": Format(
        "nerfstudio transforms", "reconstruction", frozenset(("cameras", "points"))
    ),
    "tum": Format("TUM trajectory", "reconstruction", frozenset(("time stamps",))),
    "colmap-database": Format(
        "COLMAP database", "matches", frozenset(("cameras", "poses of pairs", "rig", "descriptors"))
    ),
    "hloc": Format("hloc matches", "matches", frozenset(("descriptors",))),
}
SUFFIXES = {
    ".db": "colmap-database", ".h5": "hloc", ".hdf5": "hloc", ".txt": "tum", ".tum": "tum",
}  # fmt: skip
ARRAY_SUFFIXES = (".npz", ".npy", ".pt", ".pth", ".pkl", ".mat")
OWN_MATCHES = (
    "Python makes a COLMAP database of your own arrays of matches: see 'Matches of your own' in "
    "docs/existing_project.md"
)
MODEL_FILES = ("images.bin", "images.txt")
FIRST_MODEL = "sparse/0"  # in the output folder of `epi360 map`, and of COLMAP's own commands
OPENSFM_FILE = "reconstruction.json"
# OpenSfM's file is a list of reconstructions; people take one out of it.
ONE_RECONSTRUCTION = re.compile(rb'\{\s*"(cameras|shots|points|rig_cameras|reference_lla)"')
SQLITE, HDF5 = b"SQLite format 3\0", b"\x89HDF\r\n\x1a\n"
BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def format_of_file(path: PathLike) -> str:
    """Return the format of an existing file or folder by its content, a key of `FORMATS`.

    A folder whose model is in ``sparse/0``, such as the output of `epi360 map`, is a COLMAP model.
    """
    path = Path(path)
    if holds_opensfm_project(path) and not holds_colmap_model(path):
        return "opensfm-folder"
    if colmap_model_folder(path) is not None:
        return "colmap"
    if path.is_dir():
        raise ValueError(
            f"folder {path} must hold a COLMAP model (cameras, images and points3D), {FIRST_MODEL} "
            f"with one, or OpenSfM's {OPENSFM_FILE}"
        )
    try:
        start = read_beginning(path, 4096)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} does not exist") from None
    for name, magic in (("colmap-database", SQLITE), ("hloc", HDF5)):
        if start.startswith(magic):
            return name
    text = start.removeprefix(BYTE_ORDER_MARK).lstrip()
    if ONE_RECONSTRUCTION.match(text):
        return "opensfm"
    for name, bracket in (("opensfm", b"["), ("nerfstudio", b"{")):
        if text.startswith(bracket):
            return name
    if _is_trajectory(text):
        return "tum"
    own = f"; {OWN_MATCHES}" if path.suffix.lower() in ARRAY_SUFFIXES else ""
    raise ValueError(
        f"{path} is no file that can be converted: a COLMAP model (folder) or database, OpenSfM's "
        "reconstruction.json, nerfstudio's transforms.json, a TUM trajectory, or hloc's matches"
        f"{own}"
    )


def holds_colmap_model(folder: PathLike) -> bool:
    """Return whether a folder exists and has the files of a COLMAP model, text or binary."""
    return any((Path(folder) / name).is_file() for name in MODEL_FILES)


def colmap_model_folder(path: PathLike) -> Path | None:
    """Return where the COLMAP model of a folder is: itself or its ``sparse/0``; None without."""
    path = Path(path)
    return next((each for each in (path, path / FIRST_MODEL) if holds_colmap_model(each)), None)


def holds_opensfm_project(folder: PathLike) -> bool:
    """Return whether a folder exists and has the reconstruction of an OpenSfM project."""
    return (Path(folder) / OPENSFM_FILE).is_file()


def format_of_name(path: PathLike) -> str:
    """Return the format that a file is to have by its name, a key of `FORMATS`."""
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir() or not suffix:
        return "colmap"
    if suffix in SUFFIXES:
        return SUFFIXES[suffix]
    for name, word in (("nerfstudio", "transforms"), ("opensfm", "reconstruction")):
        if suffix == ".json" and word in path.name.lower():
            return name
    names = ", ".join(FORMATS)
    raise ValueError(f"the name {path.name} does not say its format; give it (--format): {names}")


def _is_trajectory(text: bytes) -> bool:
    """Whether the first row that is no comment has eight words and begins with a number."""
    for line in text.splitlines():
        words = line.split()
        if words and not line.startswith(b"#"):
            try:
                float(words[0])
            except ValueError:
                return False
            return len(words) == 8
    return False
