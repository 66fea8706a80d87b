# SPDX-License-Identifier: BSD-3-Clause
"""A home with twin rooms: the same doors, floors, windows and furniture in several of them."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360_scenes.furniture import Furniture, Material, Place
from epi360_scenes.home_painting import home_atlas
from epi360_scenes.home_pieces import CEILING_M
from epi360_scenes.home_plan import PlannedRoom, plan_home
from epi360_scenes.home_rooms import RoomJob, furnish_room
from epi360_scenes.raycast import Solids, nearest_hits
from epi360_scenes.rendering import RayCaster, Rays
from epi360_scenes.room import _developed
from epi360_scenes.surfaces import Hits, Surfaces, build_surfaces, solids_of
from epi360_scenes.textures import TextureAtlas

Floats = NDArray[np.float32]

# What is taller is a wall or as good as one: it is never left out.
TALL_M = 1.8
# Rays that look which rooms a camera can see into, and how far apart along them rooms are noted.
NUM_SCOUTS, SCOUT_STEP_M = 6000, 0.2
# Lamps of all rooms reach ellipsoids through the walls: this is about their own room's share.
LAMP_SHARE = 0.3


@dataclass(frozen=True)
class Home:
    """Rooms that rays can be cast at; `twin_home` makes one.

    The world has x to the east, y down, z to the north, its origin in the middle of the
    corridor's floor; lengths are metres.

    Attributes
    ----------
    rooms : tuple of PlannedRoom
    solids : Solids
    surfaces : Surfaces
    owners : ndarray of int
        Room of each box and then of each ellipsoid; -1 for the shell around all.
    """

    rooms: tuple[PlannedRoom, ...]
    solids: Solids
    surfaces: Surfaces
    owners: NDArray[np.intp]

    def room_at(self, position: NDArray[np.float64]) -> PlannedRoom:
        """Room that a point inside the home lies in."""
        x, _, z = position[:, None]
        return next(room for room in self.rooms if room.holds(x, z)[0])

    def solids_of(self, room: PlannedRoom) -> Solids:
        """What stands in a room, its walls too."""
        return _some(self.solids, np.isin(self.owners, [-1, self.rooms.index(room)]))

    def seen_from(self, position: NDArray[np.float64]) -> "HomeView":
        """What rays from one point can meet: rooms that it does not see into are left out.

        Parameters
        ----------
        position : ndarray, shape (3,)

        Returns
        -------
        view : HomeView
        """
        directions = sphere_directions(NUM_SCOUTS)
        azimuth = np.arctan2(directions[:, 0], directions[:, 2])
        sectors = np.floor(4 * azimuth / np.pi) + 8 * np.floor(4 * directions[:, 1])
        ranges = np.empty(NUM_SCOUTS)
        for sector in np.unique(sectors):
            rows = np.flatnonzero(sectors == sector)
            ranges[rows] = nearest_hits(self.solids, position, directions[rows])[0]
        steps = np.arange(0.0, float(ranges.max()), SCOUT_STEP_M)
        reached = np.minimum(steps[:, None], ranges)
        x, z = (position[axis] + reached * directions[:, axis] for axis in (0, 2))
        visible = [number for number, room in enumerate(self.rooms) if room.holds(x, z).any()]
        kept = np.isin(self.owners, [-1, *visible])
        num_boxes = len(self.solids.box_centers)
        kept[:num_boxes] |= self.solids.box_halves[:, 1] * 2 > TALL_M
        return HomeView(self, _some(self.solids, kept), np.flatnonzero(kept))


@dataclass(frozen=True)
class HomeView(RayCaster):
    """A home as it is seen from one place.

    Attributes
    ----------
    home : Home
    solids : Solids
        Those that can be seen from there.
    names : ndarray of int
        Number of each of them among the solids of the home.
    """

    home: Home
    solids: Solids
    names: NDArray[np.intp]

    def cast(self, rays: Rays) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Colours, ranges and faces that rays meet, see `RayCaster`."""
        ranges, solid = self.ranges(rays.origin, rays.directions, rays.bundles)
        points = (rays.origin + ranges[:, None] * rays.directions).astype(np.float32)
        hits = Hits(solid, points, rays.directions.astype(np.float32), ranges * rays.widths)
        light, surface = self.home.surfaces.shade(self.home.solids, hits)
        return _developed(light), ranges, surface

    def ranges(
        self,
        origin: NDArray[np.float64],
        directions: NDArray[np.float64],
        bundles: Sequence[NDArray[np.intp]],
    ) -> tuple[Floats, NDArray[np.intp]]:
        """Distance along rays and the home's number of the solid that each meets.

        Parameters
        ----------
        origin : ndarray, shape (3,)
        directions : ndarray, shape (N, 3)
        bundles : sequence of ndarray of int
            Rays of about the same direction, as in `Rays`.

        Returns
        -------
        ranges : ndarray, shape (N,)
        solid : ndarray, shape (N,), int
        """
        ranges = np.empty(len(directions), np.float32)
        solid = np.empty(len(directions), np.intp)
        for rows in bundles:
            ranges[rows], solid[rows] = nearest_hits(self.solids, origin, directions[rows])
        return ranges, self.names[solid]


def sphere_directions(num: int) -> NDArray[np.float64]:
    """Unit directions (num, 3) spread evenly over the sphere, on a spiral."""
    y = 1.0 - (np.arange(num) + 0.5) * 2.0 / num
    azimuth = np.arange(num) * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - y * y)
    return np.stack([radius * np.cos(azimuth), y, radius * np.sin(azimuth)], axis=1)


@lru_cache(maxsize=1)
def twin_home(seed: int) -> Home:
    """Home of eight furnished rooms along a corridor, with two kinds of twin rooms.

    Parameters
    ----------
    seed : int
        Decides plan, textures and furniture.

    Returns
    -------
    home : Home

    Notes
    -----
    Two bedrooms are twins (equal but for pictures, bedspread and what lies about), a third has the
    same pieces with left and right exchanged, and two studies are twins. Doors, windows with
    their blinds and most floors are the same everywhere. It takes some six seconds, and the last
    home is kept: do not change it.
    """
    plan = plan_home(np.random.Generator(np.random.PCG64([seed, 0])))
    parts = [_shell(plan), *(_furnished(room, number, seed) for number, room in enumerate(plan))]
    atlas = home_atlas(seed, sorted({name for part in parts for name in part.textures()}))
    places = [Place(0.0, 0.0), *(room.place for room in plan)]
    return _assembled(plan, parts, places, atlas)


def _shell(plan: list[PlannedRoom]) -> Furniture:
    """Box around the whole home, which nobody sees."""
    around = Furniture()
    width = max(abs(room.place.x) + room.shape.half_width_m for room in plan) + 0.5
    depth = max(abs(room.place.z) + room.shape.half_depth_m for room in plan) + 0.5
    spans = (-width, width), (-0.3, CEILING_M + 0.3), (-depth, depth)
    around.box(Place(0.0, 0.0), *spans, Material("white", 1.0), shadow=False)
    return around


def _furnished(planned: PlannedRoom, number: int, seed: int) -> Furniture:
    """One room in its own frame; its first solid is the space it encloses."""
    room = Furniture()
    kind = zlib.crc32(repr(planned.relation_key).encode())
    shared = np.random.Generator(np.random.PCG64([seed, 1, kind]))
    own = np.random.Generator(np.random.PCG64([seed, 2, number]))
    furnish_room(planned.kind, RoomJob(room, planned.shape, planned.side, shared, own, number))
    return room


def _assembled(
    plan: list[PlannedRoom], parts: list[Furniture], places: list[Place], atlas: TextureAtlas
) -> Home:
    """Rooms side by side, each lit by itself: light does not pass doors, twins have the same."""
    local = [solids_of(part) for part in parts]
    looks = [build_surfaces(*both, atlas) for both in zip(local, parts, strict=True)]
    num_boxes = [len(solids.box_centers) for solids in local]
    # The space that a room encloses is of no use among the others; that of the home comes first.
    first = [0] + [1] * len(plan)
    solids = Solids(
        np.concatenate(
            [_moved(s.box_centers[k:], p) for s, k, p in zip(local, first, places, strict=True)]
        ),
        np.concatenate([s.box_halves[k:] for s, k in zip(local, first, strict=True)]),
        np.concatenate(
            [s.box_yaws[k:] + p.yaw for s, k, p in zip(local, first, places, strict=True)]
        ),
        np.concatenate([s.box_shadows[k:] for s, k in zip(local, first, strict=True)]),
        np.concatenate(
            [_moved(s.ellipsoid_centers, p) for s, p in zip(local, places, strict=True)]
        ),
        np.concatenate([s.ellipsoid_radii for s in local]),
    )
    owners = [np.full(n - k, i - 1) for i, (n, k) in enumerate(zip(num_boxes, first, strict=True))]
    owners += [np.full(len(s.ellipsoid_radii), i - 1) for i, s in enumerate(local)]
    surfaces = _joined(looks, num_boxes, first, parts, places, atlas)
    return Home(tuple(plan), solids, surfaces, np.concatenate(owners))


def _joined(
    looks: list[Surfaces],
    num_boxes: list[int],
    first: list[int],
    parts: list[Furniture],
    places: list[Place],
    atlas: TextureAtlas,
) -> Surfaces:
    """Looks of all rooms: faces of boxes first, then ellipsoids."""
    boxes = [slice(6 * k, 6 * n) for n, k in zip(num_boxes, first, strict=True)]
    rounds = [slice(6 * n, None) for n in num_boxes]

    def joined(name: str) -> NDArray[Any]:
        rows = [getattr(look, name) for look in looks]
        chosen = [row[part] for row, part in zip([*rows, *rows], [*boxes, *rounds], strict=True)]
        return np.concatenate(chosen)

    starts = np.cumsum([0, *(len(look.light) for look in looks)])
    lights = [
        type(light)(
            place.to_world(light.position),
            tuple(np.subtract(place.to_world(light.normal), (place.x, 0.0, place.z)).tolist()),
            tuple((LAMP_SHARE * np.array(light.rgb)).tolist()),
        )
        for part, place in zip(parts, places, strict=True)
        for light in part.lights
    ]
    return Surfaces(
        atlas,
        joined("textures"),
        joined("uv_from_face"),
        joined("glow"),
        np.concatenate(
            [look.light_starts[b] + s for look, b, s in zip(looks, boxes, starts[:-1], strict=True)]
        ),
        np.concatenate([look.light_shapes[b] for look, b in zip(looks, boxes, strict=True)]),
        np.concatenate([look.light for look in looks]),
        tuple(lights),
    )


def _moved(points: NDArray[np.float64], place: Place) -> NDArray[np.float64]:
    return np.array([place.to_world(tuple(p)) for p in points]).reshape(-1, 3)


def _some(solids: Solids, kept: NDArray[np.bool_]) -> Solids:
    """Chosen solids: a mask over boxes and then ellipsoids."""
    boxes, rounds = kept[: len(solids.box_centers)], kept[len(solids.box_centers) :]
    return Solids(
        solids.box_centers[boxes],
        solids.box_halves[boxes],
        solids.box_yaws[boxes],
        solids.box_shadows[boxes],
        solids.ellipsoid_centers[rounds],
        solids.ellipsoid_radii[rounds],
    )
