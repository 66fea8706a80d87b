# SPDX-License-Identifier: BSD-3-Clause
"""People of a few ellipsoids who walk through a built-in room, out of the camera's way."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose
from epi360_scenes.furniture import Material
from epi360_scenes.paths import STRIDE_M, handheld_path
from epi360_scenes.room import Room
from epi360_scenes.surfaces import uv_from_face

Floats = NDArray[np.float64]

# Height of the centre over the floor, radii, and how far the part swings ahead while walking.
_TORSO, _HEAD, _LEG = (1.13, (0.20, 0.36, 0.20)), (1.61, (0.10, 0.13, 0.10)), (0.43, (0.09, 0.43))
_HIP_M, _SWING_M = 0.10, 0.22
_PARTS = 4
_NEAREST_M = 0.8  # nobody comes nearer to the camera


class People:
    """People in a room by time; the time is counted in frames of the camera's path."""

    def __init__(
        self, room: Room, world_from_cam: list[Pose], count: int, seed: int, step_m: float
    ) -> None:
        self._room = room
        self._camera = np.array([pose.translation for pose in world_from_cam])
        frames = len(world_from_cam)
        ways = [
            handheld_path(room, frames, seed + 1000 * (person + 1), step_m=step_m, clearance_m=0.3)
            for person in range(count)
        ]
        self._ways = [np.array([pose.translation for pose in way]) for way in ways]
        self._headings = [_headings(way) for way in self._ways]
        self._phases = [_phases(way) for way in self._ways]
        rng = np.random.Generator(np.random.PCG64([seed, count]))
        names = room.surfaces.atlas.names
        self._clothes = [rng.choice(len(names), _PARTS) for _ in range(count)]

    def room_at(self, time: float) -> Room:
        """Return the room with everybody where they are at a time."""
        centers, radii, textures, rows = [], [], [], []
        names = self._room.surfaces.atlas.names
        for person, clothes in enumerate(self._clothes):
            for part, (center, size) in enumerate(self._parts(person, time)):
                texture = int(clothes[min(part, _PARTS - 2)])  # both legs are of one cloth
                centers.append(center)
                radii.append(size)
                textures.append(texture)
                material = Material(names[texture], 0.5)
                rows.append(uv_from_face(material, 2 * np.pi * size[0], np.pi * size[1]))
        solids, surfaces = self._room.solids, self._room.surfaces
        return replace(
            self._room,
            solids=replace(
                solids,
                ellipsoid_centers=np.concatenate([solids.ellipsoid_centers, centers]),
                ellipsoid_radii=np.concatenate([solids.ellipsoid_radii, radii]),
            ),
            surfaces=replace(
                surfaces,
                textures=np.concatenate([surfaces.textures, textures]),
                uv_from_face=np.concatenate([surfaces.uv_from_face, np.array(rows)]),
                glow=np.concatenate([surfaces.glow, np.zeros(len(rows), np.float32)]),
            ),
        )

    def place(self, person: int, time: float) -> Floats:
        """Where a person stands: world x and z (2,)."""
        way = self._ways[person]
        frame = np.arange(len(way))
        at, camera = (
            np.array([np.interp(time, frame, path[:, axis]) for axis in (0, 2)])
            for path in (way, self._camera)
        )
        away = at - camera
        distance = float(np.linalg.norm(away))
        if distance >= _NEAREST_M:
            return at
        pushed: Floats = camera + away / max(distance, 1e-6) * _NEAREST_M
        return pushed

    def _parts(self, person: int, time: float) -> list[tuple[Floats, Floats]]:
        """Centre and radii of head, torso and legs."""
        x, z = self.place(person, time)
        frame = np.arange(len(self._headings[person]))
        heading = float(np.interp(time, frame, self._headings[person]))
        swing = _SWING_M * np.sin(float(np.interp(time, frame, self._phases[person])))
        floor = self._room.bounds[1, 1]
        ahead = np.array([np.sin(heading), 0.0, np.cos(heading)])
        side = np.array([np.cos(heading), 0.0, -np.sin(heading)])
        foot = np.array([x, floor, z])
        up = np.array([0.0, -1.0, 0.0])
        parts = [(foot + up * height, np.array(radii)) for height, radii in (_HEAD, _TORSO)]
        height, (wide, tall) = _LEG
        for sign in (-1, 1):
            center = foot + up * height + sign * (_HIP_M * side + swing * ahead)
            parts.append((center, np.array([wide, tall, wide])))
        return parts


def _headings(way: Floats) -> Floats:
    moves = np.gradient(way, axis=0) if len(way) > 1 else np.array([[0.0, 0.0, 1.0]])
    headings: Floats = np.unwrap(np.arctan2(moves[:, 0], moves[:, 2]))
    return headings


def _phases(way: Floats) -> Floats:
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    phases: Floats = 2 * np.pi * np.concatenate([[0.0], np.cumsum(steps)]) / STRIDE_M
    return phases
