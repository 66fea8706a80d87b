# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas whose matches in the sky agree with a motion of their own, as clouds do.

Finely broken clouds have more key points than a meadow. They drift together, so that they look like
near things that a camera passes, and the ground like what is far away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.estimation.angle_search import Bearings, Estimate, are_panoramas
from epi360.estimation.result import RelativePoseResult, among_all
from epi360.poses import poses_agree

Mask = NDArray[np.bool_]

# In the sky is what both views see so far above the horizon, and on the ground so far below.
_SKY_DEG, _GROUND_DEG = 1.0, 10.0
# The inliers that have parallax, of so many noises, are such a share of all and more, and in the
# sky but for few; of the matches on the ground, which are so many, no more than such a share has
# parallax and agrees.
_MOVED_SIGMAS, _LEAST_MOVED, _LEAST_IN_SKY = 8.0, 0.2, 0.97
_FEWEST_ON_GROUND, _MOST_AGREE = 50, 0.03
# So many of the matches on the ground must agree with each other instead.
_LEAST_OF_GROUND = 0.5
_SAME_ROTATION_DEG, _SAME_DIRECTION_DEG = 2.0, 10.0


def with_ground_motion(
    result: RelativePoseResult,
    bearings: Bearings,
    cameras: tuple[Camera, Camera],
    estimate: Estimate,
) -> RelativePoseResult:
    """Return what the matches on the ground say, if the pose is that of the sky alone.

    The ground stands still, and is no farther away than what is above it. ``bearings``, (N, 3)
    each, are those that the result was estimated from, wrong matches included, of cameras that
    stand roughly upright. A warning counts the matches in the sky. The result stays as it is if
    other inliers have parallax too, as those on walls, trees and people have, or if the ground
    agrees with nothing.
    """
    if not (result.success and are_panoramas(cameras)):
        return result
    first, second = bearings
    down = np.stack([first[:, 1], second[:, 1]])  # NaN of missing matches is neither
    sky = (down < -np.sin(np.radians(_SKY_DEG))).all(axis=0)
    ground = (down > np.sin(np.radians(_GROUND_DEG))).all(axis=0)
    moved = result.inlier_mask & _has_parallax(result, bearings)
    if ground.sum() < _FEWEST_ON_GROUND or moved.sum() < _LEAST_MOVED * result.num_inliers:
        return result
    if np.mean(sky[moved]) < _LEAST_IN_SKY or np.mean(moved[ground]) > _MOST_AGREE:
        return result
    answer = estimate(first[ground], second[ground])
    poses = answer.cam2_from_cam1, result.cam2_from_cam1
    is_same = poses_agree(*poses, _SAME_ROTATION_DEG, _SAME_DIRECTION_DEG)
    if is_same or answer.num_inliers < _LEAST_OF_GROUND * ground.sum():
        return result
    warning = (
        f"{int(moved.sum())} matches in the sky agree with a motion of their own, as clouds do; "
        f"this is what the {int(ground.sum())} matches on the ground say"
    )
    told = among_all(answer, np.flatnonzero(ground), len(first))
    return replace(told, warnings=(*told.warnings, warning))


def _has_parallax(result: RelativePoseResult, bearings: Bearings) -> Mask:
    """Which matches (N,) a rotation alone does not explain."""
    turned = bearings[0] @ result.cam2_from_cam1.rotation.T
    apart = np.linalg.norm(np.cross(turned, bearings[1]), axis=1)
    return np.asarray(apart > _MOVED_SIGMAS * np.radians(result.noise_deg))
