# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas of two rooms of different size, of which one wall has the same paper."""

from functools import cache

import cv2
import numpy as np

from epi360.cameras import Equirectangular
from epi360.poses import Pose, rotation_from_vector

CAMERA = Equirectangular(1024, 512)
NORTH_M, FLOOR_M, CEILING_M = 2.0, 1.5, -1.2
# West, east and south walls of two rooms, in metres; the papered one is in the north of both.
SIZES = {"a": (-2.0, 2.2, -2.0), "b": (-3.4, 1.6, -4.0)}
PLACES = [(0.3, 0.2, 0.4), (-0.4, -0.6, -0.9)]  # x, z and heading
PER_M = 128  # pixels of a pattern


def poses():
    """Where the cameras stand in either room: world_from_cam, the papered wall is in the north."""
    return [
        Pose(rotation_from_vector([0.0, heading, 0.0]), np.array([x, 0.0, z]))
        for x, z, heading in PLACES
    ]


@cache
def picture(letter, number, *, own_patterns=True):
    """What a camera sees in a room; without patterns of its own, only one wall is not bare."""
    pose = poses()[number]
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    pixels = np.column_stack([columns.ravel() + 0.5, rows.ravel() + 0.5])
    bearings = CAMERA.bearings_from_pixels(pixels) @ pose.rotation.T
    west, east, south = SIZES[letter]
    limits = np.array([[west, east], [CEILING_M, FLOOR_M], [south, NORTH_M]])
    ends = np.where(bearings > 0, limits[:, 1], limits[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = (ends - pose.translation) / bearings
    side = np.argmin(np.where(bearings == 0, np.inf, distances), axis=1)
    each = np.arange(len(bearings))
    points = pose.translation + bearings * distances[each, side][:, None]
    surface = 2 * side + (bearings[each, side] > 0)
    grey = np.zeros(len(bearings))
    for of_surface in range(6):
        is_papered = of_surface == 5
        along = np.delete(points, of_surface // 2, axis=1) + 5.0
        at = (PER_M * along).astype(np.float32).reshape(CAMERA.height, CAMERA.width, 2)
        seed = 99 if is_papered else 10 * ord(letter) + of_surface
        pattern = cv2.remap(_pattern(seed), at, None, cv2.INTER_LINEAR).ravel()
        bare = np.full(len(bearings), 150.0 + 8 * of_surface)
        shown = pattern if is_papered or own_patterns else bare
        grey = np.where(surface == of_surface, shown, grey)
    image = grey.reshape(CAMERA.height, CAMERA.width).astype(np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)


@cache
def _pattern(seed):
    """Ten by ten metres of spots of all sizes, the same at every call."""
    rng = np.random.default_rng(seed)
    image = np.full((10 * PER_M, 10 * PER_M), 150, np.uint8)
    for x, y, radius, grey in rng.integers((0, 0, 3, 60), (*image.shape, 25, 240), (9000, 4)):
        cv2.circle(image, (int(x), int(y)), int(radius), int(grey), -1)
    return cv2.GaussianBlur(image, (0, 0), 1.0)
