# SPDX-License-Identifier: BSD-3-Clause
"""Furnished rooms and textured meshes, rendered for any camera with depth and pose."""

from epi360_scenes.paths import handheld_path
from epi360_scenes.rendering import Rendering
from epi360_scenes.room import SCENES, RenderedPair, Room, demo_pair, furnished_room, scene

__all__ = [
    "SCENES",
    "RenderedPair",
    "Rendering",
    "Room",
    "demo_pair",
    "furnished_room",
    "handheld_path",
    "scene",
]
