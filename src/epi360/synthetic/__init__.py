# SPDX-License-Identifier: BSD-3-Clause
"""Scenes with known truth: landmarks with noise and outliers, and a room rendered with depth."""

from epi360.synthetic.landmarks import (
    TwoViewScene,
    sample_relative_pose,
    sample_von_mises_fisher,
    two_view_scene,
)
from epi360.synthetic.room import RenderedPair, Rendering, Room, demo_pair, furnished_room

__all__ = [
    "RenderedPair",
    "Rendering",
    "Room",
    "TwoViewScene",
    "demo_pair",
    "furnished_room",
    "sample_relative_pose",
    "sample_von_mises_fisher",
    "two_view_scene",
]
