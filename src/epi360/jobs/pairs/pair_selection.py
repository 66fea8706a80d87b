# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a set are matched with which."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.interop.pairs_file import read_pairs_file
from epi360.jobs.folder.image_set import SourceImage
from epi360.jobs.records.match_store import Verdict
from epi360.poses import Pose

# Two cores match all pairs of so many panoramas in a minute or two.
MAX_EXHAUSTIVE = 30
# Partners of each image by retrieval. Of 96 panoramas of four rendered homes whose rooms are twins,
# they hold all 136 pairs that all pairs give a right pose; 10 hold 130 of them, 5 hold 112.
NEIGHBORS = 20
OVERLAP = 10  # partners of each image among those that follow it
WAYS, _ALONE = ("sequential", "near", "retrieval"), ("auto", "exhaustive")
_USED_BY = {"overlap": ("sequential",), "neighbors": ("retrieval", "near")}
NUMBERED = re.compile(r"(.*?)(\d+)\.\w+")
# Beside its neighbours each image is matched with a few that are up to so many times as far ahead:
# they hold the sequence together where the camera came back or a neighbour failed.
FARTHEST = 8
# Frames of a video so dense that all of these match well show the same things throughout: all pairs
# would find little more. Mapped with them, 30 frames of a street are as near the reference as with
# all pairs (0.13 % of the path against 0.14 %), from 157 pairs in place of 435.
_DENSE_STEPS = (1, 2, 3, 5, 8, 13, 21)
_DENSE_INLIERS = 100
_FEWEST_DENSE = 16  # of fewer images, all pairs are not many more
# Of a tracked sequence: two images ahead always, others if the way there is short in terms of the
# distance of the scene. The same street: 0.125 % of the path from 119 pairs.
_ALWAYS_AHEAD, _FARTHEST_WAY = 2, 1.0
_UNKNOWN_AHEAD = 16
_RETURN_WAY, _MOST_RETURNS = 0.3, 3
_MATCHING_INLIERS, _MATCHING_SHARE = 30, 0.9
# The cameras of a rig look to different sides: what one sees, another saw a moment ago or never.
CROSS_CAMERA_FRAMES = 1

Pair = tuple[int, int]


MorePairs = Callable[[int, Collection[Pair]], tuple[str, list[Pair]]]
"""Other ways to choose pairs: (so many partners of each image, pairs that are there) to words and
pairs."""


def select_pairs(
    images: Sequence[SourceImage],
    pairs: str | Path,
    overlap: int,
    neighbors: int = NEIGHBORS,
    more: Mapping[str, MorePairs] | None = None,
    unusable: Collection[str] = (),
) -> tuple[str, list[Pair]]:
    """Pairs to match, and in words how they were chosen.

    ``pairs`` is "exhaustive", "auto", the path of a pairs file, or one or several, with commas
    between them, of "sequential" (each image with ``overlap`` after it, and with those 2, 4 and 8
    times as far ahead), "near" and "retrieval" (each with ``neighbors`` that ``more`` chooses,
    beside those that are already its partners). "auto" is exhaustive for up to 30 images, see also
    `dense_pairs`. Beyond that it is retrieval, and where `names_count_up` sequential as well, with
    half as many partners. Each unordered pair of indices comes once. A sequence is all images in
    their order, across sub-folders; of a rig, it is each camera's images by frame, and images of
    different cameras at most one frame apart.

    Pairs of a file with an image that is ``unusable`` are left out.

    Raises
    ------
    ValueError
        If the pairs file names an image that is not there, or cannot be read, or no pair is left.
    """
    why = ""
    if pairs == "auto":
        pairs, neighbors, why = _automatic(images, neighbors)
    ways = ways_of(pairs)
    if not ways:
        return f"from {pairs}", _listed(images, Path(pairs), unusable)
    if ways == ("exhaustive",):
        return "exhaustive", list(combinations(range(len(images)), 2))
    said, chosen = [], dict[Pair, None]()
    for way in ways:
        if way == "sequential":
            words, found = f"sequential, {overlap} neighbours", _sequential(images, overlap)
        else:
            words, found = (more or {})[way](neighbors, chosen.keys())
        said.append(words)
        chosen.update(dict.fromkeys(found))
    return why + "; ".join(said), list(chosen)


def ways_of(pairs: str | Path) -> tuple[str, ...]:
    """Ways in which pairs are chosen, in the order of their work; none for the path of a file.

    Raises
    ------
    ValueError
        If one of several is no way, or one that goes with no other.
    """
    named = [each.strip() for each in pairs.split(",")] if isinstance(pairs, str) else [""]
    if not set(named) & {*WAYS, *_ALONE}:
        return ()
    for each in named:
        if each not in WAYS and len(named) > 1:
            raise ValueError(
                f"pairs must be a file, {', '.join(_ALONE)}, or some of {', '.join(WAYS)} with "
                f"commas between them, got {pairs}"
            )
    return tuple(named) if len(named) == 1 else tuple(way for way in WAYS if way in named)


def check_partners(pairs: str | Path, given: Mapping[str, int | None]) -> None:
    """Refuse an ``overlap`` or ``neighbors`` for which this choice of pairs has no use."""
    ways = ways_of(pairs)
    for name in [] if ways == ("auto",) else _unused(ways, given):
        *others, last = (f'"{way}"' for way in (*_USED_BY[name], "auto"))
        raise ValueError(
            f'{name} must come with pairs={", ".join(others)} or {last}, got pairs="{pairs}"'
        )


def said_unused(
    images: Sequence[SourceImage], pairs: str | Path, given: Mapping[str, int | None]
) -> str:
    """End of a sentence on the choice of pairs: the numbers for which "auto" has no use here."""
    if pairs != "auto":
        return ""  # the others are refused
    names = _unused(ways_of(_automatic(images, NEIGHBORS)[0]), given)
    return f"; {' and '.join(names)} not used" if names else ""


def _unused(ways: Sequence[str], given: Mapping[str, int | None]) -> list[str]:
    """Names of the numbers that are given and that none of these ways uses."""
    named = [name for name, value in given.items() if value is not None]
    return [name for name in named if not set(_USED_BY[name]) & set(ways)]


def names_count_up(images: Sequence[SourceImage]) -> bool:
    """Whether images are a sequence: frames of a rig, or names that differ in a number only.

    In each sub-folder they may begin differently.
    """
    if all(image.frame is not None for image in images):
        return True
    beginnings: dict[str, set[str]] = {}
    for image in images:
        folder, _, name = image.name.rpartition("/")
        numbered = NUMBERED.fullmatch(name)
        if numbered is None:
            return False
        beginnings.setdefault(folder, set()).add(numbered[1])
    return all(len(each) == 1 for each in beginnings.values())


def _automatic(images: Sequence[SourceImage], neighbors: int) -> tuple[str, int, str]:
    """Ways, partners and the reason."""
    if len(images) <= MAX_EXHAUSTIVE:
        return "exhaustive", neighbors, ""
    if names_count_up(images):
        why = f"{len(images)} images whose names count up: "
        return "sequential,retrieval", (neighbors + 1) // 2, why
    return "retrieval", neighbors, f"{len(images)} images whose names do not count up: "


def dense_pairs(images: Sequence[SourceImage], pairs: str | Path) -> list[Pair]:
    """Pairs of 16 to 30 images to look at before all pairs: if `is_dense`, they suffice."""
    may_be = pairs == "auto" and _FEWEST_DENSE <= len(images) <= MAX_EXHAUSTIVE
    if not may_be or any(image.frame is not None for image in images):
        return []
    return [
        (first, first + step)
        for first in range(len(images))
        for step in _DENSE_STEPS
        if first + step < len(images)
    ]


def trajectory_pairs(
    images: Sequence[SourceImage],
    cam_from_world: Mapping[str, Pose],
    depth: Mapping[str, float],
) -> list[Pair]:
    """Pairs of a sequence that probably see the same things, by where its images were taken.

    Each image comes with those 1, 2, 4, 8, ... ahead, as long as the way between them is shorter
    than the ``depth`` of the scene, and with the nearest of those that came back to its place much
    later. Images without a pose come with those up to 16 ahead. There are none for fewer than 16
    images: all pairs are not many more.
    """
    if len(images) < _FEWEST_DENSE:
        return []
    names = [image.name for image in images]
    unknown = np.full(3, np.nan)
    centers = np.array(
        [cam_from_world[n].inverse().translation if n in cam_from_world else unknown for n in names]
    )
    depths = np.array([depth.get(name, np.nan) for name in names])
    chosen = []
    for first in range(len(names)):
        ways = np.linalg.norm(centers[first:] - centers[first], axis=1)
        ways = ways / np.fmin(depths[first:], depths[first])
        steps = [2**k for k in range(len(ways).bit_length()) if 2**k < len(ways)]
        chosen += [
            (first, first + step)
            for step in steps
            if step <= _ALWAYS_AHEAD
            or ways[step] < _FARTHEST_WAY
            or (np.isnan(ways[step]) and step <= _UNKNOWN_AHEAD)
        ]
        chosen += [(first, first + step) for step in _returns(ways) if step not in steps]
    return chosen


def _returns(ways: NDArray[np.float64]) -> list[int]:
    """Steps ahead where the camera is nearest to the first place again, after it was away."""
    is_away = np.fmax.accumulate(np.nan_to_num(ways)) > 2 * _RETURN_WAY
    is_back = is_away & (ways < _RETURN_WAY)
    is_back[: _UNKNOWN_AHEAD + 1] = False
    rows = np.flatnonzero(is_back)
    visits = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    nearest = [int(visit[np.argmin(ways[visit])]) for visit in visits if len(visit)]
    return nearest[:_MOST_RETURNS]


def mostly_match(verdicts: Sequence[Verdict]) -> bool:
    """Whether nearly all of `trajectory_pairs` with these verdicts match."""
    matching = [
        verdict.status in ("ok", "pure_rotation", "planar_ambiguous")
        and verdict.num_inliers >= _MATCHING_INLIERS
        for verdict in verdicts
    ]
    return sum(matching) >= _MATCHING_SHARE * len(matching)


def is_dense(verdicts: Sequence[Verdict]) -> bool:
    """Whether `dense_pairs` with these verdicts are a dense sequence: each has many inliers."""
    return all(
        verdict.status in ("ok", "pure_rotation", "planar_ambiguous")
        and verdict.num_inliers >= _DENSE_INLIERS
        for verdict in verdicts
    )


def _sequential(images: Sequence[SourceImage], overlap: int) -> list[Pair]:
    frames: dict[str | int, list[int]] = {}
    for index, image in enumerate(images):
        frames.setdefault(index if image.frame is None else image.frame, []).append(index)
    moments = list(frames.values())
    if len(moments) == len(images):
        return [(a, b) for a in range(len(images)) for b in _ahead(a, len(images), overlap)]
    steps = [(a, b) for a in range(len(moments)) for b in [a, *_ahead(a, len(moments), overlap)]]
    return [
        pair for a, b in steps for pair in _pairs_of_moments(images, moments[a], moments[b], b - a)
    ]


def _ahead(index: int, count: int, overlap: int) -> list[int]:
    """Neighbours that follow, and a few farther ahead."""
    steps = [*range(1, overlap + 1), *(overlap * 2**k for k in range(1, FARTHEST.bit_length()))]
    return [index + step for step in steps if index + step < count]


def _pairs_of_moments(
    images: Sequence[SourceImage], moment1: list[int], moment2: list[int], num_frames: int
) -> Iterable[Pair]:
    """Pairs between two moments of a rig, or within one."""
    if num_frames == 0:
        yield from combinations(moment1, 2)
        return
    for first in moment1:
        for second in moment2:
            if num_frames <= CROSS_CAMERA_FRAMES or images[first].camera == images[second].camera:
                yield first, second


def _listed(images: Sequence[SourceImage], path: Path, unusable: Collection[str]) -> list[Pair]:
    index = {image.name: place for place, image in enumerate(images)}
    chosen = []
    names = [*index, *unusable]
    for pair in read_pairs_file(path, names=names, both_orders=True):
        if not set(pair).isdisjoint(unusable):
            continue  # whoever chose the images has said why
        for name in pair:
            if name not in index:
                raise ValueError(
                    f"{path} names the image {name}, which is not among the {len(index)} images; "
                    f"names are paths below the image folder, such as {images[0].name}"
                )
        chosen.append((index[pair[0]], index[pair[1]]))
    if not chosen:
        raise ValueError(f"{path} has no pair of two images that can be used")
    return chosen
