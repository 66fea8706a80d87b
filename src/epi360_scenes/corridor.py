# SPDX-License-Identifier: BSD-3-Clause
"""A corridor with equal doors, as of a hotel or an office: the next door looks like this one."""

from collections.abc import Iterator

import numpy as np
from numpy.random import Generator

from epi360_scenes.furniture import FRONT, Furniture, Light, Material, Place, Span
from epi360_scenes.home_painting import home_atlas
from epi360_scenes.home_rooms import ART
from epi360_scenes.pieces import Wall, ceiling_lamp, picture, wall_place
from epi360_scenes.room import Room
from epi360_scenes.surfaces import build_surfaces, solids_of

HALF_LENGTH_M = 14.0
WIDTHS_M, HEIGHTS_M = (1.7, 2.3), (2.4, 2.9)
DOORS_M, LAMPS_M = (3.0, 4.2), (1.8, 4.8)  # from one to the next
DOOR_WIDTH_M, DOOR_HEIGHT_M = 0.9, 2.05
PIECE_M = 2.0  # of floor and walls, each with a texture of its own
PLAIN_FLOORS, FLOORS = ("screed", "felt"), ("carpet", "laminate")
PICTURE_SHARE = 0.3  # of the doors, beside which one hangs


def corridor_of_equal_doors(seed: int, *, plain_floor: bool) -> Room:
    """A corridor of 28 m with equal doors at equal distances, its middle at the origin.

    Parameters
    ----------
    seed : int
        Decides sizes, distances, textures and what there is once.
    plain_floor : bool
        Whether the floor is nearly without texture.

    Returns
    -------
    room : Room
        Its corridor runs along z.

    Notes
    -----
    Walls, floor and ceiling do not repeat, but show little. The ends differ, every door has a
    number of its own, and pictures hang beside some; the rest of what one sees are equal doors
    and lamps.
    """
    rng = np.random.Generator(np.random.PCG64([seed, 5]))
    half_width, height = rng.uniform(*WIDTHS_M) / 2, rng.uniform(*HEIGHTS_M)
    furniture = Furniture()
    span = (-HALF_LENGTH_M, HALF_LENGTH_M)
    around = (-half_width, half_width), (0.0, height), span
    furniture.box(Place(0.0, 0.0), *around, Material("white", 1.0), shadow=False)
    _floor(furniture, half_width, rng, plain=plain_floor)
    _ends(furniture, half_width, rng)
    both_sides, staggered = rng.random(2) < (0.7, 0.5)
    distance = rng.uniform(*DOORS_M)
    door, frame = rng.choice(["door", "paneldoor", "walnut"]), rng.choice(["oak", "black"])
    sides: tuple[Wall, ...] = ("east", "west")
    for side, wall in enumerate(sides):
        foot = wall_place(wall, half_width, HALF_LENGTH_M)
        _plastered(furniture, foot, height, side)
        if side == 0 or both_sides:
            first = distance / 2 * (1 + (side == 1 and staggered))
            for place in np.arange(first - HALF_LENGTH_M, HALF_LENGTH_M - 1.2, distance):
                _door(furniture, foot, float(place), str(door), str(frame), rng)
    for place in np.arange(*span, rng.uniform(*LAMPS_M))[1:]:
        ceiling_lamp(furniture, Place(0.0, float(place)), height)
    solids = solids_of(furniture)
    return Room(solids, build_surfaces(solids, furniture, home_atlas(seed, furniture.textures())))


def _pieces() -> Iterator[tuple[int, Span]]:
    """Numbers of the pieces of floor and walls, and where along the corridor they are."""
    starts = np.arange(-HALF_LENGTH_M, HALF_LENGTH_M, PIECE_M).tolist()
    yield from ((number, (start, start + PIECE_M)) for number, start in enumerate(starts))


def _floor(furniture: Furniture, half_width: float, rng: Generator, *, plain: bool) -> None:
    kind = rng.choice(PLAIN_FLOORS if plain else FLOORS)
    for number, along in _pieces():
        spans = (-half_width, half_width), (0.0, 0.004), along
        furniture.box(Place(0.0, 0.0), *spans, Material(f"{kind}#{number}"), shadow=False)


def _plastered(furniture: Furniture, foot: Place, height: float, side: int) -> None:
    for number, along in _pieces():
        paper = Material(f"plaster#{side}{number}")
        furniture.box(foot, along, (0.0, height), (0.0, 0.01), paper, shadow=False)
    skirting = Material("oak", 0.9)
    span = (-HALF_LENGTH_M, HALF_LENGTH_M)
    furniture.box(foot, span, (0.0, 0.08), (0.01, 0.02), skirting, shadow=False)


def _door(
    furniture: Furniture, foot: Place, x: float, door: str, frame: str, rng: Generator
) -> None:
    """A closed door with its frame, handle and number, and perhaps a picture."""
    left, right = x - DOOR_WIDTH_M / 2, x + DOOR_WIDTH_M / 2
    leaf = {FRONT: Material(door)}
    spans = (left, right), (0.0, DOOR_HEIGHT_M), (0.0, 0.03)
    furniture.box(foot, *spans, Material("white"), faces=leaf, shadow=False)
    wood = Material(frame, 0.9)
    for low in (left - 0.08, right):
        furniture.box(foot, (low, low + 0.08), (0.0, DOOR_HEIGHT_M), (0.0, 0.05), wood)
    lintel = (DOOR_HEIGHT_M, DOOR_HEIGHT_M + 0.08)
    furniture.box(foot, (left - 0.08, right + 0.08), lintel, (0.0, 0.05), wood)
    handle = (left + 0.05, left + 0.17), (1.0, 1.05), (0.03, 0.08)
    furniture.box(foot, *handle, Material("brass", 0.5), shadow=False)
    number = Material(f"blocks#{rng.integers(1000)}")
    plate = (right + 0.15, right + 0.33), (1.5, 1.64), (0.01, 0.02)
    furniture.box(foot, *plate, number, shadow=False)
    if rng.random() < PICTURE_SHARE:
        size = tuple(rng.uniform((0.4, 0.5), (0.8, 0.9)).tolist())
        art = f"{rng.choice(ART)}#{rng.integers(1000)}"
        picture(furniture, foot, x + rng.uniform(1.2, 1.6), 1.5, size, art)


def _ends(furniture: Furniture, half_width: float, rng: Generator) -> None:
    """A window at one end and a double door at the other."""
    walls: tuple[Wall, ...] = ("north", "south")
    for wall, texture in zip(walls, rng.permutation(["window", "front"]), strict=True):
        foot = wall_place(wall, half_width, HALF_LENGTH_M)
        spans = (-0.7, 0.7), (0.2 * (texture == "window"), 2.1), (0.0, 0.03)
        glow = 1.2 if texture == "window" else 0.0
        furniture.box(foot, *spans, Material(texture, glow=glow), shadow=False)
        if texture == "window":
            normal = np.subtract(foot.to_world((0.0, 0.0, 1.0)), (foot.x, 0.0, foot.z)).tolist()
            light = Light(foot.to_world((0.0, -1.4, 0.2)), tuple(normal), (2.1, 2.2, 2.3))
            furniture.lights.append(light)
