# SPDX-License-Identifier: BSD-3-Clause
"""Plan of a home: rooms on both sides of a corridor, some of them twins of each other."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360_scenes.furniture import Place
from epi360_scenes.home_pieces import Shape

NUM_COLUMNS = 4
CORRIDOR_HALF_DEPTH_M = 1.0
# Doors stand this far from the corner that they are next to.
DOOR_TO_SIDE_WALL_M, DOOR_TO_CORRIDOR_M = 0.78, 0.85
# Kind and arrangement; equal ones are twins: what differs is what their owners put there.
DWELLINGS = (
    ("bedroom", 1),
    ("bedroom", 1),
    ("bedroom", -1),
    ("study", 1),
    ("study", 1),
    ("living", 1),
    ("kitchen", 1),
    ("bath", 1),
)


@dataclass(frozen=True)
class PlannedRoom:
    """One room of a plan.

    Attributes
    ----------
    name : str
        Kind and number, as ``bedroom2``.
    kind : str
        Key of `home_rooms.ROOMS`.
    side : int
        Arrangement, see `home_rooms.RoomJob`.
    shape : Shape
    place : Place
        The room's frame in the home; its yaw is 0 or pi.
    """

    name: str
    kind: str
    side: int
    shape: Shape
    place: Place

    @property
    def relation_key(self) -> tuple[str, int]:
        """Rooms of equal keys are twins."""
        return self.kind, self.side

    def holds(self, x: NDArray[np.floating], z: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Which points of the home's floor lie in the room."""
        across = np.abs(x - self.place.x) <= self.shape.half_width_m
        along = np.abs(z - self.place.z) <= self.shape.half_depth_m
        return np.asarray(across & along)


def plan_home(rng: np.random.Generator) -> list[PlannedRoom]:
    """Eight rooms in two rows and the corridor between them, all joined by doors.

    Parameters
    ----------
    rng : numpy.random.Generator
        Decides sizes, who lives where and which neighbours share a door.

    Returns
    -------
    rooms : list of PlannedRoom
        The corridor last; the origin of the home is the middle of its floor.
    """
    half_width, half_depth = rng.uniform(2.05, 2.3), rng.uniform(2.2, 2.4)
    order = rng.permutation(len(DWELLINGS))
    rooms: list[PlannedRoom] = []
    to_south: list[float] = []
    to_north: list[float] = []
    for row, yaw in enumerate((0.0, np.pi)):
        joined = rng.permutation([True, True, False])
        for column in range(NUM_COLUMNS):
            kind, side = DWELLINGS[order[row * NUM_COLUMNS + column]]
            x = (2 * column - NUM_COLUMNS + 1) * half_width * (1 - 2 * row)
            z = (CORRIDOR_HALF_DEPTH_M + half_depth) * (1 - 2 * row)
            door = side * (half_width - DOOR_TO_SIDE_WALL_M)
            openings: dict[str, tuple[float, ...]] = {"south": (door,)}
            beside = half_depth - DOOR_TO_CORRIDOR_M
            if column > 0 and joined[column - 1]:
                openings["west"] = (beside,)
            if column < NUM_COLUMNS - 1 and joined[column]:
                openings["east"] = (-beside,)
            (to_south if row else to_north).append(x - door if row else -(x + door))
            name = f"{kind}{sum(room.kind == kind for room in rooms) + 1}"
            shape = Shape(half_width, half_depth, openings)
            rooms.append(PlannedRoom(name, kind, side, shape, Place(x, z, yaw)))
    openings = {"north": tuple(to_north), "south": tuple(to_south)}
    shape = Shape(NUM_COLUMNS * half_width, CORRIDOR_HALF_DEPTH_M, openings)
    return [*rooms, PlannedRoom("corridor1", "corridor", 1, shape, Place(0.0, 0.0))]
