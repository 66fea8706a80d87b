# SPDX-License-Identifier: BSD-3-Clause
"""Matches with known truth for the tests of this folder."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic import two_view_scene


class ExactMatches(NamedTuple):
    """Noise-free bearings; the pose has unit translation, the points are in that unit."""

    b1: NDArray[np.float64]
    b2: NDArray[np.float64]
    pose: Pose
    points: NDArray[np.float64]


def exact_matches(seed: int, num_matches: int = 40, layout: str = "sphere") -> ExactMatches:
    scene = two_view_scene(seed, num_matches=num_matches, layout=layout)
    metric = scene.cam2_from_cam1
    length = np.linalg.norm(metric.translation)
    pose = Pose(metric.rotation, metric.translation / length)
    return ExactMatches(scene.bearings1, scene.bearings2, pose, scene.points / length)


def any_turn(seed: int) -> NDArray[np.float64]:
    """Return a rotation by up to half a turn about any axis."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    return rotation_from_vector(rng.uniform(0.0, np.pi) * axis / np.linalg.norm(axis))


def any_pose(seed: int) -> Pose:
    direction = np.random.default_rng(1000 + seed).normal(size=3)
    return Pose(any_turn(seed), direction / np.linalg.norm(direction))


def disturbed(bearings: NDArray[np.float64], noise_deg: float, seed: int) -> NDArray[np.float64]:
    """Bearings with normal noise of this size along every axis, not normalised."""
    noise = np.random.default_rng(seed).normal(size=bearings.shape)
    return bearings + np.radians(noise_deg) * noise
