# SPDX-License-Identifier: BSD-3-Clause
"""Textured, furnished room rendered for any central camera, with exact depth and pose."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.poses import Pose
from epi360.synthetic.landmarks import rotation_from_euler
from epi360.synthetic.living_room import furnish_living_room
from epi360.synthetic.raycast import Solids, nearest_hits
from epi360.synthetic.surfaces import Hits, Surfaces, build_surfaces
from epi360.synthetic.textures import GAMMA, build_atlas

Floats = NDArray[np.float32]

# Rays are cast in tiles: large enough to amortise NumPy's calls, small enough that a tile's cone
# of rays misses most of the furniture. At 1024x512 128 is 10 % faster than 64.
TILE_PX = 128
# By eye: white walls stay just below white, lamps and sky saturate.
EXPOSURE = 1.25


@dataclass(frozen=True)
class Rendering:
    """One picture of a room.

    Attributes
    ----------
    image : ndarray, shape (H, W, 3), uint8
        RGB; black where the camera has no ray.
    depth : ndarray, shape (H, W), float32
        Distance along the ray of the pixel's centre in metres; 0 where the camera has no ray.
    """

    image: NDArray[np.uint8]
    depth: Floats


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
class Room:
    """A furnished room to take pictures in; `furnished_room` makes one.

    The world has x to the east, y down, z to the north, its origin in the middle of the floor;
    lengths are metres.

    Attributes
    ----------
    solids : Solids
        The geometry.
    surfaces : Surfaces
        Textures and light of every face.
    """

    solids: Solids
    surfaces: Surfaces

    def render(
        self,
        camera: Camera,
        world_from_cam: Pose,
        *,
        supersample: int = 2,
        num_threads: int | None = None,
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

        Returns
        -------
        rendering : Rendering

        Raises
        ------
        ValueError
            If the camera stands in a wall or a piece of furniture, or an option is below 1.
        """
        if supersample < 1:
            raise ValueError(f"supersample must be 1 or more, got {supersample}")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads must be 1 or more, got {num_threads}")
        position = world_from_cam.translation
        if not self.solids.distances(position[None])[0] > 0.0:
            raise ValueError(
                f"world_from_cam puts the camera at {np.round(position, 2).tolist()}, inside a "
                "solid or outside the room; take a pose from sample_pose"
            )
        frame = _Frame(self, camera, world_from_cam)
        with ThreadPoolExecutor(num_threads or os.cpu_count()) as pool:
            tiles = _tiles(camera.width, camera.height)
            list(pool.map(frame.fill, tiles))
            if supersample > 1:
                edges = frame.edge_mask()
                list(pool.map(lambda tile: frame.smooth(tile, edges, supersample), tiles))
        return Rendering(frame.image(), frame.depth)

    def sample_pose(
        self,
        rng: np.random.Generator,
        *,
        clearance_m: float = 0.5,
        max_tilt_deg: float = 5.0,
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
                return Pose(_heading_then_tilt(angles), positions[free[0]])
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
    furniture = furnish_living_room(np.random.Generator(np.random.PCG64(seed)))
    centers, halves, yaws = zip(*furniture.boxes, strict=True)
    ellipsoid_centers, radii = zip(*furniture.ellipsoids, strict=True)
    solids = Solids(
        np.array(centers),
        np.array(halves),
        np.array(yaws),
        np.array(furniture.box_shadows),
        np.array(ellipsoid_centers),
        np.array(radii),
    )
    return Room(solids, build_surfaces(solids, furniture, build_atlas(seed)))


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
    world_from_cam1, world_from_cam2 = _demo_poses(room, seed)
    view1 = room.render(camera, world_from_cam1)
    view2 = room.render(camera, world_from_cam2)
    cam2_from_cam1 = world_from_cam2.inverse() @ world_from_cam1
    return RenderedPair(view1.image, view2.image, view1.depth, view2.depth, cam2_from_cam1, camera)


def _demo_poses(room: Room, seed: int) -> tuple[Pose, Pose]:
    """Camera 1 near the middle of the room, camera 2 to be reached with a step and a turn."""
    rng = np.random.Generator(np.random.PCG64([seed, 1]))
    while True:
        angles = rng.uniform((-0.06, -0.4, -0.06), (0.06, 0.4, 0.06))
        step = rng.uniform((-0.7, -0.1, -0.7), (0.7, 0.1, 0.7))
        turn = angles + rng.uniform((-0.06, 0.5, -0.06), (0.06, 0.9, 0.06))
        position = np.array((0.1, -1.5, -0.35)) + rng.uniform(-0.25, 0.25, 3) * (1, 0.3, 1)
        clear = room.solids.distances(np.stack([position, position + step])) > 0.45
        if clear.all() and 0.6 < np.linalg.norm(step) < 0.9:
            first = Pose(_heading_then_tilt(angles), position)
            return first, Pose(_heading_then_tilt(turn), position + step)


def _heading_then_tilt(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """World-from-camera rotation: pitch (x) and roll (z) of the camera, then its heading (y)."""
    pitch, heading, roll = angles_rad
    tilt = rotation_from_euler(np.array([pitch, 0.0, roll]))
    rotation: NDArray[np.float64] = rotation_from_euler(np.array([0.0, heading, 0.0])) @ tilt
    return rotation


def _tiles(width: int, height: int) -> list[tuple[slice, slice]]:
    return [
        (slice(top, min(top + TILE_PX, height)), slice(left, min(left + TILE_PX, width)))
        for top in range(0, height, TILE_PX)
        for left in range(0, width, TILE_PX)
    ]


class _Frame:
    """The buffers of one picture; tiles are disjoint, so threads may fill them in any order."""

    def __init__(self, room: Room, camera: Camera, world_from_cam: Pose) -> None:
        shape = (camera.height, camera.width)
        self.room, self.camera, self.world_from_cam = room, camera, world_from_cam
        self.depth = np.zeros(shape, np.float32)
        self.color = np.zeros((*shape, 3), np.float32)
        self.surface = np.full(shape, -1, np.int32)

    def fill(self, tile: tuple[slice, slice]) -> None:
        """One ray through the centre of each pixel."""
        rows, columns = tile
        v, u = np.mgrid[rows, columns] + 0.5
        pixels = np.stack([u.ravel(), v.ravel()], axis=1)
        color, depth, surface = self._trace(pixels, 1.0)
        self.color[tile] = color.reshape(*u.shape, 3)
        self.depth[tile] = depth.reshape(u.shape)
        self.surface[tile] = surface.reshape(u.shape)

    def edge_mask(self) -> NDArray[np.bool_]:
        """Pixels whose neighbour to any side shows another surface."""
        edges = np.zeros(self.surface.shape, np.bool_)
        down = self.surface[1:] != self.surface[:-1]
        right = self.surface[:, 1:] != self.surface[:, :-1]
        edges[1:] |= down
        edges[:-1] |= down
        edges[:, 1:] |= right
        edges[:, :-1] |= right
        return edges

    def smooth(self, tile: tuple[slice, slice], edges: NDArray[np.bool_], supersample: int) -> None:
        """Replace the colour of edge pixels by the mean over a grid of rays."""
        v, u = np.nonzero(edges[tile])
        if not len(v):
            return
        v, u = v + tile[0].start, u + tile[1].start
        ticks = (np.arange(supersample) + 0.5) / supersample
        offsets = np.stack(np.meshgrid(ticks, ticks), axis=2).reshape(-1, 1, 2)
        pixels = (np.stack([u, v], axis=1) + offsets).reshape(-1, 2)
        color = self._trace(pixels, 1.0 / supersample)[0]
        self.color[v, u] = color.reshape(supersample**2, -1, 3).mean(axis=0)

    def _trace(
        self, pixels: NDArray[np.float64], pixel_size: float
    ) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Cast rays through pixels: displayed colour, range and surface of each."""
        bearings = self.camera.bearings_from_pixels(pixels)
        seen = np.isfinite(bearings).all(axis=1)
        color = np.zeros((len(pixels), 3), np.float32)
        ranges = np.zeros(len(pixels), np.float32)
        surface = np.full(len(pixels), -1, np.intp)
        if seen.any():
            directions = bearings[seen] @ self.world_from_cam.rotation.T
            origin = self.world_from_cam.translation
            near, solid = nearest_hits(self.room.solids, origin, directions)
            points = (origin + near[:, None] * directions).astype(np.float32)
            widths = near * self._spread(pixels[seen]) * np.float32(pixel_size)
            hits = Hits(solid, points, directions.astype(np.float32), widths)
            light, surface[seen] = self.room.surfaces.shade(self.room.solids, hits)
            color[seen], ranges[seen] = _developed(light), near
        return color, ranges, surface

    def _spread(self, pixels: NDArray[np.float64]) -> Floats:
        """Angle that a pixel covers in its wider direction."""
        jacobians = self.camera.bearing_jacobians(pixels)
        widest: Floats = np.sqrt(np.sum(jacobians**2, axis=1).max(axis=1)).astype(np.float32)
        return widest

    def image(self) -> NDArray[np.uint8]:
        return np.round(255.0 * self.color).astype(np.uint8)


def _developed(light: Floats) -> Floats:
    """Display values in [0, 1] of linear light: a soft shoulder, then gamma."""
    shoulder = np.float32(1) - np.exp(-np.float32(EXPOSURE) * light)
    display: Floats = shoulder ** np.float32(1 / GAMMA)
    return display
