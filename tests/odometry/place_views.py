# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of a rendered home with twin bedrooms for the tests of places and loops."""

from functools import cache

import cv2
import numpy as np

from epi360.cameras import Equirectangular
from epi360.features.binary_features import extract_binary_features
from epi360.odometry.relocalization import map_view
from epi360.odometry.similarity import Similarity
from epi360.poses import Pose
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes.home import twin_home

CAMERA = Equirectangular(768, 384)
# Places of the camera in a bedroom, in metres to the right and ahead of a free one.
FIRST_VISIT = [(0.0, 0.0), (0.2, 0.1), (0.35, 0.25)]
SECOND_VISIT = [(0.3, -0.1), (0.15, 0.1), (0.0, 0.25)]


def twin_bedrooms():
    """Two rooms with the same arrangement."""
    rooms = [room for room in twin_home(0).rooms if room.kind == "bedroom"]
    sides = [room.side for room in rooms]
    twin = next(s for s in sides if sides.count(s) > 1)
    return [room for room in rooms if room.side == twin][:2]


@cache
def _free_place():
    """Point (x, z) of the bedrooms that is far from everything in both."""
    xs = np.linspace(-1.2, 1.2, 25)
    spots = np.array([(x, -1.4, z) for x in xs for z in xs])
    least = np.full(len(spots), np.inf)
    for room in twin_bedrooms():
        world = np.array([room.place.to_world(spot) for spot in spots])
        least = np.minimum(least, twin_home(0).solids.distances(world))
    return spots[int(np.argmax(least))]


def _world_from_cam(room, offset, heading):
    spot = _free_place() + np.array([offset[0], 0.0, offset[1]])
    rotation = rotation_from_heading(np.array([0.03, room.place.yaw + heading, -0.02]))
    return Pose(rotation, np.array(room.place.to_world(spot)))


@cache
def visit(number, offsets, heading):
    """Features and poses cam_from_world of a visit to one of the twin bedrooms."""
    room = twin_bedrooms()[number]
    views = []
    for offset in offsets:
        pose = _world_from_cam(room, offset, heading)
        image = twin_home(0).seen_from(pose.translation).render(CAMERA, pose, supersample=1).image
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        views.append((pose.inverse(), extract_binary_features(grey, CAMERA)))
    return views


def first_visit(room=0):
    return visit(room, tuple(FIRST_VISIT), 0.0)


def second_visit(room=0, heading=1.8):
    return visit(room, tuple(SECOND_VISIT), heading)


def mapped(key_frame, views, world_from_map=None):
    """The first of some views with the points that the others give, in a map of its own."""
    if world_from_map is None:
        world_from_map = Similarity(1.0, np.eye(3), np.zeros(3))
    inside = [
        ((Similarity.from_pose(pose) @ world_from_map).pose(), features) for pose, features in views
    ]
    return map_view(key_frame, *inside[0], inside[1:])
