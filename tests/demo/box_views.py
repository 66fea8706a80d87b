# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas inside a box with spotted walls: a pair with a known pose in a tenth of a second."""

import cv2
import numpy as np

from epi360.cameras import Equirectangular
from epi360.poses import Pose, rotation_from_vector

CAMERA = Equirectangular(width=768, height=384)
HALF = np.array([2.5, 1.5, 2.0])
WORLD_FROM_CAM = (
    Pose(rotation_from_vector((0.02, 0.3, -0.04)), np.array([0.3, 0.1, -0.4])),
    Pose(rotation_from_vector((-0.05, 0.6, 0.03)), np.array([-0.4, 0.0, 0.1])),
)
CAM2_FROM_CAM1 = WORLD_FROM_CAM[1].inverse() @ WORLD_FROM_CAM[0]


def box_view(number):
    """The picture of camera 1 or 2."""
    pose = WORLD_FROM_CAM[number - 1]
    u, v = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    directions = CAMERA.bearings_from_pixels(pixels) @ pose.rotation.T
    ranges = (np.copysign(HALF, directions) - pose.translation) / directions
    axis = np.argmin(ranges, axis=1)
    rows = np.arange(len(axis))
    points = pose.translation + ranges[rows, axis, None] * directions
    wall = 2 * axis + (directions[rows, axis] > 0)
    wall = wall.reshape(CAMERA.height, CAMERA.width)
    picture = np.zeros((*wall.shape, 3), np.uint8)
    for number, texture in enumerate(_textures()):
        a, b = np.delete(points, number // 2, axis=1).T.reshape(2, *wall.shape)
        places = (np.float32(110.0 * (each + 2.6)) for each in (a, b))
        picture[wall == number] = cv2.remap(texture, *places, cv2.INTER_LINEAR)[wall == number]
    return picture


def _textures():
    rng = np.random.Generator(np.random.PCG64(5))
    for _ in range(6):
        spots = rng.integers(0, 256, (48, 48, 3), dtype=np.uint8)
        yield cv2.resize(spots, (576, 576), interpolation=cv2.INTER_CUBIC)
