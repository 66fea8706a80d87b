# SPDX-License-Identifier: BSD-3-Clause
"""Pieces that stand in every room of a home: walls with openings, doors, blinds, beds, desks."""

from dataclasses import dataclass

import numpy as np

from epi360_scenes.furniture import FRONT, TOP, Furniture, Light, Material, Place, Span
from epi360_scenes.pieces import wall_place

WALL_M, CEILING_M = 0.06, 2.6
DOOR_WIDTH_M, DOOR_HEIGHT_M = 0.92, 2.05
OAK, WALNUT, WHITE = Material("oak", 0.9), Material("walnut", 0.9), Material("white", 1.0)
BRASS, BLACK = Material("brass", 0.5), Material("black", 0.5)


@dataclass(frozen=True)
class Shape:
    """Inner half sizes of a room along its own x and z, and where its walls are open.

    Attributes
    ----------
    half_width_m, half_depth_m : float
    openings : dict of str to tuple of float
        For each wall of `WALLS` the places of its doors, in metres to the right of its middle
        for somebody who stands with the back against the wall.
    """

    half_width_m: float
    half_depth_m: float
    openings: dict[str, tuple[float, ...]]

    def wall(self, name: str) -> Place:
        """Foot of a wall's middle, +z into the room."""
        return wall_place(name, self.half_width_m, self.half_depth_m)  # type: ignore[arg-type]

    def half_length(self, name: str) -> float:
        """Half the length of a wall."""
        return self.half_width_m if name in ("north", "south") else self.half_depth_m


def beside(place: Place, x: float, z: float, yaw: float = 0.0) -> Place:
    """Place to the right of and in front of another one, turned against it."""
    world = place.to_world((x, 0.0, z))
    return Place(world[0], world[2], place.yaw + yaw)


def open_wall(
    room: Furniture,
    place: Place,
    half: float,
    doors: tuple[float, ...],
    paint: Material,
    foot: float,
) -> None:
    """Put up a wall with a framed opening at each door.

    How far its foot is under the floor decides which part of its pattern a wall shows.
    """
    ends = [-half]
    for x in sorted(doors):
        ends += [x - DOOR_WIDTH_M / 2, x + DOOR_WIDTH_M / 2]
    ends.append(half)
    for left, right in zip(ends[::2], ends[1::2], strict=True):
        room.box(place, (left, right), (-foot, CEILING_M), (0.0, WALL_M), paint)
        room.box(place, (left, right), (0.0, 0.1), (WALL_M, WALL_M + 0.015), OAK, shadow=False)
    for x in doors:
        left, right = x - DOOR_WIDTH_M / 2, x + DOOR_WIDTH_M / 2
        room.box(place, (left, right), (DOOR_HEIGHT_M, CEILING_M), (0.0, WALL_M), paint)
        top = DOOR_HEIGHT_M + 0.08
        # A little into the opening: faces in one plane would flicker.
        for side in (left - 0.08, right - 0.01):
            room.box(place, (side, side + 0.09), (0.0, top), (-0.001, WALL_M + 0.03), OAK)
        lintel = DOOR_HEIGHT_M - 0.01
        room.box(place, (left, right), (lintel, top), (-0.001, WALL_M + 0.03), OAK)


def door_leaf(room: Furniture, wall: Place, x: float, open_rad: float) -> None:
    """Hang an open door into the room, its hinge at the opening's left end."""
    hinge = beside(wall, x - DOOR_WIDTH_M / 2 + 0.02, WALL_M + 0.03, -open_rad)
    wide = DOOR_WIDTH_M - 0.05
    room.box(hinge, (0.0, wide), (0.01, DOOR_HEIGHT_M - 0.02), (0.0, 0.04), Material("paneldoor"))
    for front in (-0.05, 0.04):
        room.box(hinge, (wide - 0.09, wide - 0.05), (0.92, 1.12), (front, front + 0.05), BRASS)


def blinds_window(room: Furniture, wall: Place, x: float, width: float) -> None:
    """Fit a window whose blinds are closed, with its sill and a radiator below."""
    left, right, sill, lintel = x - width / 2, x + width / 2, 0.9, 2.2
    front = WALL_M
    pane = Material("blinds", glow=1.25)
    room.box(wall, (left, right), (sill, lintel), (front, front + 0.02), pane, shadow=False)
    for side in (left - 0.06, x - 0.03, right):
        room.box(wall, (side, side + 0.06), (sill, lintel), (front, front + 0.06), WHITE)
    for height in (sill - 0.05, lintel):
        room.box(
            wall, (left - 0.06, right + 0.06), (height, height + 0.05), (front, front + 0.07), WHITE
        )
    room.box(wall, (left - 0.1, right + 0.1), (sill - 0.09, sill - 0.05), (front, 0.26), OAK)
    for rib in np.arange(left + 0.1, right - 0.1, 0.12):
        room.box(wall, (rib, rib + 0.08), (0.15, 0.7), (front + 0.03, 0.16), WHITE, shadow=False)
    light = wall.to_world((x, -1.6, front + 0.12))
    inward = wall.to_world((0.0, 0.0, 1.0))
    normal = (inward[0] - wall.x, 0.0, inward[2] - wall.z)
    room.lights.append(Light(light, normal, (1.9, 2.0, 2.1)))


def bed(room: Furniture, place: Place, spread: str, pillow: str) -> None:
    """Make a double bed with its head against the wall, with two bedside tables."""
    room.box(place, (-0.85, 0.85), (0.0, 1.05), (0.0, 0.06), WALNUT)
    room.box(place, (-0.82, 0.82), (0.12, 0.32), (0.06, 2.05), WALNUT)
    cover = {TOP: Material(spread), FRONT: Material(spread)}
    room.box(place, (-0.80, 0.80), (0.32, 0.55), (0.06, 2.03), Material("cream", 0.5), faces=cover)
    for x in (-0.4, 0.4):
        room.ellipsoid(place, (x, 0.63, 0.32), (0.32, 0.11, 0.2), Material(pillow, 0.6))
    for x in (-1.12, 1.12):
        room.box(place, (x - 0.22, x + 0.22), (0.0, 0.48), (0.0, 0.4), OAK)
        for low in (0.06, 0.26):
            drawer = Material("front")
            room.box(
                place, (x - 0.2, x + 0.2), (low, low + 0.18), (0.4, 0.415), drawer, shadow=False
            )
        room.ellipsoid(place, (x, 0.76, 0.2), (0.13, 0.12, 0.13), Material("cream", 0.4, glow=1.2))
        room.box(place, (x - 0.02, x + 0.02), (0.48, 0.7), (0.18, 0.22), BRASS, shadow=False)


def wardrobe(room: Furniture, place: Place) -> None:
    """Put up a wardrobe with three double doors."""
    room.box(place, (-1.05, 1.05), (0.0, 2.15), (0.0, 0.55), WALNUT)
    for x in (-0.69, 0.0, 0.69):
        front = Material("front")
        room.box(place, (x - 0.33, x + 0.33), (0.1, 2.08), (0.55, 0.575), front, shadow=False)


def table(room: Furniture, place: Place, half: Span, height: float) -> None:
    """Put down a table on four legs."""
    a, b = half
    room.box(place, (-a, a), (height - 0.04, height), (-b, b), OAK)
    for x in (-a + 0.03, a - 0.09):
        for z in (-b + 0.03, b - 0.09):
            room.box(place, (x, x + 0.06), (0.0, height - 0.04), (z, z + 0.06), OAK)


def rug(room: Furniture, place: Place, half: Span, texture: str = "rug") -> None:
    """Lay down a rug."""
    room.box(
        place, (-half[0], half[0]), (0.011, 0.022), (-half[1], half[1]), Material(texture),
        shadow=False,
    )  # fmt: skip


def sofa(room: Furniture, place: Place, cushion: str) -> None:
    """Put down a sofa of two seats with three printed cushions."""
    cloth = Material("sofa", 0.5)
    room.box(place, (-1.0, 1.0), (0.08, 0.30), (0.04, 0.9), cloth)
    room.box(place, (-1.0, 1.0), (0.30, 0.82), (0.04, 0.24), cloth)
    for x in (-1.0, 0.82):
        room.box(place, (x, x + 0.18), (0.30, 0.60), (0.04, 0.88), cloth)
    for x in (-0.81, 0.01):
        room.box(place, (x, x + 0.80), (0.305, 0.45), (0.25, 0.91), cloth)
    for x in (-0.6, -0.1, 0.55):
        room.ellipsoid(place, (x, 0.60, 0.34), (0.2, 0.19, 0.12), Material(cushion, 0.5))
