# SPDX-License-Identifier: BSD-3-Clause
"""Whether poses that must agree do, as well as they say: held against each other, not a reference.

A reference that was set by hand is no better than the poses. But around three panoramas the
rotations of three pairs must close, and two features must give one pose of a pair.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from _trust_records import Judged

from epi360.poses import Pose, rotation_error_deg, translation_error_deg

FEWEST = 3  # whose median says something
Apart = tuple[float, float]  # degrees, and the sigma of that


def coherence_rows(judged: Sequence[Judged]) -> list[list[str]]:
    """Table of how far apart accepted poses are that must agree; wrong ones are left out."""
    rows = [["data", "method", "must agree", "count", "median apart", "over sigma"]]
    groups: dict[tuple[str, str], dict[frozenset[str], Judged]] = {}
    for run in judged:
        if run.accepted and not run.is_wrong and run.pose is not None:
            groups.setdefault((run.set, run.method), {})[frozenset(_images(run))] = run
    for (name, method), runs in groups.items():
        rows += _row(name, method, "rotations of three pairs", _loops(runs))
    for ((name1, method), runs1), ((name2, same), runs2) in itertools.combinations(
        groups.items(), 2
    ):
        if method == same and name1.split()[0] != name2.split()[0]:
            names = f"{name1}, {name2}"
            shared = [(runs1[key], runs2[key]) for key in runs1.keys() & runs2.keys()]
            rows += _row(names, method, "rotations of a pair", itertools.starmap(_turned, shared))
            rows += _row(names, method, "directions of a pair", itertools.starmap(_moved, shared))
    return rows


def _row(name: str, method: str, what: str, found: Iterator[Apart]) -> list[list[str]]:
    """One row, if there is enough to say."""
    apart = np.array(list(found)).reshape(-1, 2)
    if len(apart) < FEWEST:
        return []
    ratios = (apart[:, 0] / apart[:, 1])[np.isfinite(apart[:, 1])]
    stated = f"{np.median(ratios):.2f}" if len(ratios) >= FEWEST else "-"
    return [[name, method, what, str(len(apart)), f"{np.median(apart[:, 0]):.2f}°", stated]]


def _loops(runs: dict[frozenset[str], Judged]) -> Iterator[Apart]:
    """How far the rotations around three images are from closing."""
    images = sorted({image for key in runs for image in key})
    for three in itertools.combinations(images, 3):
        ways = [(three[0], three[1]), (three[1], three[2]), (three[2], three[0])]
        found = [runs.get(frozenset(way)) for way in ways]
        known = [run for run in found if run is not None]
        if len(known) == len(ways):
            first, second, third = map(_pose, known, (start for start, _ in ways))
            turn = third.rotation @ second.rotation @ first.rotation
            sigma = float(np.linalg.norm([run.rotation_sigma_deg for run in known]))
            yield rotation_error_deg(turn, np.eye(3)), sigma


def _turned(run1: Judged, run2: Judged) -> Apart:
    poses = _both(run1, run2)
    return rotation_error_deg(*poses), np.hypot(run1.rotation_sigma_deg, run2.rotation_sigma_deg)


def _moved(run1: Judged, run2: Judged) -> Apart:
    poses = _both(run1, run2)
    sigmas = run1.translation_sigma_deg, run2.translation_sigma_deg
    return translation_error_deg(*poses), np.hypot(*sigmas)


def _both(run1: Judged, run2: Judged) -> tuple[Pose, Pose]:
    start, _ = _images(run1)
    return _pose(run1, start), _pose(run2, start)


def _pose(run: Judged, start: str) -> Pose:
    """Pose of the other image in the frame of the one that is named."""
    assert run.pose is not None  # only such are looked at
    return run.pose if _images(run)[0] == start else run.pose.inverse()


def _images(run: Judged) -> tuple[str, str]:
    """Images of a pair, with their home before them if there are several."""
    *home, first, second = run.pair.split(" ")
    return " ".join([*home, first]), " ".join([*home, second])
