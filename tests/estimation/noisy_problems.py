# SPDX-License-Identifier: BSD-3-Clause
"""Scenes, errors and statistics for the tests of this folder."""

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar import tangent_basis
from epi360.poses import (
    Pose,
    rotation_error_deg,
    rotation_from_vector,
    translation_error_deg,
    vector_from_rotation,
)
from epi360.synthetic import TwoViewScene, two_view_scene


def noisy_scene(
    seed: int, noise_deg: float = 0.3, outliers: float = 0.0, **options
) -> TwoViewScene:
    """Noise in both views; outliers anywhere on the sphere."""
    return two_view_scene(
        seed, noise_deg=noise_deg, noise_in_both_views=True, outlier_ratio=outliers, **options
    )


def unit_pose(scene: TwoViewScene) -> Pose:
    """Truth with a translation of length one, as estimates have it."""
    pose = scene.cam2_from_cam1
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))


def errors_deg(pose: Pose, truth: Pose) -> tuple[float, float]:
    return rotation_error_deg(pose, truth), translation_error_deg(pose, truth)


def nearby(pose: Pose, angle_deg: float, seed: int) -> Pose:
    """Pose with rotation and direction off by about this angle."""
    rng = np.random.default_rng(seed)
    turn, push = np.radians(angle_deg) * rng.normal(size=(2, 3)) / np.sqrt(3.0)
    t = pose.translation + push
    return Pose(rotation_from_vector(turn) @ pose.rotation, t / np.linalg.norm(t))


def normalised_squared_error(pose: Pose, covariance: NDArray[np.float64], truth: Pose) -> float:
    """d^T C^-1 d over 5 with the d of the documented parameters: 1 on average if C is right."""
    turn = vector_from_rotation(truth.rotation @ pose.rotation.T)
    push = tangent_basis(pose.translation).T @ truth.translation
    d = np.concatenate([turn, push / (pose.translation @ truth.translation)])
    return float(d @ np.linalg.solve(covariance, d)) / 5.0


def random_directions(seed: int, num: int) -> NDArray[np.float64]:
    directions = np.random.default_rng(seed).normal(size=(num, 3))
    return directions / np.linalg.norm(directions, axis=1)[:, None]
