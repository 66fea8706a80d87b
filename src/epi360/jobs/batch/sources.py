# SPDX-License-Identifier: BSD-3-Clause
"""Matches of many pairs: where they are, how they are read part by part, when they are wrong."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.upright import gravity_of
from epi360.interop.hloc import camera_of_image
from epi360.jobs.folder.given_cameras import read_given_cameras
from epi360.jobs.matching.check_keypoints import FEWEST_KEYPOINTS, check_inside
from epi360.runs import storage

Array = NDArray[np.float64]
Kind = Literal["parquet", "colmap", "hloc"]

_MAGIC: dict[Kind, bytes] = {
    "parquet": b"PAR1",
    "colmap": b"SQLite format 3\0",
    "hloc": b"\x89HDF\r\n\x1a\n",
}


@dataclass(frozen=True)
class MatchSource:
    """Where the matches are; plain values."""

    kind: Kind  # "colmap": a database; "hloc": a pair of HDF5 files
    path: str  # the Parquet file (path, or URL that fsspec understands), database or matches
    camera: str | None = None  # calibration FILE or FILE:NAME, for pixels
    features: str | None = None  # hloc's file of the key points
    pairs: str | None = None  # with hloc's matches: a text file of the pairs that are wanted
    pairs_per_part: int = 1000  # at most
    upright: bool = False  # all images are panoramas, or bearings in frames whose y axis is down

    def __post_init__(self) -> None:
        """Check the options."""
        if self.pairs_per_part < 1:
            raise ValueError(f"pairs_per_part must be 1 or more, got {self.pairs_per_part}")
        if self.kind != "parquet" and storage.is_remote(self.path):
            raise ValueError(
                f"{self.path}: databases and HDF5 files are read from this machine's disks; copy "
                "it, or use Parquet, which may be anywhere"
            )


def kind_of(path: str) -> Kind:
    """Kind of an input, by its first bytes."""
    with storage.open_read(path) as file:
        start = file.read(16)
    for kind, magic in _MAGIC.items():
        if start.startswith(magic):
            return kind
    raise ValueError(
        f"{path} must be a Parquet file, a COLMAP database or hloc's matches (HDF5), got "
        "something else"
    )


@dataclass(frozen=True, eq=False)
class PairMatches:
    """The pairs of one part: the row of the first in the input, names and bearings, one a pair."""

    first_row: int
    image1: list[str]
    image2: list[str]
    bearings1: list[Array]  # each (M, 3); NaN rows are missing
    bearings2: list[Array]

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.image1)


class OpenMatches(Protocol):
    """An input that is open, its schema checked."""

    @property
    def fingerprint(self) -> str:
        """Hash in which another input differs."""

    @property
    def part_sizes(self) -> list[int]:
        """Pairs in each part, in the order of the input."""

    @property
    def part_groups(self) -> list[int]:
        """Number of each part's group; to reach a part, those before it in the group are read."""

    def names(self) -> Iterator[tuple[Sequence[str], Sequence[str]]]:
        """Names of the first and second images, some pairs at a time, in order."""

    def read(self, parts: Sequence[int]) -> Iterator[PairMatches]:
        """Pairs of these parts, given in rising order, one part at a time."""


def pair_seed(seed: int, image1: str, image2: str) -> int:
    """Seed of a pair, in [0, 2^64): the same on every machine and in every order of the work.

    It is the first eight bytes of SHA-256 over the seed and the names, with their lengths before
    them so that no two pairs are written alike. The names in the other order have another seed.
    """
    names = (image1.encode(), image2.encode())
    text = b"%d %d %d " % (seed, len(names[0]), len(names[1])) + names[0] + names[1]
    return int.from_bytes(hashlib.sha256(text).digest()[:8], "big")


def parts_of(num_pairs: int, pairs_per_part: int) -> list[range]:
    """Rows of each part: all parts are of equal size, but the last may be smaller."""
    return [
        range(start, min(start + pairs_per_part, num_pairs))
        for start in range(0, num_pairs, pairs_per_part)
    ]


def check_rows(path: str, pairs: PairMatches) -> None:
    """Raise where a pair has unusable matches: bearings (M, 3), or pixels (M, 2) in their place."""
    for k in range(len(pairs)):
        views = pairs.bearings1[k], pairs.bearings2[k]
        where = f"{path}: row {pairs.first_row + k} ({pairs.image1[k]} {pairs.image2[k]})"
        if len(views[0]) != len(views[1]):
            raise ValueError(
                f"{where} must have as many matches in both images, got {len(views[0])} and "
                f"{len(views[1])}"
            )
        for view, array in enumerate(views, start=1):
            infinite = np.isinf(array)
            if infinite.any():
                raise ValueError(
                    f"{where} must be finite (NaN marks missing data), match "
                    f"{np.flatnonzero(infinite.any(axis=1))[0]} is infinite in image {view}"
                )
            # Counting all zeros costs a tenth of looking at the rows.
            may_be_zero = array.shape[1] == 3 and array.size - np.count_nonzero(array) >= 3
            if may_be_zero and not (is_set := array.any(axis=1)).all():
                raise ValueError(
                    f"{where} must have bearings of non-zero length, match "
                    f"{np.flatnonzero(~is_set)[0]} is zero in image {view}"
                )


def cameras_of(source: MatchSource) -> Mapping[str, Camera]:
    """Cameras of the file, or of the ``FILE:NAME``, that was given; none without."""
    return read_given_cameras(source.camera).cameras if source.camera else {}


def bearings_of(pixels: Array, camera: Camera, image: str, source: MatchSource) -> Array:
    """Bearings (N, 3) of the key points (N, 2) of an image.

    Raises ``ValueError`` where its images shall be upright and are no panoramas, or where there are
    many key points and they are no pixels of it, see `check_inside`.
    """
    if source.upright:
        gravity_of(camera, None, image)
    if len(pixels) >= FEWEST_KEYPOINTS:
        check_inside(pixels, camera, image)
    return camera.bearings_from_pixels(pixels)


def named_camera(image: str, size: tuple[int, int] | None, cameras: Mapping[str, Camera]) -> Camera:
    """Camera of an image by the name of it or of its folder; ValueError where it has none."""
    camera = camera_of_image(image, size, cameras)[1]
    if camera is None and not cameras:
        raise ValueError(f"{image} is not known to be a panorama; give its camera by --camera FILE")
    if camera is None:
        shape = "" if size is None else f" of {size[0]}x{size[1]} pixels"
        raise ValueError(
            f"{image}{shape} has no camera; it must be called like the image or its folder, or be "
            f"the only one and of its size, got {', '.join(cameras)}"
        )
    return camera
