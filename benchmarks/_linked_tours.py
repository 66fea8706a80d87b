# SPDX-License-Identifier: BSD-3-Clause
"""Real virtual tours, as the Marzipano Tool exports them: cube faces in tiles, and links.

A link is an arrow that somebody has put into a panorama, to where another one was taken. Two of
them, there and back, say in which direction the one camera stands from the other, and how far the
cameras are turned. They stand in doors and on floors, so they are right to some tens of degrees: a
wrong pose agrees with both by chance once in a few dozen times.
"""

from __future__ import annotations

import json
import math
import re
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.features.images import read_image
from epi360.features.picture_writing import encode_picture
from epi360.jobs.cubes.cube_faces import (
    FACES,
    CubemapOptions,
    FaceName,
    face_camera,
    face_from_cam,
)
from epi360.poses import Pose
from epi360.report.text import azimuth_elevation_deg
from epi360.runs.whole_files import write_file

Array = NDArray[np.float64]

DATA = "data.js"
LINK_DEG = 30.0  # both links are as near as this to a right pose
SHIFTED_DEG, SAME_DEG = 60.0, 15.0  # or they stand in one door beside the way, and agree in that
CHAIN_DEG, STEP_DEG = 20.0, 8.0  # of what links from room to room say about the turn
ROW = 2000  # OpenCV maps no longer lines than 32,767


@dataclass(frozen=True, eq=False)
class LinkedTour:
    """Panoramas of a tour and its links.

    ``links`` has the azimuth in degrees, to the right of the middle, at which the first panorama
    shows the second.
    """

    name: str
    source: Path
    scenes: tuple[dict[str, Any], ...]
    links: Mapping[tuple[str, str], float]

    @classmethod
    def of(cls, data: Path, name: str) -> LinkedTour | None:
        """Read ``data.js``; None if it is of something else."""
        found = re.search(r"=\s*(\{.*\})", data.read_text("utf-8", errors="replace"), re.DOTALL)
        try:
            scenes = json.loads(found[1])["scenes"] if found else []
            links = {
                (_file_name(scene["id"]), _file_name(link["target"])): math.degrees(link["yaw"])
                for scene in scenes
                for link in scene["linkHotspots"]
            }
        except (ValueError, KeyError, TypeError):
            return None
        there = tuple(each for each in scenes if (data.parent / "tiles" / each["id"]).is_dir())
        return cls(name, data.parent, there, links) if len(there) > 1 else None

    @property
    def names(self) -> list[str]:
        """File names of the panoramas."""
        return [_file_name(scene["id"]) for scene in self.scenes]

    def write_panoramas(self, folder: Path, width: int) -> list[Path]:
        """Make equirectangular pictures of the tiles; those that are there stay."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / name for name in self.names]
        for scene, path in zip(self.scenes, paths, strict=True):
            if not path.exists():
                picture = panorama_of(_faces(self.source, scene, width), width)
                write_file(path, encode_picture(picture, path.suffix))
        return paths

    def agrees(self, name1: str, name2: str, cam2_from_cam1: Pose) -> bool | None:
        """Whether the links there and back say the same as a pose; None if there are not both."""
        if not {(name1, name2), (name2, name1)} <= self.links.keys():
            return None
        to_second = _azimuth_deg(-cam2_from_cam1.rotation.T @ cam2_from_cam1.translation)
        to_first = _azimuth_deg(cam2_from_cam1.translation)
        first = _turned(to_second - self.links[name1, name2])
        second = _turned(to_first - self.links[name2, name1])
        far = max(abs(first), abs(second))
        return far < LINK_DEG or (far < SHIFTED_DEG and abs(first - second) < SAME_DEG)

    def turn_agrees(self, name1: str, name2: str, cam2_from_cam1: Pose) -> bool | None:
        """Whether a chain of links says that the second camera is turned so; None without one."""
        turn = -_azimuth_deg(cam2_from_cam1.rotation @ np.array([0.0, 0.0, 1.0]))
        for name, linked_turn, num_steps in self._walk(name1):
            if name == name2:
                return abs(_turned(turn - linked_turn)) < CHAIN_DEG + STEP_DEG * num_steps
        return None

    @cached_property
    def _neighbours(self) -> dict[str, dict[str, float]]:
        """How far each panorama's neighbours are turned, where links lead there and back."""
        turns: dict[str, dict[str, float]] = {}
        for (first, second), azimuth in self.links.items():
            if (second, first) in self.links:
                back = self.links[second, first]
                turns.setdefault(first, {})[second] = _turned(azimuth + 180.0 - back)
        return turns

    def _walk(self, start: str) -> Iterator[tuple[str, float, int]]:
        """Panoramas that links lead to from one, how far they are turned, and the steps."""
        waiting, seen = deque([(start, 0.0, 0)]), {start}
        while waiting:
            name, turn, steps = waiting.popleft()
            yield name, turn, steps
            for other, more in self._neighbours.get(name, {}).items():
                if other not in seen:
                    seen.add(other)
                    waiting.append((other, turn + more, steps + 1))


def linked_tours(folder: Path) -> Iterator[LinkedTour]:
    """Tours below a folder, by name."""
    for data in sorted(folder.rglob(DATA)):
        parts = data.parent.relative_to(folder).parts or (folder.name,)
        tour = LinkedTour.of(data, "_".join(parts))
        if tour is not None:
            yield tour


def panorama_of(faces: Mapping[FaceName, NDArray[np.uint8]], width: int) -> NDArray[np.uint8]:
    """Equirectangular picture (width / 2, width, 3) of six faces."""
    camera = Equirectangular(width, width // 2)
    centres = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    bearings = camera.bearings_from_pixels(np.stack(centres, axis=-1).reshape(-1, 2))
    middles = np.array([face_from_cam(name).rotation[2] for name in faces])
    nearest = np.argmax(bearings @ middles.T, axis=1)
    picture = np.zeros((len(bearings), 3), np.uint8)
    for number, (name, face) in enumerate(faces.items()):
        (shown,) = np.nonzero(nearest == number)
        seen = bearings[shown] @ face_from_cam(name).rotation.T
        pixels = face_camera(camera, CubemapOptions(face_size=len(face))).pixels_from_bearings(seen)
        places = (pixels - 0.5).T.astype(np.float32)  # OpenCV counts from the middle of a pixel
        padded = np.pad(places, ((0, 0), (0, -len(shown) % ROW))).reshape(2, -1, ROW)
        found = cv2.remap(
            face, padded[0], padded[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        picture[shown] = found.reshape(-1, 3)[: len(shown)]
    return picture.reshape(camera.height, camera.width, 3)


def _faces(source: Path, scene: Mapping[str, Any], width: int) -> dict[FaceName, NDArray[np.uint8]]:
    """The faces in the smallest size that is half as wide as the panorama, or in the largest."""
    sizes = [level for level in scene["levels"] if not level.get("fallbackOnly")]
    levels = [level for level in sizes if level["size"] >= width // 2] or sizes[-1:]
    size, tile = levels[0]["size"], levels[0]["tileSize"]
    # Folders count the sizes that are shown from 1 on.
    number = sizes.index(levels[0]) + 1
    folder = source / "tiles" / scene["id"] / str(number)
    return {name: _face(folder / name[0], size, tile) for name in FACES}  # f, r, b, l, u, d


def _face(folder: Path, size: int, tile: int) -> NDArray[np.uint8]:
    face = np.zeros((size, size, 3), np.uint8)
    for row, column in np.ndindex(-(-size // tile), -(-size // tile)):
        part = read_image(folder / str(row) / f"{column}.jpg")
        height, width = part.shape[:2]
        face[row * tile : row * tile + height, column * tile : column * tile + width] = part
    return face


def _file_name(scene: str) -> str:
    return f"{scene}.jpg"


def _azimuth_deg(direction: Array) -> float:
    return azimuth_elevation_deg(direction)[0]


def _turned(angle_deg: float) -> float:
    """The angle between -180 and 180 degrees."""
    return (angle_deg + 180.0) % 360.0 - 180.0
