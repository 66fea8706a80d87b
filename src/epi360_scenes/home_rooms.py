# SPDX-License-Identifier: BSD-3-Clause
"""Rooms of a home, each in a frame of its own: the corridor is south, the window north."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from epi360_scenes.furniture import FRONT, TOP, Furniture, Material, Place
from epi360_scenes.home_pieces import (
    BLACK,
    CEILING_M,
    DOOR_WIDTH_M,
    OAK,
    WALL_M,
    WALNUT,
    WHITE,
    Shape,
    bed,
    beside,
    blinds_window,
    door_leaf,
    open_wall,
    rug,
    sofa,
    table,
    wardrobe,
)
from epi360_scenes.pieces import (
    WALLS,
    bookshelf,
    ceiling_lamp,
    chair,
    floor_at,
    ornament,
    picture,
    potted_plant,
)

# Patterns of floors and walls do not come again within a room.
PATTERN_M = 4.8
# What hangs in frames: each comes in as many versions as there are rooms.
ART = ("landscape", "abstract", "circles", "blocks", "poster1", "poster2", "map")


@dataclass
class RoomJob:
    """One room while it is furnished.

    Attributes
    ----------
    room : Furniture
        What stands there so far.
    shape : Shape
    side : int
        1, or -1 for the arrangement with left and right exchanged.
    shared : numpy.random.Generator
        Stream that twins have in common: what it decides is the same in all of them.
    own : numpy.random.Generator
        Stream of this room alone: the small differences.
    number : int
        Of the room in its home: the pattern of its walls begins somewhere else.
    """

    room: Furniture
    shape: Shape
    side: int
    shared: np.random.Generator
    own: np.random.Generator
    number: int

    @property
    def left(self) -> str:
        """Wall that the main piece stands at."""
        return "west" if self.side > 0 else "east"

    @property
    def right(self) -> str:
        """Wall across from the main piece."""
        return "east" if self.side > 0 else "west"

    def at(self, wall: str, along: float) -> Place:
        """Place in front of a wall, `along` metres north (east on the walls across) of its middle.

        On walls of the south and north a positive number is to the side of `right`.
        """
        turn = {"west": -1, "east": 1, "north": -self.side, "south": self.side}[wall]
        return beside(self.shape.wall(wall), turn * along, WALL_M)

    def on_floor(self, x: float, z: float, yaw: float = 0.0) -> Place:
        """Place on the floor; x is exchanged with the arrangement."""
        return Place(self.side * x, z, yaw)

    def hang(self, wall: str, along: float, size: tuple[float, float], height: float) -> None:
        """Hang up a picture that no other room has, unless a door is in its way."""
        name = f"{self.own.choice(ART)}#{self.own.integers(1000)}"
        place, foot = self.at(wall, along), self.shape.wall(wall)
        for door in self.shape.openings.get(wall, ()):
            x, z = floor_at(foot, door, WALL_M)
            if np.hypot(place.x - x, place.z - z) < (DOOR_WIDTH_M + size[0]) / 2 + 0.12:
                return
        picture(self.room, place, 0.0, height, size, name)

    def jitter(self, spread: float) -> float:
        """Return how far a thing that people move is from where its twin is."""
        return float(self.own.uniform(-spread, spread))


def furnish_room(kind: str, job: RoomJob) -> None:
    """Put up floor, walls, doors and lamps of a room and furnish it.

    Parameters
    ----------
    kind : str
        Key of `ROOMS`.
    job : RoomJob
        Gets the solids; `job.room` is empty at first.
    """
    floor, paint, furnish = ROOMS[kind]
    shape, room = job.shape, job.room
    width, depth = shape.half_width_m, shape.half_depth_m
    spans = (-width, width), (0.0, CEILING_M), (-depth, depth)
    room.box(Place(0, 0), *spans, Material("ceiling", 2.5), shadow=False)
    # A little under the walls, by another width in each kind of room: that decides which part of
    # the floor's pattern lies where.
    under = 0.007 * list(ROOMS).index(kind)
    floor_spans = (-width - under, width + under), (-depth, depth)
    laid = Material(floor, PATTERN_M)
    room.box(Place(0, 0), floor_spans[0], (0.0, 0.01), floor_spans[1], laid, shadow=False)
    for corner, name in enumerate(WALLS, start=4 * job.number):
        doors, half = shape.openings.get(name, ()), shape.half_length(name)
        open_wall(room, shape.wall(name), half, doors, Material(paint, PATTERN_M), 0.007 * corner)
    for x in np.linspace(-width, width, round(width / 2.1) * 2 + 1)[1::2]:
        ceiling_lamp(room, Place(float(x), 0.0), CEILING_M)
    if kind != "corridor":
        for name in ("south", "west"):
            for x in shape.openings.get(name, ()):
                door_leaf(room, shape.wall(name), x, 1.75 + job.jitter(0.15))
        blinds_window(room, shape.wall("north"), 0.25 * job.side, 1.5)
    furnish(job)


def _bedroom(job: RoomJob) -> None:
    room, own = job.room, job.own
    bed(
        room, job.at(job.left, 0.75), f"bedspread#{own.integers(99)}", f"cushion1#{own.integers(9)}"
    )
    wardrobe(room, job.at(job.right, 0.6))
    rug(room, job.on_floor(0.55, -0.3, job.jitter(0.03)), (0.7, 1.0), "rug#bedroom")
    chair(room, job.on_floor(0.75 + job.jitter(0.04), 1.5, 2.6 + job.jitter(0.1)))
    potted_plant(room, Place(*floor_at(job.at("north", 1.5), 0, 0.45)), 0.0, 0.3, job.shared)
    for along, size in ((0.2, (0.5, 0.65)), (1.2, (0.8, 0.55))):
        job.hang(job.left, along, size, 1.6)
    for along in (-1.4, -0.5):
        job.hang("south", along, (0.6, 0.8), 1.55 + job.jitter(0.03))
    board = job.at("south", -0.95)
    room.box(board, (-0.7, 0.7), (0.0, 0.8), (0.0, 0.38), OAK, faces={FRONT: Material("front")})
    for x in (-0.5, 0.0, 0.45):
        ornament(room, board, x, 0.8, 0.2, own)


def _study(job: RoomJob) -> None:
    room, own = job.room, job.own
    shelf = job.at(job.left, 0.7)
    bookshelf(room, shelf, job.shared)
    sofa(room, job.at(job.right, 0.65), f"cushion2#{own.integers(99)}")
    rug(room, job.on_floor(0.3, 0.1, job.jitter(0.03)), (0.8, 1.1), "rug#study")
    desk = job.on_floor(0.1, 1.35 + job.jitter(0.03), job.jitter(0.03))
    table(room, desk, (0.75, 0.38), 0.74)
    chair(room, beside(desk, 0.1, -0.6 + job.jitter(0.06), job.jitter(0.3)))
    for x in (-0.5, 0.05, 0.5):
        ornament(room, desk, x, 0.74, job.jitter(0.2), own)
    sheet = Material(f"poster2#{own.integers(99)}")
    room.box(desk, (-0.3, -0.05), (0.74, 0.745), (-0.25, 0.1), sheet, shadow=False)
    for along, size in ((0.1, (0.7, 0.5)), (1.0, (0.5, 0.7))):
        job.hang(job.right, along, size, 1.55)
    job.hang("south", -1.3, (0.55, 0.75), 1.5)
    cupboard = job.at("south", -0.5)
    room.box(
        cupboard, (-0.5, 0.5), (0.0, 1.2), (0.0, 0.4), WALNUT, faces={FRONT: Material("front")}
    )
    potted_plant(room, Place(*floor_at(cupboard, 0.2, 0.2)), 1.2, 0.18, job.shared)


def _living(job: RoomJob) -> None:
    room, own = job.room, job.own
    sofa(room, job.at(job.left, 0.6), "cushion1")
    rug(room, job.on_floor(-0.4, 0.6), (0.75, 1.15), "rug#2")
    low = job.on_floor(-0.4, 0.6)
    table(room, low, (0.35, 0.6), 0.42)
    ornament(room, low, 0.0, 0.42, 0.2, own)
    board = job.at(job.right, 0.6)
    room.box(board, (-1.0, 1.0), (0.1, 0.55), (0.0, 0.42), WALNUT, faces={FRONT: Material("front")})
    room.box(board, (-0.6, 0.6), (0.6, 1.3), (0.05, 0.1), BLACK)
    room.box(board, (-0.56, 0.56), (0.64, 1.26), (0.1, 0.105), Material("landscape#tv", glow=0.8))
    for x in (-0.8, 0.8):
        ornament(room, board, x, 0.55, 0.2, own)
    bookshelf(room, job.at("south", -0.75), own)
    for along, size in ((-0.1, (0.6, 0.6)), (0.6, (0.7, 0.9)), (1.4, (0.6, 0.6))):
        job.hang(job.left, along, size, 1.6)
    potted_plant(room, Place(*floor_at(job.at("north", 1.5), 0, 0.4)), 0.0, 0.34, own)


def _kitchen(job: RoomJob) -> None:
    room, own = job.room, job.own
    run = job.at(job.left, 0.75)
    room.box(run, (-1.3, 1.3), (0.0, 0.86), (0.0, 0.58), WHITE)
    room.box(run, (-1.32, 1.32), (0.86, 0.9), (0.0, 0.62), WALNUT)
    room.box(
        run, (-1.3, 1.3), (0.9, 1.5), (0.0, 0.008), Material("walltiles", PATTERN_M), shadow=False
    )
    for slot, x in enumerate((-0.975, -0.325, 0.325, 0.975)):
        front = Material("appliance" if slot == 2 else "front")
        room.box(run, (x - 0.31, x + 0.31), (0.1, 0.84), (0.58, 0.6), front, shadow=False)
        if slot != 2:
            above = {FRONT: Material("front")}
            room.box(run, (x - 0.32, x + 0.32), (1.5, 2.2), (0.0, 0.33), WHITE, faces=above)
    for x in (-1.1, -0.6, 0.1, 1.0):
        ornament(room, run, x, 0.9, 0.25, own)
    fridge = job.at(job.right, 1.5)
    note = {FRONT: Material(f"poster1#{own.integers(99)}")}
    room.box(fridge, (-0.32, 0.32), (0.0, 1.85), (0.0, 0.6), WHITE, faces=note)
    dining = job.on_floor(0.75, 0.35, job.jitter(0.05))
    table(room, dining, (0.45, 0.7), 0.75)
    for x, z, yaw in ((-0.6, 0.3, 1.5), (-0.6, -0.35, 1.7), (0.65, 0.0, -1.6)):
        chair(room, beside(dining, x, z, yaw))
    ornament(room, dining, 0.0, 0.75, 0.2, own)
    job.hang(job.right, 0.3, (0.9, 0.6), 1.6)
    job.hang("south", -0.8, (0.5, 0.7), 1.6)


def _bath(job: RoomJob) -> None:
    room, own = job.room, job.own
    tub = job.at(job.left, 0.9)
    room.box(tub, (-0.9, 0.9), (0.0, 0.58), (0.0, 0.8), Material("walltiles", PATTERN_M))
    room.box(tub, (-0.84, 0.84), (0.58, 0.59), (0.06, 0.74), WHITE, shadow=False)
    basin = job.at(job.right, 0.3)
    room.box(basin, (-0.6, 0.6), (0.45, 0.88), (0.0, 0.48), OAK, faces={FRONT: Material("front")})
    room.box(basin, (-0.4, 0.4), (0.88, 0.98), (0.08, 0.42), WHITE)
    ornament(room, basin, -0.5, 0.88, 0.2, own)
    ornament(room, basin, 0.5, 0.88, 0.2, own)
    machine = job.at(job.right, 1.4)
    room.box(
        machine, (-0.3, 0.3), (0.0, 0.85), (0.0, 0.6), WHITE, faces={FRONT: Material("appliance")}
    )
    rug(room, job.on_floor(0.3, 0.6), (0.35, 0.5), "bedspread#bath")
    towel = job.at("south", -1.0)
    room.box(towel, (-0.35, 0.35), (0.9, 1.6), (0.02, 0.05), Material("cushion2#towel"))
    job.hang(job.right, 0.3, (0.7, 0.7), 1.5)


def _corridor(job: RoomJob) -> None:
    room, own = job.room, job.own
    width = job.shape.half_width_m
    for x in np.linspace(-width, width, 9)[1::2]:
        rug(room, Place(float(x), 0.0), (1.1, 0.42), f"rug#{x:.0f}")
    for wall in ("north", "south"):
        for along in np.arange(-width + 0.5, width, 1.25):
            job.hang(wall, float(along), (0.5, 0.7), 1.6)
    for along in (-width / 2 - 0.6, width / 2 - 0.6):
        board = job.at("north", along)
        room.box(
            board, (-0.4, 0.4), (0.0, 0.8), (0.0, 0.28), OAK, faces={TOP: Material("walnut", 0.7)}
        )
        ornament(room, board, 0.0, 0.8, 0.14, own)
    job.hang("west", 0.0, (0.8, 0.8), 1.6)
    job.hang("east", 0.0, (0.6, 0.9), 1.6)


# Floor, paint and furniture of each kind of room.
ROOMS: dict[str, tuple[str, str, Callable[[RoomJob], None]]] = {
    "bedroom": ("carpet", "wallpaper", _bedroom),
    "study": ("laminate", "wall", _study),
    "living": ("laminate", "wall#2", _living),
    "kitchen": ("tiles", "wall", _kitchen),
    "bath": ("tiles", "walltiles", _bath),
    "corridor": ("laminate", "wall", _corridor),
}
