# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas of two bedrooms of a home that are copies of each other, rendered once."""

from functools import cache

import cv2
import numpy as np
from rendered_views import write_png

from epi360.cameras import Equirectangular
from epi360.jobs.folder.image_set import find_images
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes.home import twin_home

CAMERA = Equirectangular(768, 384)
# In the frame of either room: x, z and heading.
PLACES = [(-0.9, -0.2, 0.3), (-0.3, 0.6, 1.4), (0.2, -0.3, -0.8)]
HEIGHT_M = 1.5


@cache
def rooms():
    """Poses and pictures of three panoramas in each of two twin rooms, by name."""
    home = twin_home(0)
    twins = [room for room in home.rooms if (room.kind, room.side) == ("bedroom", 1)][:2]
    found = {}
    for letter, room in zip("ab", twins, strict=True):
        for number, (x, z, heading) in enumerate(PLACES):
            place = np.array(room.place.to_world((x, -HEIGHT_M, z)))
            turn = rotation_from_vector([0.0, heading + room.place.yaw, 0.0])
            pose = Pose(turn, place)
            picture = home.seen_from(place).render(CAMERA, pose).image
            found[f"{letter}{number}.png"] = (pose, picture)
    return found


def write_rooms(folder, letters="ab", changed=None):
    """Panoramas of these rooms; ``changed`` may take a number and a picture to another one."""
    for number, (name, (_, picture)) in enumerate(rooms().items()):
        if name[0] in letters:
            write_png(folder / name, picture if changed is None else changed(number, picture))
    return find_images(folder)


def truth(name1, name2):
    poses = rooms()
    return poses[name2][0].inverse() @ poses[name1][0]


def exposed_and_visited(number, picture):
    """Other exposures, and somebody who stands elsewhere in each picture."""
    brighter = np.clip(picture * (0.75, 1.0, 1.25)[number % 3], 0, 255).astype(np.uint8)
    column = 60 + 230 * (number % 3)
    cv2.ellipse(brighter, (column, 220), (18, 60), 0, 0, 360, (60, 40, 90), -1)
    cv2.circle(brighter, (column, 145), 14, (200, 160, 140), -1)
    return brighter
