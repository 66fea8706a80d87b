# SPDX-License-Identifier: BSD-3-Clause
"""The result of `epi360 match`: which images and pairs of its output folder belong to it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import cache
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import load_cameras
from epi360.cameras.calibration.own import camera_record
from epi360.features.detection import root_sift
from epi360.features.matching import rounded_descriptors
from epi360.interop import MatchGraph
from epi360.interop.match_graph import REFUSED
from epi360.jobs.folder.feature_cache import COLORS
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.records.match_store import (
    CAMERAS,
    FEATURES,
    IMAGES,
    IMPLIED_PAIRS,
    PAIRS,
    Keys,
    Verdict,
    pair_of_part,
    part_arrays,
)
from epi360.jobs.records.stored_graph import StoredImages, StoredPairs
from epi360.poses import Pose
from epi360.runs.arrays import Arrays, read_arrays
from epi360.runs.input_files import as_file
from epi360.runs.inside import inside
from epi360.runs.made_from import read_record, write_record
from epi360.runs.remote_path import AnyPath, RemotePath, path_of

Colors = dict[str, NDArray[np.uint8]]


def write_index(
    folder: AnyPath,
    images: ImageSet,
    keys: Mapping[str, str],
    pairs: Iterable[tuple[str, str]],
    level: Level | None = None,
    confirmed: Sequence[tuple[str, str]] = (),
    refused: Sequence[tuple[str, str]] = (),
    implied: str = "",
) -> None:
    """Say which images and pairs are the result: a run is complete.

    ``keys`` are those of the key points of each readable image by its name, ``pairs`` the names of
    the images of each finished pair, in order. In a level folder, some pairs also have a verdict
    with the prior of ``level``; of the ``confirmed`` ones the doubted pose is right. The matches of
    the ``refused`` ones agree with a pose, and other pairs speak against it. ``implied`` is the
    part of those with another pose than the first one.
    """
    cameras = {name: camera_record(camera) for name, camera in images.cameras.items()}
    listed = [
        {"name": image.name, "camera": image.camera, "frame": image.frame, "key": keys[image.name]}
        for image in images.images
        if image.name in keys
    ]
    rig = {name: pose.matrix().tolist() for name, pose in images.cam_from_rig.items()}
    (folder / IMAGES).unlink(missing_ok=True)  # the old one does not go with the new cameras
    write_record(folder / CAMERAS, {"cameras": cameras})
    index = {
        "images": listed,
        "cam_from_rig": rig,
        "pairs": [list(pair) for pair in pairs],
        "refused": [list(pair) for pair in refused],
    }
    if level is not None:
        index["level"] = vars(level)
    if confirmed:
        index["confirmed"] = [list(pair) for pair in confirmed]
    if implied:
        index["implied"] = implied
    write_record(folder / IMAGES, index)


def names_in_index(folder: AnyPath) -> set[str]:
    """Names of the images of a complete run; none where there is none, or a damaged one."""
    try:
        index = read_record(folder / IMAGES, remedy="")
        return {str(image["name"]) for image in index["images"]} if index else set()
    except (KeyError, TypeError, ValueError):
        return set()


def load_matches(folder: str | PathLike[str] | RemotePath, *, by_others: bool = True) -> MatchGraph:
    """Images, key points and verified pairs that `match_images` left in a folder, or behind a URL.

    Every pair has a geometry: look at its status. It is "ok" where `match_images` has accepted the
    pair. Some of these have a pose that other pairs confirm or imply, or a second one; others,
    whose own matches agree with a pose that other pairs speak against, are "refused". If
    ``by_others`` is false, all have what is found from their own matches.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or it holds no complete run.
    ValueError
        If a file is damaged, or an earlier epi360 made it, which did not keep what it refused.
    """
    return _load(path_of(folder), None, by_others=by_others, mark_refused=by_others)


def descriptors_of(folder: Path) -> Callable[[str], NDArray[np.float32]]:
    """Return what reads the descriptors of an image of `load_matches`: RootSIFT as it is matched.

    They are read when they are asked for, because those of a thousand images take 5 GB.
    """
    folder = Path(folder)

    @cache
    def keys() -> dict[str, str]:
        index = read_record(folder / IMAGES, remedy=_AGAIN) or {}
        return {image["name"]: image["key"] for image in index["images"]}

    def descriptors(name: str) -> NDArray[np.float32]:
        return rounded_descriptors(root_sift(_arrays_of(folder, name, keys()[name])["descriptors"]))

    return descriptors


def load_matches_and_colors(folder: Path) -> tuple[MatchGraph, Colors]:
    """What `load_matches` gives, and the RGB of the key points of each image by its name.

    Refused pairs keep the status of their own matches: a map has its own rule about them.
    """
    colors: Colors = {}
    return _load(path_of(folder), colors, by_others=True, mark_refused=False), colors


def _load(
    folder: AnyPath, colors: Colors | None, *, by_others: bool, mark_refused: bool
) -> MatchGraph:
    """Graph of a folder; its colours are added to those given."""
    if not (folder / IMAGES).is_file():
        raise FileNotFoundError(
            f"{folder} holds no complete result of epi360 match; run it with this --output first"
        )
    with as_file(folder / CAMERAS) as file:
        cameras = load_cameras(file)
    try:
        index = json.loads((folder / IMAGES).read_bytes())
        keys = {image["name"]: image["key"] for image in index["images"]}
        wanted = [((name1, name2), (keys[name1], keys[name2])) for name1, name2 in index["pairs"]]
        rig = {name: Pose.from_matrix(matrix) for name, matrix in index["cam_from_rig"].items()}
        listed = [(image["name"], image["camera"], image["frame"]) for image in index["images"]]
        level = Level(**index["level"]) if "level" in index else None
        others = index if by_others else {}
        told = {(name1, name2): "ok" for name1, name2 in others.get("confirmed", ())}
        if mark_refused:
            told |= {(name1, name2): REFUSED for name1, name2 in index.get("refused", ())}
        implied = str(others.get("implied", ""))
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{folder / IMAGES} is damaged: {error}; {_AGAIN}") from None
    if mark_refused and "refused" not in index:
        raise ValueError(
            f"{folder} does not say which pairs were refused, for an earlier epi360 made it; "
            "run epi360 match, or map, with this --output again, it uses what is there"
        )
    images = StoredImages()
    for name, camera, frame in listed:
        arrays = _arrays_of(folder, name, keys[name])
        images.add(name, camera, frame, arrays["pixels"])
        if colors is not None:
            colors[name] = arrays[COLORS]
    store = StoredPairs()
    needed = {keys_of_pair for _, keys_of_pair in wanted}
    places = _places(folder, store, needed, level)
    if implied:
        places.update(_implied_places(folder, store, needed, implied))
    for names, keys_of_pair in wanted:
        if keys_of_pair not in places:
            raise ValueError(f"the matches of {names[0]} and {names[1]} are damaged; {_AGAIN}")
        store.add(names, places[keys_of_pair], told.get(names, ""))
    return MatchGraph(cameras, images, store.pairs(), rig)


def _places(
    folder: AnyPath, store: StoredPairs, needed: Set[Keys], level: Level | None
) -> dict[Keys, tuple[int, int]]:
    """Parts and rows of the pairs, which the store keeps; each file is read once."""
    later: dict[Keys, tuple[tuple[int, int], Verdict]] = {}
    if level is not None:
        for keys, place, arrays in _rows(folder, store, needed, level.store):
            later[keys] = place, pair_of_part(arrays, place[1]).verdict
    places = {}
    for keys, place, arrays in _rows(folder, store, needed, PAIRS):
        places[keys] = place
        if level is not None and keys in later:
            place_later, verdict = later[keys]
            if level.keeps(pair_of_part(arrays, place[1]).verdict, verdict):
                places[keys] = place_later
    return places


def _implied_places(
    folder: AnyPath, store: StoredPairs, needed: Set[Keys], name: str
) -> dict[Keys, tuple[int, int]]:
    """Part and rows of the pairs that have another pose than the first one."""
    arrays = read_arrays(inside(folder / IMPLIED_PAIRS, name))
    if arrays is None:
        raise ValueError(f"{folder / IMPLIED_PAIRS / name} is missing or damaged; {_AGAIN}")
    return {keys: place for keys, place, _ in _rows_of(arrays, store, needed)}


def _rows(
    folder: AnyPath, store: StoredPairs, needed: Set[Keys], sub_folder: str
) -> Iterator[tuple[Keys, tuple[int, int], Arrays]]:
    """Needed pairs of a sub-folder: keys, number of the part with row, arrays of the part."""
    for arrays in part_arrays(folder, sub_folder):
        yield from _rows_of(arrays, store, needed)


def _rows_of(
    arrays: Arrays, store: StoredPairs, needed: Set[Keys]
) -> Iterator[tuple[Keys, tuple[int, int], Arrays]]:
    keys = [(str(key1), str(key2)) for key1, key2 in arrays["keys"]]
    rows = [row for row, each in enumerate(keys) if each in needed]
    if rows:
        number = store.add_part(arrays)
        yield from ((keys[row], (number, row), arrays) for row in rows)


_AGAIN = "run epi360 match with this --output again, it redoes what is missing"


def _arrays_of(folder: AnyPath, name: str, key: str) -> Arrays:
    arrays = read_arrays(inside(folder / FEATURES, f"{key}.npz"))
    if arrays is None:
        raise ValueError(f"the key points of {name} are missing or damaged; {_AGAIN}")
    return arrays
