# SPDX-License-Identifier: BSD-3-Clause
"""Textured, furnished room rendered for any central camera, with exact depth and pose."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.poses import Pose
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes.furniture import Furniture
from epi360_scenes.living_room import furnish_living_room
from epi360_scenes.raycast import Solids, nearest_hits
from epi360_scenes.rendering import RayCaster, Rays, Rendering
from epi360_scenes.studio import furnish_studio
from epi360_scenes.surfaces import Hits, Surfaces, build_surfaces, solids_of
from epi360_scenes.textures import GAMMA, build_atlas

Floats = NDArray[np.float32]

SceneName = Literal["living_room", "studio"]
SCENES: dict[str, Callable[[np.random.Generator], Furniture]] = {
    "living_room": furnish_living_room,
    "studio": furnish_studio,
}
# Chosen by eye: white walls stay just below white, lamps and sky saturate.
EXPOSURE = 1.25


@dataclass(frozen=True)
class RenderedPair:
    """Two pictures of one room and the truth between them.

    Attributes
    ----------
    image1, image2 : ndarray, shape (H, W, 3), uint8
    depth1, depth2 : ndarray, shape (H, W), float32
        Ranges in metres, as in `Rendering`.
    cam2_from_cam1 : Pose
        True pose with its metric translation.
    camera : Camera
        Camera of both pictures.
    """

    image1: NDArray[np.uint8]
    image2: NDArray[np.uint8]
    depth1: Floats
    depth2: Floats
    cam2_from_cam1: Pose
    camera: Camera


@dataclass(frozen=True)
class Room(RayCaster):
    """A furnished room to take pictures in; `furnished_room` makes one.

    The world has x to the east, y down, z to the north, its origin in the middle of the floor;
    lengths are metres.

    Attributes
    ----------
    solids : Solids
        Geometry of the room and its furniture.
    surfaces : Surfaces
        Textures and light of every face.
    """

    solids: Solids
    surfaces: Surfaces

    @property
    def up(self) -> NDArray[np.float64]:
        """Unit vector against gravity, shape (3,)."""
        return np.array([0.0, -1.0, 0.0])

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest coordinates of the room, shape (2, 3)."""
        center, half = self.solids.box_centers[0], self.solids.box_halves[0]
        return np.stack([center - half, center + half])

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from points to the nearest surface, see `Solids.distances`."""
        return self.solids.distances(points)

    def render(
        self,
        camera: Camera,
        world_from_cam: Pose,
        *,
        supersample: int = 2,
        num_threads: int | None = None,
        rows: tuple[int, int] | None = None,
    ) -> Rendering:
        """Picture and depth that a camera sees from a pose.

        Parameters
        ----------
        camera : Camera
            Any central camera.
        world_from_cam : Pose
            Pose of the camera in the room; it must stand in free space.
        supersample : int
            Rays per axis in pixels that hold an edge; textures are filtered in any case.
        num_threads : int, optional
            Threads to use, by default one per core; the result does not depend on it.
        rows : (int, int), optional
            First row and the one after the last, if only these are needed; the others are of no
            use.

        Returns
        -------
        rendering : Rendering

        Raises
        ------
        ValueError
            If the camera stands in a wall or a piece of furniture, or an option is below 1.
        """
        position = world_from_cam.translation
        if not self.solids.distances(position[None])[0] > 0.0:
            raise ValueError(
                f"world_from_cam puts the camera at {np.round(position, 2).tolist()}, inside a "
                "solid or outside the room; take a pose from sample_pose"
            )
        return super().render(
            camera, world_from_cam, supersample=supersample, num_threads=num_threads, rows=rows
        )

    def cast(self, rays: Rays) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Colours, ranges and faces that rays from inside the room meet, see `RayCaster`."""
        ranges = np.empty(len(rays.directions), np.float32)
        solid = np.empty(len(rays.directions), np.intp)
        for rows in rays.bundles:
            ranges[rows], solid[rows] = nearest_hits(
                self.solids, rays.origin, rays.directions[rows]
            )
        points = (rays.origin + ranges[:, None] * rays.directions).astype(np.float32)
        hits = Hits(solid, points, rays.directions.astype(np.float32), ranges * rays.widths)
        light, surface = self.surfaces.shade(self.solids, hits)
        return _developed(light), ranges, surface

    def sample_pose(
        self, rng: np.random.Generator, *, clearance_m: float = 0.5, max_tilt_deg: float = 5.0
    ) -> Pose:
        """Random upright pose in free space, as of a camera held at 1.2 to 1.7 m.

        Parameters
        ----------
        rng : numpy.random.Generator
        clearance_m : float
            Smallest distance to any surface.
        max_tilt_deg : float
            Pitch and roll are uniform in plus or minus this; any heading.

        Returns
        -------
        world_from_cam : Pose

        Raises
        ------
        ValueError
            If the room has no place that free.
        """
        low = self.solids.box_halves[0] * (-1, 0, -1) + (0, -1.7, 0)
        high = self.solids.box_halves[0] * (1, 0, 1) + (0, -1.2, 0)
        tilt = np.radians(max_tilt_deg)
        angles = rng.uniform((-tilt, -np.pi, -tilt), (tilt, np.pi, tilt))
        for _ in range(30):
            positions = rng.uniform(low, high, (32, 3))
            free = np.flatnonzero(self.solids.distances(positions) >= clearance_m)
            if len(free):
                return Pose(rotation_from_heading(angles), positions[free[0]])
        raise ValueError(f"clearance_m is {clearance_m} but the room has no place that free")


def furnished_room(seed: int = 0) -> Room:
    """Living room of 6 x 5 x 2.7 m; another seed paints and arranges it differently.

    Parameters
    ----------
    seed : int

    Returns
    -------
    room : Room
    """
    return scene("living_room", seed)


def scene(name: SceneName, seed: int = 0) -> Room:
    """Built-in room to take pictures in.

    Parameters
    ----------
    name : {"living_room", "studio"}
        "living_room", 6 x 5 x 2.7 m, has texture and things on all sides: rich in key points.
        "studio", 7.6 x 4.8 x 2.9 m, has one busy end; the other walls, floor and ceiling are
        plain, so that key points are few and uneven.
    seed : int
        Another seed paints and arranges a room differently.

    Returns
    -------
    room : Room

    Raises
    ------
    ValueError
        If no scene has this name.

    Notes
    -----
    It takes about a second, and the last rooms are kept: do not change them.
    """
    if name not in SCENES:
        raise ValueError(f"scene must be one of {', '.join(SCENES)}, got {name!r}")
    return _built(name, seed)


@lru_cache(maxsize=4)
def _built(name: SceneName, seed: int) -> Room:
    furniture = SCENES[name](np.random.Generator(np.random.PCG64(seed)))
    solids = solids_of(furniture)
    return Room(solids, build_surfaces(solids, furniture, build_atlas(seed, furniture.textures())))


def demo_pair(width: int = 1024, seed: int = 0) -> RenderedPair:
    """Two panoramas of a furnished room, about 0.8 m and 40 deg apart.

    Parameters
    ----------
    width : int
        Width in pixels, even; the height is half of it.
    seed : int
        Seed of the room and of the poses.

    Returns
    -------
    pair : RenderedPair

    Raises
    ------
    ValueError
        If `width` is not a positive even number.
    """
    if width < 2 or width % 2:
        raise ValueError(f"width must be a positive even number, got {width}")
    room = furnished_room(seed)
    camera = Equirectangular(width=width, height=width // 2)
    world_from_cam1, world_from_cam2 = demo_poses(room, seed)
    view1 = room.render(camera, world_from_cam1)
    view2 = room.render(camera, world_from_cam2)
    cam2_from_cam1 = world_from_cam2.inverse() @ world_from_cam1
    return RenderedPair(view1.image, view2.image, view1.depth, view2.depth, cam2_from_cam1, camera)


def demo_poses(room: Room, seed: int) -> tuple[Pose, Pose]:
    """Pose of camera 1 near the middle of the room, and of camera 2 after a step and a turn."""
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    while True:
        angles = rng.uniform((-0.06, -0.4, -0.06), (0.06, 0.4, 0.06))
        step = rng.uniform((-0.7, -0.1, -0.7), (0.7, 0.1, 0.7))
        turn = angles + rng.uniform((-0.06, 0.5, -0.06), (0.06, 0.9, 0.06))
        position = np.array((0.1, -1.5, -0.35)) + rng.uniform(-0.25, 0.25, 3) * (1, 0.3, 1)
        clear = room.solids.distances(np.stack([position, position + step])) > 0.45
        if clear.all() and 0.6 < np.linalg.norm(step) < 0.9:
            first = Pose(rotation_from_heading(angles), position)
            return first, Pose(rotation_from_heading(turn), position + step)


def _developed(light: Floats) -> Floats:
    """Display values in [0, 1] of linear light: a soft shoulder, then gamma."""
    shoulder = np.float32(1) - np.exp(-np.float32(EXPOSURE) * light)
    display: Floats = shoulder ** np.float32(1 / GAMMA)
    return display
