# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas of a corridor with equal doors, rendered once."""

from functools import cache

import numpy as np
from rendered_views import write_png

from epi360.cameras import Equirectangular
from epi360.jobs.folder.image_set import find_images
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes.corridor import corridor_of_equal_doors

CAMERA = Equirectangular(1024, 512)
# x, z and heading: the first two are a metre apart, the third 2.6 m from the first, which puts one
# door upon the next.
PLACES = {"a.png": (0.1, -1.0, 0.3), "b.png": (-0.1, 0.0, 1.4), "c.png": (0.05, 1.6, -0.8)}


@cache
def panoramas():
    """Poses and pictures by name."""
    room = corridor_of_equal_doors(1, plain_floor=True)
    found = {}
    for name, (x, z, heading) in PLACES.items():
        pose = Pose(rotation_from_vector([0.0, heading, 0.0]), np.array([x, -1.5, z]))
        found[name] = pose, room.render(CAMERA, pose).image
    return found


def write_panoramas(folder):
    for name, (_, picture) in panoramas().items():
        write_png(folder / name, picture)
    return find_images(folder)


def truth(name1, name2):
    poses = panoramas()
    return poses[name2][0].inverse() @ poses[name1][0]
