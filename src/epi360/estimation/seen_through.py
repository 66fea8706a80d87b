# SPDX-License-Identifier: BSD-3-Clause
"""Poses by which inliers would be seen through a surface of other inliers.

A camera that has only turned before tiles, planks or bricks may have as many matches of one tile
with the next as right ones. They agree with a step as long as a tile, and so do the right ones,
which show no parallax, as if they were far away: behind the floor.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import triangulate
from epi360.estimation.angle_search import Bearings, Estimate
from epi360.estimation.result import RelativePoseResult, among_all
from epi360.poses import angles_between

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Gates by which a rotation misses what moved, and at most what stands still.
_MOVED_GATES, _STILL_GATES = 10.0, 3.0
_FEWEST_MOVED, _LEAST_STILL = 6, 0.2  # inliers that moved, and the share that stands still
_SAME_DEPTH = 0.15  # of the inverse depth, by which what is on one plane misses it
_LEAST_ON_PLANE = 0.7  # of what moved
_NEAR_DEG, _APART_DEG = 45.0, 1.0  # from what is on the plane, and from each other
_FEWEST_BEHIND, _MOST_COUNTED = 2, 500
_NUM_SAMPLES = 64


def without_what_is_seen_through(
    result: RelativePoseResult, bearings: Bearings, estimate: Estimate
) -> RelativePoseResult:
    """Return what the other matches say, if inliers would be seen through a surface.

    The inliers with parallax must lie on one plane, and others without any must look at it, near
    what lies on it, where it would show much. ``bearings``, (N, 3) each, are those that the result
    was estimated from, wrong matches included. The result stays as it is if the others say more
    than a turn, or that they are too few.
    """
    if not result.success:
        return result
    inliers = np.flatnonzero(result.inlier_mask)
    surface, num_behind = _surface(result, (bearings[0][inliers], bearings[1][inliers]))
    if num_behind < _FEWEST_BEHIND:
        return result
    others = np.delete(np.arange(len(bearings[0])), inliers[surface])
    answer = estimate(bearings[0][others], bearings[1][others])
    if answer.status not in ("pure_rotation", "too_few_inliers", "too_few_matches"):
        return result
    warning = (
        f"{len(surface)} matches on one surface agree with a step, but {num_behind} others would "
        "be seen through it: its pattern may repeat itself; this is what the others say"
    )
    given = () if answer.status == "pure_rotation" else (result.cam2_from_cam1,)
    told = among_all(answer, others, len(bearings[0]))
    return replace(
        told,
        alternatives=(*told.alternatives, *given),
        warnings=(*told.warnings, warning),
    )


def _surface(result: RelativePoseResult, inliers: Bearings) -> tuple[NDArray[np.intp], int]:
    """Rows of the inliers on the surface, and how many others would be seen through it."""
    pose, gate = result.cam2_from_cam1, np.radians(result.inlier_threshold_deg)
    first, second = inliers
    nothing = np.empty(0, dtype=np.intp), 0
    apart = angles_between(first @ pose.rotation.T, second)
    moved = np.flatnonzero(apart > _MOVED_GATES * gate)
    still = np.flatnonzero(apart < _STILL_GATES * gate)
    if len(moved) < _FEWEST_MOVED or len(still) < max(_FEWEST_BEHIND, _LEAST_STILL * len(first)):
        return nothing
    _, depths, _ = triangulate(first[moved], second[moved], pose)
    plane, on_plane = _plane(first[moved], 1.0 / depths)
    if on_plane.sum() < _LEAST_ON_PLANE * len(moved):
        return nothing
    surface = moved[on_plane]
    turned = first[still] @ pose.rotation.T
    inverse_depths = first[still] @ plane
    on_it = turned + inverse_depths[:, None] * pose.translation
    behind = (inverse_depths > 0.0) & (angles_between(turned, on_it) > _MOVED_GATES * gate)
    nearest = [each[still] @ each[surface].T for each in inliers]
    behind &= np.max([each.max(axis=1) for each in nearest], axis=0) > np.cos(np.radians(_NEAR_DEG))
    return surface, _num_apart(first[still[behind]])


def _plane(bearings: Array, inverse_depths: Array) -> tuple[Array, Mask]:
    """The plane n with n . X = 1 on which most points are (3,), and which ones (N,)."""
    known = np.flatnonzero(np.isfinite(inverse_depths) & (inverse_depths > 0.0))
    best = np.zeros(3), np.zeros(len(bearings), dtype=bool)
    if len(known) < 3:
        return best
    rng = np.random.Generator(np.random.PCG64(0))
    for _ in range(_NUM_SAMPLES):
        some = rng.choice(known, 3, replace=False)
        for _ in range(2):  # once more with all that agree
            plane = np.linalg.lstsq(bearings[some], inverse_depths[some], rcond=None)[0]
            missed = np.abs(bearings @ plane - inverse_depths)
            on_plane = missed < _SAME_DEPTH * inverse_depths
            some = np.flatnonzero(on_plane)
            if len(some) < 3:
                break
        if on_plane.sum() > best[1].sum():
            best = plane, on_plane
    return best


def _num_apart(bearings: Array) -> int:
    """How many directions are not near one that was counted."""
    counted: list[Array] = []
    for each in bearings[:_MOST_COUNTED]:
        if all(each @ other < np.cos(np.radians(_APART_DEG)) for other in counted):
            counted.append(each)
    return len(counted)
