# SPDX-License-Identifier: BSD-3-Clause
"""Where the tests' rendered pictures come from, so that a move of the renderer is one line here."""

from epi360.synthetic import (
    demo_pair,
    directions,
    furnished_room,
    furniture,
    pieces,
    raycast,
    scene,
    walks,
)

__all__ = [
    "demo_pair",
    "directions",
    "furnished_room",
    "furniture",
    "pieces",
    "raycast",
    "scene",
    "walks",
]
