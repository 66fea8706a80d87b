# SPDX-License-Identifier: BSD-3-Clause
"""Tracks in rendered sequences, which stand for MINOS + Matterport3D and TUM-VI."""

import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from epi360.cameras import Camera, Equirectangular, KannalaBrandt
from epi360_paper.tracks import BearingPair, PairRule, cached_pairs, pairs_of_frames
from epi360_paper.trials import Trial
from epi360_scenes.paths import handheld_path
from epi360_scenes.room import SceneName
from epi360_scenes.room import scene as make_scene

Lens = Literal["360", "fisheye"]

PAIRS_PER_SEQUENCE = 12
# A walk of 1.2 m/s at 15 frames a second: tracks live as long as at 30, with half the pictures.
STEP_M, MAX_TURN_DEG = 0.08, 4.0
SCENE_NAMES: tuple[SceneName, ...] = get_args(SceneName)
NUM_FRAMES = 22  # enough for 12 pairs of about seven frames when the walker slows down


@dataclass(frozen=True)
class RenderedTracks:
    """Where the tracks of rendered sequences come from."""

    lens: Lens  # full panoramas, or a lens of 195 degrees like that of TUM-VI
    # Width of the panoramas; fisheye images have half of it, about as many pixels per degree.
    image_width: int
    rule: PairRule  # what makes a pair
    cache: Path = field(repr=False)  # folder of the tracks, which do not depend on it
    num_frames: int = NUM_FRAMES  # frames of a sequence

    def camera(self) -> Camera:
        """Camera of all sequences."""
        if self.lens == "360":
            return Equirectangular(self.image_width, self.image_width // 2)
        return fisheye_camera(self.image_width // 2)

    def pairs(self, trial: Trial) -> list[BearingPair]:
        """Pairs of one sequence, rendered and tracked unless they are kept."""
        # The scenes take turns, each time furnished anew; both lenses see the same scenes from the
        # same paths, and all experiments with one seed the same sequences.
        state = np.random.SeedSequence((trial.seed, zlib.crc32(b"rendered tracks"), trial.index))
        scene_seed, path_seed = (int(word) for word in state.generate_state(2))
        scene = SCENE_NAMES[trial.index % len(SCENE_NAMES)]
        key = f"{self!r} {scene} {scene_seed} {path_seed} {STEP_M} {MAX_TURN_DEG}"
        return cached_pairs(self.cache, key, lambda: self._render(scene, scene_seed, path_seed))

    def _render(self, scene: SceneName, scene_seed: int, path_seed: int) -> list[BearingPair]:
        room, camera = make_scene(scene, scene_seed), self.camera()
        path = handheld_path(
            room, self.num_frames, path_seed, step_m=STEP_M, max_turn_deg=MAX_TURN_DEG
        )
        images = [room.render(camera, pose, num_threads=1).image for pose in path]
        return pairs_of_frames(images.__getitem__, path, camera, self.rule)[:PAIRS_PER_SEQUENCE]


def fisheye_camera(size: int) -> KannalaBrandt:
    """Lens of 195 degrees on a square image, shaped like camera 0 of TUM-VI."""
    # The image cuts the circle at its sides, 77 deg from the axis, and keeps it in the corners.
    focal = 0.373 * size  # 191 px for 512 px in the calibration of TUM-VI
    coefficients = (0.0034, 0.0007, -0.002, 0.0002)
    center = size / 2
    lens = (focal, focal, center, center, *coefficients)
    return KannalaBrandt(size, size, *lens, max_angle_deg=97.5)
