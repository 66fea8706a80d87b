# SPDX-License-Identifier: BSD-3-Clause
"""A rendered room and its map, made once for the tests of the library and of the command."""

import cv2
import numpy as np

from epi360.cameras import Equirectangular
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

CAMERA = Equirectangular(512, 256)


def write_picture(path, rgb):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, rgb[..., ::-1])[1].tobytes())


def room_poses(num_places):
    """Places along a line through the room, the camera turning; the last one twice, turned."""
    poses = [
        Pose(
            rotation_from_vector([0.02 * k, 0.4 * k, 0.03 * k]),
            np.array([-0.9 + 0.3 * k, -1.5 + 0.04 * (k % 2), -0.5 + 0.1 * k]),
        )
        for k in range(num_places)
    ]
    turned = Pose(poses[-1].rotation @ rotation_from_vector([0.0, 1.2, 0.1]), poses[-1].translation)
    return [*poses, turned]


def write_room(folder):
    """Write panoramas with sub-folders and other letters; return the true poses by name."""
    room = furnished_room(0)
    truth = {}
    for number, world_from_cam in enumerate(room_poses(5)):
        name = f"Küche/{number}.png" if number < 3 else f"hall/{number}.png"
        write_picture(folder / name, room.render(CAMERA, world_from_cam).image)
        truth[name] = world_from_cam
    write_picture(folder / "zz_grey.png", np.full((256, 512, 3), 128, np.uint8))
    return truth
