# SPDX-License-Identifier: BSD-3-Clause
"""Matches of panoramas on a meadow below clouds that drift."""

import numpy as np

from epi360.poses import Pose, rotation_from_vector

NOISE = 0.0005
WIND = np.array([-40.0, 0.0, 60.0])
STEP = Pose(rotation_from_vector([0.02, 0.4, -0.01]), np.array([0.5, 0.0, 0.3]))
TURN = Pose(STEP.rotation, np.zeros(3))


def seen(points, pose, rng):
    """Bearings of the points from both views, with noise."""
    both = points, points @ pose.rotation.T + pose.translation
    unit = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in both)
    noisy = [each + NOISE * rng.normal(size=each.shape) for each in unit]
    return [each / np.linalg.norm(each, axis=1, keepdims=True) for each in noisy]


def meadow(step=STEP, num_ground=400, num_sky=900, num_things=0, seed=0):
    """A meadow 1.6 m below the camera and clouds 500 m above it, which drift."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform([-8.0, 1.6, -8.0], [8.0, 1.6, 8.0], (num_ground, 3))
    clouds = rng.uniform([-1500.0, -500.0, -1500.0], [1500.0, -500.0, 1500.0], (num_sky, 3))
    things = rng.uniform([-6.0, -2.0, -6.0], [6.0, 1.2, 6.0], (num_things, 3))
    drifting = Pose(step.rotation, step.rotation @ WIND + step.translation)
    parts = [seen(ground, step, rng), seen(clouds, drifting, rng), seen(things, step, rng)]
    return [np.concatenate(each) for each in zip(*parts, strict=True)]
