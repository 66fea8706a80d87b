# SPDX-License-Identifier: BSD-3-Clause
"""What a real camera adds to the pictures of a path: people, exposure, blur, rolling shutter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.poses import Pose, rotation_from_vector, vector_from_rotation
from epi360_scenes.paths import smooth_noise
from epi360_scenes.people import People
from epi360_scenes.rendering import RayCaster, Rendering
from epi360_scenes.room import Room
from epi360_scenes.textures import GAMMA

FRAME_RATE = 30.0
SHUTTER_FRAMES = 0.5  # the shutter is open for half of the time between two frames
EXPOSURE_FRAMES = 20.0  # in so many frames, the exposure changes by about what it can
MOST_PEOPLE, MOST_MOMENTS = 100, 99  # more are slips: a picture would take hours
BAND_PX = 8  # rows that are exposed at one moment, of a rolling shutter


@dataclass(frozen=True)
class Effects:
    """What is added to the pictures; without arguments, nothing is.

    ``exposure_change`` is the largest difference between the brightest and the darkest exposure in
    stops: the exposure changes slowly, so that a short film has less of it, and no film more.
    ``motion_blur`` is the number of moments that are mixed in a picture (odd), and
    ``rolling_shutter_ms`` the time from the first row to the last. The pose of a frame is that of
    the middle of its exposure and of its middle row.
    """

    moving_people: int = 0
    exposure_change: float = 0.0
    motion_blur: int = 1
    rolling_shutter_ms: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        if self.moving_people < 0:
            raise ValueError(f"moving_people must be 0 or more, got {self.moving_people}")
        if self.moving_people > MOST_PEOPLE:
            raise ValueError(
                f"moving_people must be at most {MOST_PEOPLE}, got {self.moving_people}"
            )
        if not 0 <= self.exposure_change <= 8:
            raise ValueError(f"exposure_change must be 0 to 8 stops, got {self.exposure_change}")
        if self.motion_blur > MOST_MOMENTS:
            raise ValueError(f"motion_blur must be at most {MOST_MOMENTS}, got {self.motion_blur}")
        if self.motion_blur < 1 or self.motion_blur % 2 == 0:
            raise ValueError(f"motion_blur must be odd: 1, 3, 5, ..., got {self.motion_blur}")
        if not 0 <= self.rolling_shutter_ms <= 1000 / FRAME_RATE:
            raise ValueError(
                f"rolling_shutter_ms must be 0 to {1000 / FRAME_RATE:.1f}, the time of a frame, "
                f"got {self.rolling_shutter_ms}"
            )


class Film:
    """Pictures of a scene along a path, with effects."""

    def __init__(
        self,
        scene: RayCaster,
        camera: Camera,
        world_from_cam: Sequence[Pose],
        effects: Effects,
        *,
        seed: int = 0,
        step_m: float = 0.04,
    ) -> None:
        self._scene, self._camera, self._poses = scene, camera, list(world_from_cam)
        self._effects = effects
        self._people: People | None = None
        if effects.moving_people:
            if not isinstance(scene, Room):
                raise ValueError("moving_people walk through the built-in scenes only, not a mesh")
            self._people = People(scene, self._poses, effects.moving_people, seed, step_m)
        self._gains = _gains(len(self._poses), effects.exposure_change, seed)

    def frame(self, index: int, *, supersample: int = 2) -> Rendering:
        """Picture of a frame; its depth is that of the middle of the exposure."""
        count = self._effects.motion_blur
        if count == 1:
            shots = [self._at(float(index), supersample)]
        else:
            offsets = SHUTTER_FRAMES * ((np.arange(count) + 0.5) / count - 0.5)
            shots = [self._at(index + float(offset), supersample) for offset in offsets]
        middle = shots[count // 2]
        if count == 1 and self._gains[index] == 1.0:
            return middle
        light = np.mean([(shot.image / 255.0) ** GAMMA for shot in shots], axis=0)
        display = np.clip(self._gains[index] * light, 0.0, 1.0) ** (1 / GAMMA)
        return Rendering(np.round(255.0 * display).astype(np.uint8), middle.depth)

    def _at(self, time: float, supersample: int) -> Rendering:
        """Picture of one moment, or of one for each band of rows."""
        readout = self._effects.rolling_shutter_ms * FRAME_RATE / 1000
        if readout == 0.0:
            return self._scene_at(time).render(
                self._camera, pose_at(self._poses, time), supersample=supersample
            )
        height = self._camera.height
        bands = []
        for top in range(0, height, BAND_PX):
            rows = (top, min(top + BAND_PX, height))
            moment = time + readout * (sum(rows) / 2 / height - 0.5)
            band = self._scene_at(moment).render(
                self._camera, pose_at(self._poses, moment), supersample=supersample, rows=rows
            )
            bands.append((rows, band))
        image, depth = np.zeros_like(bands[0][1].image), np.zeros_like(bands[0][1].depth)
        for (top, bottom), band in bands:
            image[top:bottom], depth[top:bottom] = band.image[top:bottom], band.depth[top:bottom]
        return Rendering(image, depth)

    def _scene_at(self, time: float) -> RayCaster:
        return self._scene if self._people is None else self._people.room_at(time)


def pose_at(poses: Sequence[Pose], time: float) -> Pose:
    """Pose between two frames, at a constant rate; before the first and after the last it stays."""
    last = len(poses) - 1
    time = min(max(time, 0.0), float(last))
    before = min(math.floor(time), max(last - 1, 0))
    share = time - before
    if share == 0.0:
        return poses[before]
    first, second = poses[before], poses[before + 1]
    turn = vector_from_rotation(first.rotation.T @ second.rotation)
    return Pose(
        first.rotation @ rotation_from_vector(share * turn),
        (1 - share) * first.translation + share * second.translation,
    )


def _gains(num_frames: int, stops: float, seed: int) -> NDArray[np.float64]:
    """Factor of the light in each frame, with the brightest and the darkest no farther apart."""
    if stops == 0.0:
        return np.ones(num_frames)
    rng = np.random.Generator(np.random.PCG64([seed, 3]))
    noise = np.tanh(smooth_noise(rng, num_frames, EXPOSURE_FRAMES))
    gains: NDArray[np.float64] = 2.0 ** (0.5 * stops * noise)
    return gains
