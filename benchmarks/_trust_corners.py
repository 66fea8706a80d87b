# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on matches of OpenCV's ORB, which finds most of its corners on what has most texture."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from _data import Matches, read_poses
from _trust_lone import CLIPS
from _trust_pairs import GivenPair, Plan, given_pair_verdicts
from _trust_records import Judged
from numpy.typing import NDArray

from epi360.cameras import Equirectangular

STEP = 2  # of all frames so many apart, every pair
NUM_CORNERS, LARGEST_RATIO = 4000, 0.85

Corners = tuple[NDArray[np.float64], NDArray[np.uint8]]  # pixels (N, 2), descriptors (N, 32)


def corner_verdicts(plan: Plan) -> Iterator[Judged]:
    """All pairs of every second frame of two clips, by mutual matches of ORB."""
    for clip in CLIPS:
        folder = plan.data / "video_clips" / clip
        world_from_cam = read_poses(folder / "poses.csv")
        names = sorted(world_from_cam)[::STEP]
        camera = Equirectangular(*_size(folder / "frames" / names[0]))
        found = {name: _corners(folder / "frames" / name) for name in names}
        tasks = []
        for name1, name2 in itertools.combinations(names, 2):
            matches = _matched(found[name1], found[name2])
            given = Matches(
                camera, camera, found[name1][0][matches[:, 0]], found[name2][0][matches[:, 1]]
            )
            truth = world_from_cam[name2].inverse() @ world_from_cam[name1]
            pair = f"{clip}/{name1} {clip}/{name2}"
            tasks.append(GivenPair(f"{clip}, ORB", pair, given, truth))
        yield from given_pair_verdicts(plan, tasks)


def _size(path: Path) -> tuple[int, int]:
    height, width = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).shape
    return width, height


def _corners(path: Path) -> Corners:
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    keypoints, descriptors = cv2.ORB_create(NUM_CORNERS).detectAndCompute(grey, None)
    # OpenCV puts pixel centres at integers.
    return np.array([each.pt for each in keypoints]) + 0.5, np.asarray(descriptors, np.uint8)


def _matched(first: Corners, second: Corners) -> NDArray[np.intp]:
    """Rows (M, 2) of corners that are each other's nearest, and clearly nearer than the next."""
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    back = {one.queryIdx: one.trainIdx for (one,) in matcher.knnMatch(second[1], first[1], 1)}
    return np.array(
        [
            (one.queryIdx, one.trainIdx)
            for one, next_ in matcher.knnMatch(first[1], second[1], 2)
            if one.distance < LARGEST_RATIO * next_.distance and back[one.trainIdx] == one.queryIdx
        ],
        dtype=np.intp,
    ).reshape(-1, 2)
