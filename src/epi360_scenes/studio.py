# SPDX-License-Identifier: BSD-3-Clause
"""The studio: one busy end, three plain walls, so that key points crowd on one side."""

import numpy as np

from epi360_scenes.furniture import FRONT, Furniture, Light, Material, Place
from epi360_scenes.pieces import (
    Wall,
    bookshelf,
    ceiling_lamp,
    chair,
    floor_at,
    ornament,
    picture,
    potted_plant,
    wall_place,
)

STUDIO_HALF_WIDTH_M, STUDIO_HALF_DEPTH_M, STUDIO_HEIGHT_M = 3.8, 2.4, 2.9


def furnish_studio(rng: np.random.Generator) -> Furniture:
    """List everything in the studio, its shell first."""
    room = Furniture()
    _shell(room)
    _busy_east_wall(room, rng)
    _reading_corner(room, rng)
    _plain_north_wall(room)
    _plain_west_wall(room)
    _plain_south_wall(room, rng)
    _plain_table(room, Place(-1.75, -0.35, rng.uniform(-0.2, 0.2)), rng)
    return room


def _on_wall(wall: Wall) -> Place:
    return wall_place(wall, STUDIO_HALF_WIDTH_M, STUDIO_HALF_DEPTH_M)


def _shell(room: Furniture) -> None:
    half_w, half_d = STUDIO_HALF_WIDTH_M, STUDIO_HALF_DEPTH_M
    faces = {3: Material("screed", 3.0)}
    spans = (-half_w, half_w), (0.0, STUDIO_HEIGHT_M), (-half_d, half_d)
    plaster = Material("plaster", 3.0)
    room.box(Place(0.0, 0.0), *spans, plaster, faces=faces, shadow=False)
    for x in (-2.2, 0.2, 2.4):
        ceiling_lamp(room, Place(x, 0.0), STUDIO_HEIGHT_M)


def _busy_east_wall(room: Furniture, rng: np.random.Generator) -> None:
    wall = _on_wall("east")
    bookshelf(room, Place(*floor_at(wall, -1.35, 0.0), wall.yaw), rng)
    dark, board = Material("walnut", 0.9), Material("oak", 0.9)
    room.box(wall, (0.0, 1.9), (0.72, 0.76), (0.0, 0.7), dark)
    for x in (0.02, 1.45):
        room.box(wall, (x, x + 0.43), (0.08, 0.72), (0.02, 0.65), dark)
    screen = {FRONT: Material("landscape", glow=0.9)}
    room.box(wall, (0.6, 1.25), (0.86, 1.24), (0.14, 0.17), Material("black", 0.5), faces=screen)
    room.box(wall, (0.88, 0.97), (0.76, 0.86), (0.1, 0.18), Material("black", 0.5), shadow=False)
    for x, texture in ((0.12, "poster2"), (1.4, "blocks")):
        turned = Material(texture)
        room.box(wall, (x, x + 0.22), (0.76, 0.775), (0.25, 0.53), turned, shadow=False)
    ornament(room, wall, 1.75, 0.76, 0.3, rng)
    chair(room, Place(*floor_at(wall, 0.95, 1.05), wall.yaw + np.pi + rng.uniform(-0.4, 0.4)))
    prints = rng.permutation(["abstract", "circles", "landscape", "poster1", "blocks", "map"])
    places = [(0.3, 1.62), (0.95, 1.68), (1.6, 1.62), (0.3, 2.3), (0.95, 2.34), (1.6, 2.3)]
    for (x, height), name in zip(places, prints, strict=True):
        picture(room, wall, x, height + rng.uniform(-0.03, 0.03), (0.46, 0.5), str(name))
    room.box(wall, (-0.1, 2.1), (2.68, 2.71), (0.0, 0.26), board)
    for x in np.arange(0.0, 1.7, 0.42):
        books = Material(f"books{rng.integers(1, 4)}", 0.55)
        width = float(rng.uniform(0.24, 0.38))
        room.box(wall, (x, x + width), (2.71, 2.87), (0.01, 0.18), books, shadow=False)
    potted_plant(room, Place(*floor_at(wall, 2.12, 0.4)), 0.0, 0.32, rng)


def _reading_corner(room: Furniture, rng: np.random.Generator) -> None:
    rug = Place(2.35, 0.95, rng.uniform(-0.08, 0.08))
    room.box(rug, (-0.8, 0.8), (0.0, 0.012), (-1.0, 1.0), Material("rug"), shadow=False)
    seat, cloth = Place(2.3, 1.7, np.pi + rng.uniform(-0.15, 0.15)), Material("sofa", 0.5)
    room.box(seat, (-0.42, 0.42), (0.1, 0.42), (-0.38, 0.4), cloth)
    room.box(seat, (-0.42, 0.42), (0.42, 0.92), (-0.4, -0.2), cloth)
    for x in (-0.42, 0.28):
        room.box(seat, (x, x + 0.14), (0.42, 0.62), (-0.3, 0.4), cloth)
    room.ellipsoid(seat, (0.05, 0.60, -0.08), (0.2, 0.18, 0.11), Material("cushion1", 0.5))
    table = Place(3.05, 0.75, rng.uniform(-0.3, 0.3))
    room.box(table, (-0.25, 0.25), (0.46, 0.49), (-0.25, 0.25), Material("oak", 0.6))
    room.box(table, (-0.05, 0.05), (0.0, 0.46), (-0.05, 0.05), Material("oak", 0.6))
    ornament(room, table, 0.05, 0.49, 0.05, rng)


def _plain_north_wall(room: Furniture) -> None:
    wall = _on_wall("north")
    pane = Material("lacquer", 2.0, glow=1.15)
    for left in (0.3, 1.75):
        room.box(wall, (left, left + 1.3), (1.1, 2.4), (0.0, 0.02), pane, shadow=False)
        room.box(
            wall, (left - 0.06, left + 1.36), (1.02, 1.08), (0.0, 0.12), Material("lacquer", 2.0)
        )
        light = wall.to_world((left + 0.65, -1.75, 0.15))
        room.lights.append(Light(light, (0.0, 0.0, -1.0), (2.1, 2.2, 2.3)))


def _plain_west_wall(room: Furniture) -> None:
    wall, lacquer = _on_wall("west"), Material("lacquer", 2.0)
    room.box(wall, (-2.4, -0.6), (0.0, 2.3), (0.0, 0.6), lacquer)
    for left in (-2.38, -1.48):
        room.box(wall, (left, left + 0.86), (0.05, 2.27), (0.6, 0.62), lacquer, shadow=False)
    room.box(wall, (0.2, 2.1), (0.0, 0.42), (0.05, 0.6), Material("felt", 1.0))


def _plain_south_wall(room: Furniture, rng: np.random.Generator) -> None:
    wall = _on_wall("south")
    white = Material("lacquer", 2.0)
    room.box(wall, (-3.1, -2.2), (0.0, 2.05), (0.0, 0.04), white, shadow=False)
    room.ellipsoid(wall, (-2.3, 1.02, 0.08), (0.03, 0.03, 0.03), Material("brass", 0.5))
    room.box(wall, (-0.9, 1.0), (0.3, 0.75), (0.0, 0.4), white)
    ornament(room, wall, float(rng.uniform(-0.6, 0.6)), 0.75, 0.2, rng)


def _plain_table(room: Furniture, place: Place, rng: np.random.Generator) -> None:
    white, felt = Material("lacquer", 2.0), Material("felt", 1.0)
    room.box(place, (-0.4, 0.4), (0.7, 0.74), (-0.75, 0.75), white)
    for z in (-0.6, 0.5):
        room.box(place, (-0.3, 0.3), (0.0, 0.7), (z, z + 0.1), white)
    for x, z in ((-0.65, -0.3), (-0.68, 0.35), (0.65, 0.05)):
        stool = Place(*floor_at(place, x, z), place.yaw + rng.uniform(-0.4, 0.4))
        room.box(stool, (-0.2, 0.2), (0.0, 0.45), (-0.2, 0.2), felt)
    room.ellipsoid(place, (0.05, 0.76, 0.2), (0.14, 0.03, 0.14), felt)
    room.box(place, (-0.006, 0.006), (2.0, STUDIO_HEIGHT_M), (-0.006, 0.006), felt)
    room.ellipsoid(place, (0.0, 1.9, 0.0), (0.2, 0.13, 0.2), Material("lacquer", 1.0, glow=1.2))
