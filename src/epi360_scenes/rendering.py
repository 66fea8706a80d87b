# SPDX-License-Identifier: BSD-3-Clause
"""Pictures with depth of anything that rays can be cast at, in tiles, smooth at edges."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.poses import Pose

Floats = NDArray[np.float32]

# Tiles are large enough to amortise NumPy's calls. The rays of a block are a cone so narrow that
# it misses most of the furniture. Of panoramas of 512 to 1024 pixels on two threads, blocks of 64
# take 0.5 to 0.7 of the time of 32 (which makes more calls, for which threads wait), or of 128.
TILE_PX = 128
BLOCK_PX = 64


@dataclass(frozen=True)
class Rendering:
    """One picture of a scene.

    Attributes
    ----------
    image : ndarray, shape (H, W, 3), uint8
        RGB; black where the camera has no ray.
    depth : ndarray, shape (H, W), float32
        Distance along the ray of the pixel's centre in metres; 0 where the camera has no ray or
        the ray meets nothing.
    """

    image: NDArray[np.uint8]
    depth: Floats


@dataclass(frozen=True)
class Rays:
    """Rays from one point."""

    origin: NDArray[np.float64]  # (3,)
    directions: NDArray[np.float64]  # (N, 3): unit directions in the world
    widths: Floats  # (N,): angle in radians that the ray's pixel covers
    # Indices of rays that look in about the same direction; every ray is in one bundle.
    bundles: list[NDArray[np.intp]]


class RayCaster(Protocol):
    """A scene of which pictures can be made."""

    def render(
        self,
        camera: Camera,
        world_from_cam: Pose,
        *,
        supersample: int = 2,
        num_threads: int | None = None,
        rows: tuple[int, int] | None = None,
    ) -> Rendering:
        """Picture and depth that a camera sees from a pose; `Room.render` says more."""
        if supersample < 1:
            raise ValueError(f"supersample must be 1 or more, got {supersample}")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads must be 1 or more, got {num_threads}")
        frame = _Frame(self, camera, world_from_cam)
        with ThreadPoolExecutor(num_threads or os.cpu_count()) as pool:
            top, bottom = rows or (0, camera.height)
            # The rows beside them say where their edges are.
            around = max(top - 1, 0), min(bottom + 1, camera.height)
            list(pool.map(frame.fill, _tiles(camera.width, *around)))
            if supersample > 1:
                edges = frame.edge_mask()
                tiles = _tiles(camera.width, top, bottom)
                list(pool.map(lambda tile: frame.smooth(tile, edges, supersample), tiles))
        return Rendering(frame.image(), frame.depth)

    def cast(self, rays: Rays) -> tuple[Floats, Floats, NDArray[np.intp]]:
        """Display colours (N, 3), ranges in metres and surface numbers of what rays meet."""


def _tiles(width: int, first: int, end: int) -> list[tuple[slice, slice]]:
    """Tiles of some rows."""
    return [
        (slice(top, min(top + TILE_PX, end)), slice(left, min(left + TILE_PX, width)))
        for top in range(first, end, TILE_PX)
        for left in range(0, width, TILE_PX)
    ]


class _Frame:
    """The buffers of one picture; tiles are disjoint, so threads may fill them in any order."""

    def __init__(self, scene: RayCaster, camera: Camera, world_from_cam: Pose) -> None:
        shape = (camera.height, camera.width)
        self.scene, self.camera, self.world_from_cam = scene, camera, world_from_cam
        self.depth = np.zeros(shape, np.float32)
        self.color = np.zeros((*shape, 3), np.float32)
        self.surface = np.full(shape, -1, np.int32)

    def fill(self, tile: tuple[slice, slice]) -> None:
        """Cast one ray through the centre of each pixel."""
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
            widths = self._spread(pixels[seen]) * np.float32(pixel_size)
            origin = self.world_from_cam.translation
            rays = Rays(origin, directions, widths, self._bundles(pixels[seen]))
            color[seen], ranges[seen], surface[seen] = self.scene.cast(rays)
        return color, ranges, surface

    def _bundles(self, pixels: NDArray[np.float64]) -> list[NDArray[np.intp]]:
        """Which pixels lie in the same small block of the picture."""
        u, v = (pixels // BLOCK_PX).astype(np.intp).T
        block = v * (self.camera.width // BLOCK_PX + 1) + u
        order = np.argsort(block, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(block[order])) + 1)

    def _spread(self, pixels: NDArray[np.float64]) -> Floats:
        """Angle that a pixel covers in its wider direction."""
        jacobians = self.camera.bearing_jacobians(pixels)
        squared = np.einsum("nij,nij->nj", jacobians, jacobians)
        widest: Floats = np.sqrt(np.maximum(squared[:, 0], squared[:, 1])).astype(np.float32)
        return widest

    def image(self) -> NDArray[np.uint8]:
        return np.round(255.0 * self.color).astype(np.uint8)
