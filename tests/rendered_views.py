# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a rendered room for the tests of `epi360 match` and `epi360 map`, rendered once."""

from functools import cache

import cv2
import numpy as np

from epi360.cameras import Equirectangular
from epi360.jobs.folder.image_set import ImageSet, SourceImage
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

TURNS = [(0.05, 0.3, -0.04), (0.0, 0.1, 0.02), (0.1, -0.2, 0.05), (0.02, 0.5, 0.0)]
PLACES = [(0.1, -1.5, -0.35), (0.45, -1.45, -0.2), (-0.2, -1.55, 0.1), (0.2, -1.4, 0.15)]
WORLD_FROM_CAM = [
    Pose(rotation_from_vector(turn), np.array(place))
    for turn, place in zip(TURNS, PLACES, strict=True)
]
SIZES = [(512, 256), (512, 256), (448, 224), (512, 256)]
NAMES = ["Zimmer/küche 1.png", "Zimmer/küche 2.png", "b/10.png", "b/9.png"]


@cache
def pictures():
    room = furnished_room(1)
    return [
        room.render(Equirectangular(*size), pose).image
        for size, pose in zip(SIZES, WORLD_FROM_CAM, strict=True)
    ]


def write_png(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", image[:, :, ::-1])[1].tobytes())


def write_views(folder, names=NAMES):
    for name, image in zip(names, pictures(), strict=False):
        write_png(folder / name, image)
    return folder


def image_set(folder, names=NAMES, mask=None):
    images = [
        SourceImage(name, folder / name, f"{size[0]}x{size[1]}", mask)
        for name, size in zip(names, SIZES, strict=False)
    ]
    cameras = {f"{size[0]}x{size[1]}": Equirectangular(*size) for size in SIZES}
    return ImageSet(folder, cameras, tuple(images))


def truth(index1, index2):
    return WORLD_FROM_CAM[index2].inverse() @ WORLD_FROM_CAM[index1]
