# SPDX-License-Identifier: BSD-3-Clause
"""Pieces of furniture that several rooms have: lamps, shelves, chairs, plants, pictures."""

from typing import Literal

import numpy as np

from epi360_scenes.furniture import Furniture, Light, Material, Place, Span

Wall = Literal["north", "east", "south", "west"]
WALLS: tuple[Wall, ...] = ("north", "east", "south", "west")


def wall_place(wall: Wall, half_width_m: float, half_depth_m: float) -> Place:
    """Origin at the foot of a wall's middle, +z into a room of these half sizes."""
    places = {
        "north": Place(0.0, half_depth_m, np.pi),
        "east": Place(half_width_m, 0.0, -np.pi / 2),
        "south": Place(0.0, -half_depth_m, 0.0),
        "west": Place(-half_width_m, 0.0, np.pi / 2),
    }
    return places[wall]


def floor_at(place: Place, x: float, z: float) -> tuple[float, float]:
    """World x and z of a point beside and in front of a place."""
    world = place.to_world((x, 0.0, z))
    return world[0], world[2]


def legs(
    room: Furniture, place: Place, xs: Span, zs: Span, width: float, heights: Span, wood: Material
) -> None:
    """Four square legs, whose lower corners are at the given places."""
    for x in xs:
        for z in zs:
            room.box(place, (x, x + width), heights, (z, z + width), wood)


def ceiling_lamp(room: Furniture, place: Place, ceiling_m: float) -> None:
    """Hang a square lamp under a ceiling of this height."""
    glow = Material("white", 1.0, glow=2.2)
    for half, low, high, material in (
        (0.17, ceiling_m - 0.05, ceiling_m - 0.01, glow),
        (0.19, ceiling_m - 0.03, ceiling_m, Material("brass", 0.5)),
    ):
        room.box(place, (-half, half), (low, high), (-half, half), material, shadow=False)
    room.lights.append(
        Light((place.x, 0.1 - ceiling_m, place.z), (0.0, 1.0, 0.0), (1.15, 1.02, 0.82))
    )


def bookshelf(room: Furniture, place: Place, rng: np.random.Generator) -> None:
    """Put up shelves of 1.9 x 2.2 m full of books."""
    wood = Material("walnut", 0.8)
    room.box(place, (-0.95, 0.95), (0.0, 2.2), (0.0, 0.02), wood)
    for x in (-0.95, -0.32, 0.30, 0.92):
        room.box(place, (x, x + 0.03), (0.0, 2.2), (0.0, 0.32), wood)
    levels = np.linspace(0.08, 2.17, 7)
    for height in levels:
        room.box(place, (-0.95, 0.95), (height, height + 0.03), (0.0, 0.32), wood)
    for level in levels[:-1] + 0.03:
        for x in (-0.92, -0.29, 0.33):
            kind, height, depth = rng.random(), rng.uniform(0.22, 0.29), rng.uniform(0.19, 0.29)
            end = x + (0.59 if kind < 0.55 else rng.uniform(0.25, 0.42))
            books = Material(f"books{rng.integers(1, 4)}", 0.59)
            room.box(place, (x, end), (level, level + height), (0.02, depth), books, shadow=False)
            if end < x + 0.5:
                ornament(room, place, (end + x + 0.59) / 2, level, 0.16, rng)


def ornament(
    room: Furniture, place: Place, x: float, height: float, z: float, rng: np.random.Generator
) -> None:
    """Put down a vase, a ball or a few lying books."""
    kind = rng.integers(4)
    color = Material(str(rng.choice(["terracotta", "cushion1", "brass", "cushion2"])), 0.4)
    if kind == 0:
        room.ellipsoid(place, (x, height + 0.10, z), (0.055, 0.10, 0.055), color)
        room.ellipsoid(place, (x, height + 0.19, z), (0.028, 0.045, 0.028), color)
    elif kind == 1:
        radius = float(rng.uniform(0.05, 0.075))
        room.ellipsoid(place, (x, height + radius, z), (radius, radius, radius), color)
    else:
        for layer in range(int(rng.integers(2, 5))):
            book = Material(str(rng.choice(["poster1", "abstract", "blocks", "sofa"])))
            low = height + 0.035 * layer
            room.box(
                place, (x - 0.07, x + 0.06), (low, low + 0.032), (z - 0.09, z + 0.10), book,
                shadow=False,
            )  # fmt: skip


def potted_plant(
    room: Furniture, place: Place, foot: float, size: float, rng: np.random.Generator
) -> None:
    """Put down a plant in a pot of this size on something of the height `foot`."""
    pot = Material("terracotta", 0.5)
    room.box(place, (-size / 2, size / 2), (foot, foot + size), (-size / 2, size / 2), pot)
    for _ in range(7):
        x, z = rng.uniform(-0.7, 0.7, 2) * size
        height = foot + size * rng.uniform(1.2, 2.6)
        radii = rng.uniform(0.35, 0.7, 3) * size
        leaves = Material("leaves", float(4 * size))
        room.ellipsoid(place, (x, height, z), (radii[0], radii[1], radii[2]), leaves)


def picture(
    room: Furniture, place: Place, x: float, height: float, size: Span, texture: str
) -> None:
    """Hang up a picture with its middle at this height."""
    half_w, half_h = size[0] / 2, size[1] / 2
    edge = 0.025
    frame = Material("black" if texture in ("blocks", "circles") else "walnut", 0.5)
    room.box(
        place, (x - half_w - edge, x + half_w + edge),
        (height - half_h - edge, height + half_h + edge), (0.0, 0.022), frame, shadow=False,
    )  # fmt: skip
    room.box(
        place, (x - half_w, x + half_w), (height - half_h, height + half_h), (0.0, 0.027),
        Material(texture), shadow=False,
    )  # fmt: skip


def chair(room: Furniture, place: Place) -> None:
    """Chair that looks along its +z."""
    wood, seat = Material("oak", 0.5), Material("chair", 0.5)
    for x in (-0.21, 0.17):
        room.box(place, (x, x + 0.04), (0.0, 0.43), (0.17, 0.21), wood)
        room.box(place, (x, x + 0.04), (0.0, 0.90), (-0.21, -0.17), wood)
    room.box(place, (-0.22, 0.22), (0.43, 0.48), (-0.21, 0.22), seat)
    for height in (0.60, 0.75):
        room.box(place, (-0.17, 0.17), (height, height + 0.10), (-0.205, -0.18), wood)
