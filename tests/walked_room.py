# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a walk through a rendered room, rendered once, and what is done to them."""

from functools import cache

import numpy as np
from rendered_views import write_png

from epi360.cameras import Equirectangular
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

CAMERA = Equirectangular(512, 256)
NUM_FRAMES = 16


def world_from_cam(index):
    """Five centimetres to the right a frame, with a sway and a slow turn."""
    sway = np.sin(0.7 * index)
    turn = rotation_from_vector([0.01 * sway, 0.03 * index, 0.008 * sway])
    return Pose(turn, np.array([-0.3 + 0.05 * index, -1.5 + 0.01 * sway, -0.3 + 0.01 * index]))


@cache
def frames():
    room = furnished_room(1)
    return [
        room.render(CAMERA, world_from_cam(index), supersample=1).image
        for index in range(NUM_FRAMES)
    ]


@cache
def level_frames():
    """The first frames of the walk without its sway: the camera stands upright in all of them."""
    room = furnished_room(1)
    level = [
        Pose(rotation_from_vector([0.0, 0.03 * index, 0.0]), world_from_cam(index).translation)
        for index in range(10)
    ]
    return [room.render(CAMERA, pose, supersample=1).image for pose in level]


def turned(image, columns):
    """What a camera sees that turns to the left by so many columns."""
    return np.roll(image, columns, axis=1)


def elsewhere():
    """Frames of another place: the same walk through the mirrored room, backwards."""
    return [image[:, ::-1] for image in reversed(frames())]


def error_share(positions, indices):
    """Root mean square error of positions after Sim(3), as a share of the path."""
    truth = np.array([world_from_cam(index).translation for index in indices])
    path = np.linalg.norm(np.diff(truth, axis=0), axis=1).sum()
    a, b = positions - positions.mean(axis=0), truth - truth.mean(axis=0)
    u, sizes, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (sizes * signs).sum() / np.square(a).sum()
    errors = scale * a @ (u @ np.diag(signs) @ vt).T - b
    return float(np.sqrt(np.square(errors).sum(axis=1).mean()) / path)


def write_frames(folder, count, *, same=False):
    """Write the first frames of the walk as PNG files, or the first one with noise every time."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for index in range(count):
        image = frames()[0 if same else index]
        if same:
            image = np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)
        write_png(folder / f"{index:03d}.png", image)
