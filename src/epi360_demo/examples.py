# SPDX-License-Identifier: BSD-3-Clause
"""Pairs of pictures that the demo renders itself, with the true pose between them."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360.features.picture_writing import encode_picture
from epi360.poses import Pose
from epi360.runs.whole_files import write_file
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes.home import twin_home
from epi360_scenes.room import Room, demo_poses, furnished_room

Picture = NDArray[np.uint8]
Say = Callable[[str], None]

PANORAMA = Equirectangular(width=1024, height=512)
_FISHEYE_DEG = 190.0
_FISHEYE_F = 320.0 / np.radians(_FISHEYE_DEG / 2.0)
FISHEYE = KannalaBrandt(640, 640, _FISHEYE_F, _FISHEYE_F, 320.0, 320.0, 0.0, 0.0, 0.0, 0.0)
_HOME_SEED = 0
# Where a tripod may stand in a room, in metres from its middle.
_PLACES_TRIED = ((0.0, 0.0), (0.4, 0.0), (-0.4, 0.0), (0.0, 0.4), (0.0, -0.4))
_ROOMS_OF_HOME = {"other": ("bedroom1", "study1"), "twins": ("bedroom1", "bedroom2")}


@dataclass(frozen=True)
class Example:
    """What the page says about a pair, and its camera."""

    title: str
    words: str
    camera: Camera


EXAMPLES = {
    "room": Example(
        "A room", "Two panoramas, 0.8 m apart: the pose can be used.", PANORAMA
    ),
    "fisheye": Example(
        "A fisheye lens", "The same places with a lens of 190°: the pose can be used.", FISHEYE
    ),
    "turned": Example(
        "Only turned", "The camera turned and did not move: there is no direction.", PANORAMA
    ),
    "other": Example(
        "Two rooms", "Another room of the same home: there is no pose, and none is given.", PANORAMA
    ),
    "twins": Example(
        "Twin rooms", "Rooms furnished alike: what surrounds the matches differs.", PANORAMA
    ),
}  # fmt: skip


@dataclass(frozen=True)
class RenderedExample:
    """Two files in a folder and the truth; without one where the views share nothing."""

    paths: tuple[Path, Path]
    cam2_from_cam1: Pose | None


def example_paths(folder: Path, name: str) -> tuple[Path, Path]:
    """Return where the pictures of an example are, or will be."""
    return folder / f"{name} 1.png", folder / f"{name} 2.png"


def rendered_example(folder: Path, name: str, say: Say) -> RenderedExample:
    """Return an example, rendered where the folder does not hold it yet."""
    paths, truth_file = example_paths(folder, name), folder / f"{name}.json"
    if not truth_file.exists():
        say("rendering the pictures")
        pictures, truth = _home_views(name) if name in _ROOMS_OF_HOME else _room_views(name)
        for path, picture in zip(paths, pictures, strict=True):
            write_file(path, encode_picture(picture, ".png"))
        record = None if truth is None else truth.matrix().tolist()
        write_file(truth_file, json.dumps(record).encode())
    matrix = json.loads(truth_file.read_text())
    return RenderedExample(paths, None if matrix is None else Pose.from_matrix(np.array(matrix)))


def _room_views(name: str) -> tuple[tuple[Picture, Picture], Pose | None]:
    room = _room()
    first, second = demo_poses(room, 0)
    if name == "turned":
        second = Pose(second.rotation, first.translation)
    camera = EXAMPLES[name].camera
    pictures = room.render(camera, first).image, room.render(camera, second).image
    return pictures, second.inverse() @ first


def _home_views(name: str) -> tuple[tuple[Picture, Picture], None]:
    home = twin_home(_HOME_SEED)
    rooms = {room.name: room for room in home.rooms}
    pictures = []
    for room in (rooms[each] for each in _ROOMS_OF_HOME[name]):
        tried = np.array([room.place.to_world((x, -1.5, z)) for x, z in _PLACES_TRIED])
        place = tried[np.argmax(home.solids_of(room).distances(tried))]
        heading = rotation_from_heading(np.array([0.0, 0.2 + room.place.yaw, 0.0]))
        seen = home.seen_from(place).render(PANORAMA, Pose(heading, place))
        pictures.append(seen.image)
    return (pictures[0], pictures[1]), None


@cache
def _room() -> Room:
    return furnished_room(0)
