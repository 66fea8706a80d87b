# SPDX-License-Identifier: BSD-3-Clause
"""Matches of a room by cameras whose angles are not what they are taken for."""

import numpy as np

import epi360
from epi360 import estimate_relative_pose
from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.poses import Pose, rotation_from_vector

NOISE_RAD = np.radians(0.05)
PANORAMA = Equirectangular(2048, 1024)
LENS = KannalaBrandt(1000, 1000, 300.0, 300.0, 500.0, 500.0)
OTHER_LENS = KannalaBrandt(1000, 1000, 310.0, 310.0, 500.0, 500.0)
PINHOLE = Pinhole(1000, 1000, 400.0, 400.0, 500.0, 500.0)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def by_longitude_and_latitude(longitudes, down):
    cosines = np.cos(down)
    return np.stack(
        [cosines * np.sin(longitudes), np.sin(down), cosines * np.cos(longitudes)], axis=1
    )


def taken_for_smaller(bearings, camera, *changes):
    """Bearings as they are measured if the camera's angles should be larger by so much."""
    x, y, z = bearings.T
    if camera == PANORAMA:
        wider, higher, lowered = 1.0 + changes[0], 1.0 + changes[1], changes[2]
        down = (np.arctan2(y, np.hypot(x, z)) - lowered) / higher
        return by_longitude_and_latitude(np.arctan2(x, z) / wider, down)
    if camera == PINHOLE:
        return unit(bearings * [1.0, 1.0, 1.0 + changes[0]])
    angle, around = np.arctan2(np.hypot(x, y), z) / (1.0 + changes[0]), np.arctan2(y, x)
    out = np.stack([np.cos(around), np.sin(around), np.zeros_like(x)], axis=1)
    return np.sin(angle)[:, None] * out + np.cos(angle)[:, None] * [0.0, 0.0, 1.0]


def seen(seed, camera, changes1, changes2=None, *, num=300, wrong=80, moved=True, noise=NOISE_RAD):
    """Bearings of a room in two views, which the cameras make smaller, and the true pose."""
    rng = np.random.default_rng(seed)
    most = 0.6 if camera != PANORAMA else 2.5  # radians
    turn = rotation_from_vector([0.05, rng.uniform(0.3 * most, most), -0.1])
    step = np.array([-0.7, 0.1, -0.3]) if moved else np.zeros(3)
    pose = Pose(turn, turn @ step)
    points = rng.uniform(-1.0, 1.0, (20 * num, 3)) * [4.0, 1.5, 4.0]
    points = points[np.linalg.norm(points, axis=1) > 0.8]
    if camera != PANORAMA:
        in_view = (unit(points) @ [0.0, 0.0, 1.0] > 0.0) & (
            unit(points @ turn.T + pose.translation) @ [0.0, 0.0, 1.0] > 0.0
        )
        points = points[in_view]
    points = points[:num]
    pair = unit(points), unit(points @ turn.T + pose.translation)
    changes = changes1, changes1 if changes2 is None else changes2
    measured = []
    for b, own in zip(pair, changes, strict=True):
        b = taken_for_smaller(b, camera, *own)
        b = unit(b + rng.normal(0.0, noise, b.shape))
        others = unit(rng.normal(size=(wrong, 3)))
        others[:, 2] = np.abs(others[:, 2]) if camera != PANORAMA else others[:, 2]
        measured.append(np.concatenate([b, others]))
    return tuple(measured), pose


def estimated(bearings):
    result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
    assert result.success
    return result


def errors_deg(pose, truth):
    return np.array(
        [epi360.rotation_error_deg(pose, truth), epi360.translation_error_deg(pose, truth)]
    )
