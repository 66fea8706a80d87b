# SPDX-License-Identifier: BSD-3-Clause
"""Readers of image sequences with known poses: MP3D-VO, TUM-VI and plain folders."""

from epi360_paper.datasets.image_folder import load_image_folder
from epi360_paper.datasets.mp3d_vo import find_mp3d_vo_scenes, load_mp3d_vo
from epi360_paper.datasets.sequence import ImageSequence
from epi360_paper.datasets.steadiness import SkipRule, steady_segments
from epi360_paper.datasets.tum_vi import find_tum_vi_rooms, load_tum_vi

__all__ = [
    "ImageSequence", "SkipRule", "find_mp3d_vo_scenes", "find_tum_vi_rooms", "load_image_folder",
    "load_mp3d_vo", "load_tum_vi", "steady_segments",
]  # fmt: skip
