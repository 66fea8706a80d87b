# SPDX-License-Identifier: BSD-3-Clause
"""Shi-Tomasi corners, and where Lucas and Kanade find them in another picture.

Points are in OpenCV's coordinates here: pixel centres lie at integers.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Points = NDArray[np.float32]
Mask = NDArray[np.bool_]


def follow_points(
    picture1: Picture,
    picture2: Picture,
    points: Points,
    window_px: int,
    levels: int,
    guess: Points | None = None,
) -> tuple[Points, Mask]:
    """Where points (N, 2) of one picture are in the other, and which were found."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.003)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        picture1,
        picture2,
        points,
        np.empty_like(points) if guess is None else guess.copy(),
        winSize=(window_px, window_px),
        maxLevel=levels,
        criteria=criteria,
        flags=0 if guess is None else cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(moved, dtype=np.float32), found.ravel() == 1


def follow_there_and_back(
    picture1: Picture,
    picture2: Picture,
    points: Points,
    window_px: int,
    levels: int,
    guess: Points | None = None,
) -> tuple[Points, NDArray[np.float64]]:
    """Where points are in the other picture, and by how many pixels tracking back misses them.

    The miss of a point that one of the two ways does not find is infinite.
    """
    if len(points) == 0:
        return points, np.zeros(0)
    end, found = follow_points(picture1, picture2, points, window_px, levels, guess)
    # The way back starts as far from its goal as the way there did.
    back_guess = None if guess is None else points + (end - guess)
    back, found_back = follow_points(picture2, picture1, end, window_px, levels, back_guess)
    missed_px = np.hypot(*(back - points).T).astype(np.float64)
    missed_px[~(found & found_back)] = np.inf
    return end, missed_px


def find_corners(
    picture: Picture, usable: Picture, quality_level: float
) -> tuple[Points, NDArray[np.float32]]:
    """Corners (N, 2) at usable pixels (those above 0) and their strengths (N,), strongest first.

    The strength is the smaller eigenvalue of Shi and Tomasi, at least the level times the largest.
    """
    corners, strengths = cv2.goodFeaturesToTrackWithQuality(picture, 0, quality_level, 0, usable)
    if corners is None:
        return np.empty((0, 2), dtype=np.float32), np.empty(0, dtype=np.float32)
    return (
        np.asarray(corners, dtype=np.float32).reshape(-1, 2),
        np.asarray(strengths, dtype=np.float32).ravel(),
    )


def erode_mask(usable: Picture, window_px: int) -> Picture:
    """Usable pixels half a window away from others: an edge would be tracked, not the scene."""
    window = np.ones((window_px, window_px), dtype=np.uint8)
    return np.asarray(cv2.erode(usable, window), dtype=np.uint8)
