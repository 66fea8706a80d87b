# SPDX-License-Identifier: BSD-3-Clause
"""The furnished living room, wall by wall."""

import numpy as np

from epi360_scenes.furniture import FRONT, TOP, Furniture, Light, Material, Place
from epi360_scenes.pieces import (
    WALLS,
    Wall,
    bookshelf,
    ceiling_lamp,
    chair,
    floor_at,
    legs,
    ornament,
    picture,
    potted_plant,
    wall_place,
)

ROOM_HALF_WIDTH_M, ROOM_HALF_DEPTH_M, ROOM_HEIGHT_M = 3.0, 2.5, 2.7


def _on_wall(wall: Wall) -> Place:
    return wall_place(wall, ROOM_HALF_WIDTH_M, ROOM_HALF_DEPTH_M)


def furnish_living_room(rng: np.random.Generator) -> Furniture:
    """List everything in the living room, its shell first."""
    room = Furniture()
    _shell(room)
    _north_wall(room, rng)
    _east_wall(room, rng)
    _south_wall(room, rng)
    _west_wall(room, rng)
    _dining(room, Place(-1.15, 0.25, rng.uniform(-0.12, 0.12)), rng)
    _coffee_corner(room, rng)
    return room


def _shell(room: Furniture) -> None:
    half_w, half_d = ROOM_HALF_WIDTH_M, ROOM_HALF_DEPTH_M
    walls = Material("cream", 3.0)
    faces = {
        2: Material("ceiling", 2.5),
        3: Material("planks", 1.6),
        0: Material("bricks", 1.15),
        1: Material("sage", 3.0),
    }
    center = Place(0.0, 0.0)
    span_x, span_z = (-half_w, half_w), (-half_d, half_d)
    room.box(center, span_x, (0.0, ROOM_HEIGHT_M), span_z, walls, faces=faces, shadow=False)
    white, beam = Material("white", 1.0), Material("oak", 0.9)
    for wall in WALLS:
        half = half_w if wall in ("north", "south") else half_d
        room.box(_on_wall(wall), (-half, half), (0.0, 0.09), (0.0, 0.015), white, shadow=False)
    for x in (-1.9, 0.0, 1.9):
        room.box(center, (x - 0.07, x + 0.07), (2.54, ROOM_HEIGHT_M), span_z, beam)
    for x, z in ((-0.95, -1.2), (-0.95, 1.2), (0.95, -1.2), (0.95, 1.2)):
        ceiling_lamp(room, Place(x, z), ROOM_HEIGHT_M)


def _north_wall(room: Furniture, rng: np.random.Generator) -> None:
    wall = _on_wall("north")
    white, view = Material("white", 1.0), Material("window", glow=1.5)
    left, right, sill, lintel = -2.0, -0.1, 0.85, 2.3
    room.box(wall, (left, right), (sill, lintel), (0.0, 0.02), view, shadow=False)
    middle = (left + right) / 2
    for x in (left, middle, right):
        room.box(wall, (x - 0.04, x + 0.04), (sill, lintel), (0.0, 0.07), white, shadow=False)
    for height in (sill, 1.85, lintel):
        room.box(
            wall, (left - 0.04, right + 0.04), (height - 0.03, height + 0.03), (0.0, 0.07), white,
            shadow=False,
        )  # fmt: skip
    room.box(wall, (left - 0.1, right + 0.1), (0.79, 0.83), (0.0, 0.24), Material("oak", 0.9))
    curtain = Material("curtain", 0.7)
    for x in (left - 0.33, right + 0.03):
        room.box(wall, (x, x + 0.3), (0.12, 2.42), (0.06, 0.14), curtain)
    room.box(wall, (left - 0.4, right + 0.4), (2.42, 2.46), (0.08, 0.12), Material("brass", 0.5))
    for x in np.arange(-1.75, -0.4, 0.1):
        room.box(wall, (x, x + 0.075), (0.14, 0.68), (0.04, 0.14), white, shadow=False)
    for x in (-1.75, -1.05, -0.35):
        light = wall.to_world((x, -1.6, 0.15))
        room.lights.append(Light(light, (0.0, 0.0, -1.0), (1.5, 1.62, 1.8)))
    for x in (-1.7, -0.5):
        potted_plant(room, Place(*floor_at(wall, x, 0.13)), 0.83, 0.09, rng)
    bookshelf(room, Place(*floor_at(wall, 1.75, 0.0), wall.yaw), rng)


def _east_wall(room: Furniture, rng: np.random.Generator) -> None:
    wall = _on_wall("east")
    cloth, dark = Material("sofa", 0.5), Material("walnut", 0.6)
    room.box(wall, (-1.1, 1.1), (0.10, 0.28), (0.06, 0.92), cloth)
    room.box(wall, (-1.1, 1.1), (0.28, 0.80), (0.06, 0.26), cloth)
    for x in (-1.1, 0.92):
        room.box(wall, (x, x + 0.18), (0.28, 0.60), (0.06, 0.90), cloth)
    for x in (-0.91, 0.01):
        room.box(wall, (x, x + 0.90), (0.285, 0.44), (0.27, 0.93), cloth)
    legs(room, wall, (-1.0, 0.9), (0.12, 0.78), 0.06, (0.0, 0.10), dark)
    for x, cushion in ((-0.62, "cushion1"), (-0.22, "chair"), (0.60, "cushion2")):
        room.ellipsoid(wall, (x, 0.60, 0.36), (0.10, 0.19, 0.21), Material(cushion, 0.5))
    _side_table(room, Place(*floor_at(wall, -1.62, 0.35)))
    potted_plant(room, Place(*floor_at(wall, 1.85, 0.45), 0.3), 0.0, 0.34, rng)
    art = rng.permutation(["landscape", "abstract", "circles"])
    for x, name, size in zip(
        (-0.95, 0.0, 0.85), art, ((0.6, 0.6), (0.95, 0.7), (0.5, 0.7)), strict=True
    ):
        picture(room, wall, x, 1.60 + rng.uniform(-0.05, 0.05), size, str(name))
    picture(room, wall, -1.75, 1.75, (0.42, 0.55), "poster2")
    picture(room, wall, 1.65, 1.85, (0.42, 0.42), "blocks")


def _side_table(room: Furniture, place: Place) -> None:
    wood = Material("oak", 0.6)
    room.box(place, (-0.24, 0.24), (0.48, 0.52), (-0.24, 0.24), wood)
    legs(room, place, (-0.22, 0.18), (-0.22, 0.18), 0.04, (0.0, 0.48), wood)
    room.ellipsoid(place, (0.0, 0.62, 0.0), (0.08, 0.11, 0.08), Material("brass", 0.5))
    shade = Material("cream", 0.6, glow=1.25)
    room.ellipsoid(place, (0.0, 0.86, 0.0), (0.17, 0.14, 0.17), shade)
    room.lights.append(Light((place.x, -0.95, place.z), (0.0, 0.0, 0.0), (0.20, 0.15, 0.09)))


def _south_wall(room: Furniture, rng: np.random.Generator) -> None:
    wall, wood = _on_wall("south"), Material("oak", 0.9)
    room.box(wall, (1.5, 2.4), (0.0, 2.05), (0.0, 0.03), Material("door"), shadow=False)
    for x in (1.42, 2.40):
        room.box(wall, (x, x + 0.08), (0.0, 2.13), (0.0, 0.06), Material("white", 1.0))
    room.box(wall, (1.42, 2.48), (2.05, 2.13), (0.0, 0.06), Material("white", 1.0))
    room.ellipsoid(wall, (1.60, 1.02, 0.07), (0.03, 0.03, 0.03), Material("brass", 0.5))
    room.box(wall, (-2.1, 0.3), (0.08, 0.72), (0.0, 0.42), wood)
    for left in np.linspace(-2.08, -0.28, 4):
        drawer = Material("walnut" if rng.random() < 0.4 else "white", 0.9)
        room.box(wall, (left, left + 0.56), (0.11, 0.69), (0.41, 0.435), drawer, shadow=False)
        room.box(
            wall, (left + 0.25, left + 0.31), (0.60, 0.615), (0.435, 0.46), Material("brass", 0.5),
            shadow=False,
        )  # fmt: skip
    for x in (-1.85, -1.45, -0.35, 0.05):
        ornament(room, wall, x + rng.uniform(-0.05, 0.05), 0.72, 0.22, rng)
    potted_plant(room, Place(*floor_at(wall, -0.9, 0.22)), 0.72, 0.15, rng)
    picture(room, wall, -0.95, 1.62, (1.35, 0.85), "map")
    picture(room, wall, 0.42, 1.65, (0.5, 0.7), "poster1")
    picture(room, wall, 1.02, 1.55, (0.34, 0.44), str(rng.choice(["abstract", "circles"])))
    picture(room, wall, -2.3, 1.55, (0.5, 0.65), str(rng.choice(["landscape", "blocks"])))
    room.box(wall, (2.58, 2.66), (1.05, 1.17), (0.0, 0.015), Material("white", 0.5), shadow=False)


def _west_wall(room: Furniture, rng: np.random.Generator) -> None:
    wall, wood = _on_wall("west"), Material("oak", 0.9)
    for left, right, height in ((-1.9, -0.7, 1.35), (-1.7, -0.5, 1.75), (0.9, 2.1, 1.55)):
        room.box(wall, (left, right), (height, height + 0.03), (0.0, 0.24), wood)
        x = left + 0.04
        while x < right - 0.3:
            width = float(rng.uniform(0.2, 0.4))
            books = Material(f"books{rng.integers(1, 4)}", 0.55)
            top = height + 0.03 + rng.uniform(0.18, 0.26)
            room.box(wall, (x, x + width), (height + 0.03, top), (0.01, 0.18), books, shadow=False)
            x += width + 0.14
            ornament(room, wall, x - 0.07, height + 0.03, 0.11, rng)
    dark = Material("walnut", 0.9)
    room.box(wall, (0.7, 2.2), (0.72, 0.76), (0.0, 0.6), dark)
    for x in (0.72, 1.75):
        room.box(wall, (x, x + 0.43), (0.08, 0.72), (0.02, 0.55), dark)
    room.box(wall, (1.15, 1.75), (0.86, 1.22), (0.14, 0.17), Material("black", 0.5),
             faces={FRONT: Material("landscape", glow=0.9)})  # fmt: skip
    room.box(wall, (1.41, 1.49), (0.76, 0.86), (0.10, 0.18), Material("black", 0.5), shadow=False)
    page = Material("poster2")
    room.box(wall, (0.85, 1.06), (0.76, 0.775), (0.25, 0.52), page, shadow=False)
    room.ellipsoid(wall, (2.02, 0.83, 0.25), (0.05, 0.07, 0.05), Material("cushion1", 0.3))
    chair(room, Place(*floor_at(wall, 1.4, 0.95), wall.yaw + np.pi + rng.uniform(-0.4, 0.4)))
    room.box(wall, (0.02, 0.34), (1.90, 2.22), (0.0, 0.03), Material("clock"), shadow=False)
    picture(room, wall, 0.15, 1.35, (0.5, 0.66), str(rng.choice(["circles", "poster2"])))
    picture(room, wall, -2.1, 0.95, (0.4, 0.5), "abstract")
    room.box(wall, (-1.6, -0.6), (0.0, 0.45), (0.02, 0.42), Material("white", 0.9),
             faces={TOP: Material("cushion2", 0.8)})  # fmt: skip


def _dining(room: Furniture, place: Place, rng: np.random.Generator) -> None:
    wood = Material("walnut", 0.9)
    room.box(place, (-0.45, 0.45), (0.70, 0.745), (-0.75, 0.75), wood)
    legs(room, place, (-0.40, 0.33), (-0.70, 0.63), 0.07, (0.0, 0.70), wood)
    for side, z in ((-1, -0.35), (-1, 0.38), (1, -0.38), (1, 0.35)):
        x = side * (0.58 + rng.uniform(-0.05, 0.1))
        turn = place.yaw - side * np.pi / 2 + rng.uniform(-0.3, 0.3)
        chair(room, Place(*floor_at(place, x, z), turn))
        plate = (0.27 * side, 0.755, z * 0.95)
        room.ellipsoid(place, plate, (0.11, 0.012, 0.11), Material("ceiling", 0.5))
    room.box(
        place, (-0.17, 0.17), (0.745, 0.749), (-0.72, 0.72), Material("cushion1", 0.5), shadow=False
    )
    room.ellipsoid(place, (0.0, 0.78, 0.0), (0.15, 0.05, 0.15), Material("terracotta", 0.5))
    for x, z in ((-0.05, 0.03), (0.06, 0.04), (0.0, -0.06)):
        fruit = Material(str(rng.choice(["brass", "leaves", "terracotta"])), 0.4)
        room.ellipsoid(place, (x, 0.85, z), (0.042, 0.042, 0.042), fruit)
    ornament(room, place, 0.0, 0.749, 0.42, rng)
    room.box(place, (-0.006, 0.006), (1.98, 2.7), (-0.006, 0.006), Material("black", 0.5))
    room.ellipsoid(place, (0.0, 1.88, 0.0), (0.2, 0.13, 0.2), Material("cream", 0.5, glow=1.3))


def _coffee_corner(room: Furniture, rng: np.random.Generator) -> None:
    rug = Place(1.25, -0.05, rng.uniform(-0.05, 0.05))
    room.box(rug, (-0.95, 0.95), (0.0, 0.012), (-1.3, 1.3), Material("rug"), shadow=False)
    place, wood = Place(1.25, 0.0, rng.uniform(-0.15, 0.15)), Material("oak", 0.8)
    room.box(place, (-0.32, 0.32), (0.36, 0.40), (-0.55, 0.55), wood)
    room.box(place, (-0.27, 0.27), (0.14, 0.16), (-0.50, 0.50), wood)
    legs(room, place, (-0.31, 0.26), (-0.54, 0.49), 0.05, (0.012, 0.36), wood)
    ornament(room, place, 0.1, 0.40, 0.3, rng)
    magazine = Material(str(rng.choice(["poster1", "blocks"])))
    room.box(place, (-0.2, 0.02), (0.40, 0.41), (-0.1, 0.18), magazine, shadow=False)
    room.box(
        place, (-0.1, 0.14), (0.40, 0.415), (-0.45, -0.15), Material("landscape"), shadow=False
    )
    pouf = Place(0.35 + rng.uniform(-0.1, 0.1), -1.75, rng.uniform(0, 1.5))
    room.box(pouf, (-0.22, 0.22), (0.0, 0.38), (-0.22, 0.22), Material("cushion2", 0.6))
