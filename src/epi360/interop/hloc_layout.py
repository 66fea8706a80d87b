# SPDX-License-Identifier: BSD-3-Clause
"""hloc's HDF5 files: their layout, and the names of images and pairs in them.

The layout is that of hloc's own code (github.com/cvg/Hierarchical-Localization:
extract_features.py, match_features.py, utils/parsers.py, utils/io.py). The features file has a
group for each image, with ``keypoints`` (N, 2), where the centre of the first pixel is (0, 0),
``descriptors`` (D, N) and ``scores`` (N,), by default in half precision, and ``image_size`` (width,
height). The matches file has a group for each pair. Its name is both image names with "-" for "/",
and "/" between them, or "_" in older files. Its ``matches0`` (N,) holds for each key point of image
1 the key point of image 2, or -1.
"""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360.runs.input_files import check_is_file

HLOC_TO_CONTINUOUS = 0.5  # hloc puts the centre of the first pixel at 0

LARGEST_DATASET = 2**28  # numbers, as many as in 2^20 descriptors of length 256

# The dataset that every group of either file has, and what such a file holds.
_KEYPOINTS, _MATCHES = "keypoints", "matches0"
_HOLDS = {_KEYPOINTS: "key points", _MATCHES: "matches"}

# For each pair the path of its group, and whether the group has the images in the other order.
PairGroups = dict[tuple[str, str], tuple[str, bool]]


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Yield an HDF5 file that is open for reading."""
    h5py = extra_library("h5py", extra="hloc", purpose="hloc's files")
    if not path.exists():
        raise FileNotFoundError(f"hloc file {path} does not exist")
    check_is_file(path)
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path} must be a whole HDF5 file of hloc: {reason}") from None
    with file:
        yield file


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn what h5py raises in a damaged file into a ``ValueError`` that names the file."""
    try:
        yield
    except (
        OSError, RuntimeError, LookupError, UnicodeError, OverflowError, TypeError, AttributeError,
    ) as error:  # fmt: skip
        reason = " ".join(str(error.args[0] if error.args else error).split())
        raise ValueError(f"{path} is damaged: {reason}") from None


def image_names(file: Any, path: Path) -> list[str]:
    """Return the paths of the groups with key points, sorted; they are the image names."""
    names = _groups_with(_KEYPOINTS, file, path, "extract local features again")
    if not names:
        raise ValueError(f"{path} has no images; extract local features again")
    return names


def pair_groups(file: Any, path: Path) -> list[str]:
    """Return the paths of the groups of a matches file, sorted."""
    return _groups_with(_MATCHES, file, path, "match again")


def own_group(file: Any, name: str, path: Path) -> str:
    """Return the path of a group, or raise ``ValueError`` where it lies in another file."""
    h5py = extra_library("h5py", extra="hloc", purpose="hloc's files")
    parts = name.split("/")
    for end in range(1, len(parts) + 1):
        part = "/".join(parts[:end])
        if isinstance(file.get(part, getlink=True), h5py.ExternalLink):
            raise ValueError(f"{path}: {part} lies in another file; copy it into this one")
    return name


def dataset(group: Any, name: str, path: Path) -> NDArray[Any] | None:
    """Return the content of a dataset of a group, or None if it has none."""
    h5py = extra_library("h5py", extra="hloc", purpose="hloc's files")
    with reading(path):
        if name not in group:
            return None
        is_elsewhere = isinstance(group.get(name, getlink=True), h5py.ExternalLink)
        member = None if is_elsewhere else group[name]
        if isinstance(member, h5py.Dataset):
            is_elsewhere = bool(member.external) or member.is_virtual
            # HDF5 reads zeros for what a file leaves out, so that a small file may claim any size.
            if not is_elsewhere and (member.size or 0) <= LARGEST_DATASET:
                return np.asarray(member[()])
    if is_elsewhere:
        raise ValueError(f"{path}: {group.name}/{name} lies in another file; copy it into this one")
    raise ValueError(
        f"{path}: {group.name}/{name} must be a dataset of {LARGEST_DATASET} numbers at most"
    )


def _groups_with(needed: str, file: Any, path: Path, remedy: str) -> list[str]:
    """Paths of the groups with a dataset of this name; every dataset must lie in one of them."""
    names: list[str] = []
    with reading(path):
        file.visit(names.append)  # it follows no links, and so ends also if a file holds itself
        if not all(isinstance(name, str) for name in names):
            raise KeyError("a name is no Unicode text")
    groups = {name.rpartition("/")[0] for name in names}
    datasets = [name.rpartition("/") for name in names if name not in groups]
    complete = {group for group, _, name in datasets if name == needed}
    held = _HOLDS.keys() & {name for _, _, name in datasets}
    if held and not complete:
        raise ValueError(
            f"{path} holds {_HOLDS[held.pop()]}, not {_HOLDS[needed]}; were the two files swapped?"
        )
    for group, _, name in datasets:
        if group not in complete:
            raise ValueError(
                f"{path}: {group or 'the file'} must have {needed!r}, got {name}; {remedy}"
            )
    return sorted(complete)


def listed_pairs(
    groups: Collection[str], images: Collection[str], pairs: Iterable[tuple[str, str]]
) -> PairGroups:
    """Return the group of each pair of a list."""
    existing = frozenset(groups)
    group_of_pair: PairGroups = {}
    owner: dict[str, tuple[str, str]] = {}
    for pair in pairs:
        what = f"pair {' '.join(pair)}"
        for image in pair:
            if image not in images:
                raise ValueError(f"{what} is listed, but the features have no image {image}")
        paths = [(path, swapped) for path, swapped in _possible_groups(pair) if path in existing]
        if not paths:
            raise ValueError(
                f"{what} is listed, but has no matches; match with the same pairs file"
            )
        path, swapped = paths[0]
        if path in owner:
            raise ValueError(
                f"{what} and the pair {' '.join(owner[path])} are both called {path!r} in the "
                "matches, which put '-' for '/'; rename the images"
            )
        owner[path] = pair
        group_of_pair[pair] = path, swapped
    return group_of_pair


def resolved_pairs(groups: Collection[str], images: Collection[str]) -> PairGroups:
    """Return the group of each pair, if the names of the images leave no doubt."""
    by_flat_name: dict[str, list[str]] = {}
    for image in images:
        by_flat_name.setdefault(_flat(image), []).append(image)
    group_of_pair: PairGroups = {}
    for path in groups:
        pairs = _possible_pairs(path, by_flat_name)
        if not pairs:
            raise ValueError(f"the features have no two images of which the pair is {path!r}")
        if len(pairs) > 1:
            raise ValueError(
                f"{path!r} may be the pair {' '.join(pairs[0])} or {' '.join(pairs[1])}; "
                "give the pairs file (--pairs)"
            )
        if pairs[0] in group_of_pair or pairs[0][::-1] in group_of_pair:
            raise ValueError(
                f"the pair {' '.join(pairs[0])} is there twice; give the pairs file (--pairs)"
            )
        group_of_pair[pairs[0]] = path, False
    return group_of_pair


def group_of(image1: str, image2: str) -> str:
    """Return the path of the group of a pair."""
    return f"{_flat(image1)}/{_flat(image2)}"


def _flat(image: str) -> str:
    return image.replace("/", "-")


def _possible_groups(pair: tuple[str, str]) -> Iterator[tuple[str, bool]]:
    """Paths that the group of a pair may have, and whether they swap it, likeliest first."""
    first, second = map(_flat, pair)
    for separator in "/_":
        yield f"{first}{separator}{second}", False
        yield f"{second}{separator}{first}", True


def _possible_pairs(path: str, by_flat_name: dict[str, list[str]]) -> list[tuple[str, str]]:
    separator = "/" if "/" in path else "_"
    parts = path.split(separator)
    return [
        (image1, image2)
        for i in range(1, len(parts))
        for image1 in by_flat_name.get(separator.join(parts[:i]), ())
        for image2 in by_flat_name.get(separator.join(parts[i:]), ())
    ]
