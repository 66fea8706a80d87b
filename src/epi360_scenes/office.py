# SPDX-License-Identifier: BSD-3-Clause
"""An office with equal desks in rows, as a class room or a restaurant has equal tables."""

from collections.abc import Iterator

import numpy as np
from numpy.random import Generator

from epi360_scenes.furniture import FRONT, Furniture, Material, Place, Span
from epi360_scenes.home_painting import home_atlas
from epi360_scenes.home_rooms import ART
from epi360_scenes.pieces import Wall, ceiling_lamp, chair, picture, wall_place
from epi360_scenes.room import Room
from epi360_scenes.surfaces import build_surfaces, solids_of

HALF_WIDTH_M, HALF_DEPTH_M, HEIGHT_M = 6.0, 4.5, 2.8
NUM_ROWS, DESKS_IN_ROW = 3, 5
IN_ROW_M, BETWEEN_ROWS_M = (1.9, 2.3), (2.0, 2.4)
PIECE_M = 2.0  # of floor and walls, each with a texture of its own
PAPER_SHARE = 0.6  # of the desks, on which some lies
PICTURES_A_WALL = 2
WALLS: tuple[Wall, ...] = ("east", "west", "north", "south")


def office_of_equal_desks(seed: int) -> Room:
    """An office of 12 by 9 m with 15 equal desks, its middle at the origin.

    Desks with screens and keyboards, lamps and windows are equal, and as far apart. Chairs stand a
    little differently, papers lie on some of the desks, pictures hang on three walls, and no piece
    of floor or wall is like another.
    """
    rng = np.random.Generator(np.random.PCG64([seed, 8]))
    furniture = Furniture()
    around = (-HALF_WIDTH_M, HALF_WIDTH_M), (0.0, HEIGHT_M), (-HALF_DEPTH_M, HALF_DEPTH_M)
    furniture.box(Place(0.0, 0.0), *around, Material("white", 1.0), shadow=False)
    _floor(furniture, str(rng.choice(("felt", "carpet"))))
    in_row, between_rows = rng.uniform(*IN_ROW_M), rng.uniform(*BETWEEN_ROWS_M)
    columns = (in_row * (np.arange(DESKS_IN_ROW) - (DESKS_IN_ROW - 1) / 2)).tolist()
    rows = (between_rows * (np.arange(NUM_ROWS) - (NUM_ROWS - 1) / 2)).tolist()
    for x in columns:
        for z in rows:
            _desk(furniture, Place(x, z), rng)
            ceiling_lamp(furniture, Place(x, z), HEIGHT_M)
    for wall in WALLS:
        _wall(furniture, wall, columns, rng)
    solids = solids_of(furniture)
    return Room(solids, build_surfaces(solids, furniture, home_atlas(seed, furniture.textures())))


def _pieces(half: float) -> Iterator[Span]:
    for start in np.arange(-half, half, PIECE_M).tolist():
        yield start, min(start + PIECE_M, half)


def _floor(furniture: Furniture, kind: str) -> None:
    spans = [(x, z) for x in _pieces(HALF_WIDTH_M) for z in _pieces(HALF_DEPTH_M)]
    for number, (x, z) in enumerate(spans):
        piece = Material(f"{kind}#{number}")
        furniture.box(Place(0.0, 0.0), x, (0.0, 0.004), z, piece, shadow=False)


def _desk(furniture: Furniture, place: Place, rng: Generator) -> None:
    """A desk with a screen and a keyboard, a chair, and perhaps papers."""
    furniture.box(place, (-0.8, 0.8), (0.70, 0.74), (-0.4, 0.4), Material("oak", 0.9))
    black = Material("black", 0.5)
    for left in (-0.76, 0.7):
        furniture.box(place, (left, left + 0.06), (0.0, 0.7), (-0.36, 0.36), black)
    shows = {FRONT: Material("map", glow=0.8)}
    furniture.box(place, (-0.3, 0.3), (0.86, 1.22), (-0.25, -0.22), black, faces=shows)
    furniture.box(place, (-0.05, 0.05), (0.74, 0.9), (-0.28, -0.2), black, shadow=False)
    keys = Material("blocks")
    furniture.box(place, (-0.25, 0.2), (0.74, 0.755), (0.0, 0.16), keys, shadow=False)
    if rng.random() < PAPER_SHARE:
        left = rng.uniform(0.35, 0.55)
        paper = Material(f"{rng.choice(('blocks', 'poster1', 'abstract'))}#{rng.integers(1000)}")
        furniture.box(place, (left, left + 0.21), (0.74, 0.76), (0.0, 0.3), paper, shadow=False)
    aside, behind = rng.normal(0.0, 0.08, 2)
    turned = np.pi + rng.uniform(-0.3, 0.3)
    chair(furniture, Place(place.x + aside, place.z + 0.65 + behind, turned))


def _wall(furniture: Furniture, wall: Wall, columns: list[float], rng: Generator) -> None:
    """A plastered wall with equal windows, or with pictures."""
    foot = wall_place(wall, HALF_WIDTH_M, HALF_DEPTH_M)
    half = HALF_WIDTH_M if wall in ("north", "south") else HALF_DEPTH_M
    for number, span in enumerate(_pieces(half)):
        plaster = Material(f"plaster#{wall}{number}")
        furniture.box(foot, span, (0.0, HEIGHT_M), (0.0, 0.01), plaster, shadow=False)
    if wall == "north":
        for x in columns:
            glass = Material("window", glow=1.2)
            furniture.box(foot, (x - 0.6, x + 0.6), (0.9, 2.1), (0.01, 0.03), glass, shadow=False)
        return
    for _ in range(PICTURES_A_WALL):
        art = f"{rng.choice(ART)}#{rng.integers(1000)}"
        picture(furniture, foot, rng.uniform(1.0 - half, half - 1.0), 1.6, (0.6, 0.8), art)
