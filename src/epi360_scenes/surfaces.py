# SPDX-License-Identifier: BSD-3-Clause
"""Materials and precomputed light of every face in a room, and the colour of ray hits."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360_scenes.furniture import GRAINED, Furniture, Light, Material
from epi360_scenes.raycast import Solids, box_ranges, free_ranges
from epi360_scenes.textures import TextureAtlas

Floats = NDArray[np.float32]

# In-plane axes of the faces across x, y, z; the second one is vertical on walls.
FACE_AXES = ((2, 1), (0, 2), (0, 1))
# Light is stored every 12 cm of a face: that blurs the shadows of the few small lights.
LIGHT_STEP_M = 0.12
# Corners within this reach darken each other (ambient occlusion).
CORNER_REACH_M = 0.8
DARKEST_SKY = 0.15
AMBIENT = np.array((0.50, 0.49, 0.47), np.float32)
NUM_SKY_RAYS = 10
# Light that a wooden floor throws on what faces down.
FLOOR_BOUNCE = np.array((0.30, 0.24, 0.17), np.float32)
# Rays start this far off their face, or the face would shade itself.
LIFT_M = 0.004


@dataclass(frozen=True)
class Hits:
    """Where rays met a scene."""

    solid: NDArray[np.intp]  # (N,): what was hit, as `nearest_hits` counts
    # (N, 3): place of the hit and unit direction of the ray in the world.
    points: Floats
    directions: Floats
    widths: Floats  # (N,): width of the ray's pixel across the ray at the hit, in metres

    def __getitem__(self, mask: NDArray[np.bool_]) -> "Hits":
        """Return some of the hits."""
        return Hits(self.solid[mask], self.points[mask], self.directions[mask], self.widths[mask])


@dataclass(frozen=True)
class Surfaces:
    """Looks of all faces: six for each box (-x, +x, -y, +y, -z, +z), one for each ellipsoid."""

    atlas: TextureAtlas
    textures: NDArray[np.intp]  # (F,): texture of each face
    # (F, 2, 3): texture position in turns = matrix times (first, second in-plane metre, 1).
    uv_from_face: Floats
    glow: Floats  # (F,): light of the face itself, as a multiple of its texture; 0: it is lit
    # (B * 6,) and (B * 6, 2): where the grid of a box face begins in `light`, and its samples
    # along both axes.
    light_starts: NDArray[np.intp]
    light_shapes: NDArray[np.intp]
    light: Floats  # (S, 3): irradiance samples
    lights: tuple[Light, ...]  # for the ellipsoids, which are lit without shadows

    def shade(self, solids: Solids, hits: Hits) -> tuple[Floats, NDArray[np.intp]]:
        """Linear light that comes back from hits."""
        rgb = np.empty((len(hits.solid), 3), np.float32)
        surface = np.empty(len(hits.solid), np.intp)
        on_box = hits.solid < len(solids.box_centers)
        for mask, shade in ((on_box, self._boxes), (~on_box, self._ellipsoids)):
            if mask.any():
                rgb[mask], surface[mask] = shade(solids, hits[mask])
        return rgb, surface

    def _boxes(self, solids: Solids, hits: Hits) -> tuple[Floats, NDArray[np.intp]]:
        solid = hits.solid
        turn = solids.box_yaws[solid]
        cos, sin = np.cos(turn).astype(np.float32), np.sin(turn).astype(np.float32)
        half = solids.box_halves[solid].astype(np.float32)
        offset = hits.points - solids.box_centers[solid].astype(np.float32)
        local = _turned(offset, cos, sin)
        slope = _turned(hits.directions, cos, sin)
        everyone = np.arange(len(solid))
        axis = np.argmax(np.abs(local) / half, axis=1)
        face = 6 * solid + 2 * axis + (local[everyone, axis] > 0)
        planes = np.asarray(FACE_AXES)[axis]
        first, second = (local[everyone, planes[:, k]] for k in range(2))
        footprint = hits.widths / np.sqrt(np.maximum(np.abs(slope[everyone, axis]), 0.02))
        rgb = self._textured(face, first, second, footprint)
        shares = (
            0.5 + 0.5 * first / half[everyone, planes[:, 0]],
            0.5 + 0.5 * second / half[everyone, planes[:, 1]],
        )
        glow = self.glow[face][:, None]
        return rgb * np.where(glow > 0, glow, self._stored_light(face, shares)), face

    def _ellipsoids(self, solids: Solids, hits: Hits) -> tuple[Floats, NDArray[np.intp]]:
        index = hits.solid - len(solids.box_centers)
        radii = solids.ellipsoid_radii[index]
        offset = (hits.points - solids.ellipsoid_centers[index]) / radii
        normals = offset / radii
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        face = 6 * len(solids.box_centers) + index
        across = np.arctan2(offset[:, 0], offset[:, 2]) * radii[:, 0]
        along = np.arctan2(offset[:, 1], np.hypot(offset[:, 0], offset[:, 2])) * radii[:, 1]
        facing = np.abs(np.sum(normals * hits.directions, axis=1))
        footprint = (hits.widths / np.sqrt(np.maximum(facing, 0.05))).astype(np.float32)
        rgb = self._textured(face, across.astype(np.float32), along.astype(np.float32), footprint)
        upward = (0.5 - 0.5 * normals[:, 1:2]).astype(np.float32)
        lit = AMBIENT * (0.5 + 0.5 * upward) + FLOOR_BOUNCE * (1 - upward)
        for light in self.lights:
            lit = lit + _irradiance(hits.points, normals.astype(np.float32), light)
        glow = self.glow[face][:, None]
        return rgb * np.where(glow > 0, glow, lit), face

    def _textured(
        self, face: NDArray[np.intp], first: Floats, second: Floats, footprint: Floats
    ) -> Floats:
        rows = self.uv_from_face[face]
        uv = np.stack(
            [row[:, 0] * first + row[:, 1] * second + row[:, 2] for row in (rows[:, 0], rows[:, 1])]
        )
        # Turns per metre, geometric mean of both directions.
        scale = np.sqrt(np.abs(rows[:, 0, 0] * rows[:, 1, 1] - rows[:, 0, 1] * rows[:, 1, 0]))
        return self.atlas.sample(self.textures[face], uv, footprint * scale)

    def _stored_light(self, face: NDArray[np.intp], shares: tuple[Floats, Floats]) -> Floats:
        """Bilinear look-up in the grids of irradiance, constant beyond the outer samples."""
        shape, start = self.light_shapes[face], self.light_starts[face]
        low, high, weight = [], [], []
        for k in range(2):
            at = np.clip(shares[k] * shape[:, k] - 0.5, 0, shape[:, k] - 1)
            floor = at.astype(np.intp)
            low.append(floor)
            high.append(np.minimum(floor + 1, shape[:, k] - 1))
            weight.append((at - floor).astype(np.float32)[:, None])
        stride = shape[:, 0]
        above0, above1 = (self.light[start + low[1] * stride + x] for x in (low[0], high[0]))
        below0, below1 = (self.light[start + high[1] * stride + x] for x in (low[0], high[0]))
        above = above0 + weight[0] * (above1 - above0)
        below = below0 + weight[0] * (below1 - below0)
        mixed: Floats = above + weight[1] * (below - above)
        return mixed


def solids_of(furniture: Furniture) -> Solids:
    """Geometry of all that was put into a scene."""
    centers, halves, yaws = zip(*furniture.boxes, strict=True)
    round_ones = np.array(furniture.ellipsoids, np.float64).reshape(-1, 2, 3)
    return Solids(
        np.array(centers),
        np.array(halves),
        np.array(yaws),
        np.array(furniture.box_shadows),
        round_ones[:, 0],
        round_ones[:, 1],
    )


def build_surfaces(solids: Solids, furniture: Furniture, atlas: TextureAtlas) -> Surfaces:
    """Materials of all faces and the light on them."""
    materials = [m for faces in furniture.box_materials for m in faces]
    sizes = [
        (2 * half[FACE_AXES[face // 2][0]], 2 * half[FACE_AXES[face // 2][1]])
        for half in solids.box_halves
        for face in range(6)
    ]
    materials += furniture.ellipsoid_materials
    sizes += [(2 * np.pi * a, np.pi * b) for a, b, _ in solids.ellipsoid_radii]
    shapes = np.maximum(np.ceil(np.array(sizes) / LIGHT_STEP_M), 1)
    shapes = shapes[: 6 * len(solids.box_centers)].astype(np.intp)
    counts = shapes.prod(axis=1)
    lights = tuple(furniture.lights)
    return Surfaces(
        atlas,
        np.array([atlas.names.index(m.texture) for m in materials]),
        np.array([uv_from_face(m, *size) for m, size in zip(materials, sizes, strict=True)]),
        np.array([m.glow for m in materials], np.float32),
        np.cumsum(counts) - counts,
        shapes,
        _baked_light(solids, shapes, lights),
        lights,
    )


def uv_from_face(material: Material, width: float, height: float) -> Floats:
    """Rows of `Surfaces.uv_from_face` for one face; its in-plane origin is its centre."""
    if material.width_m is None:
        return np.array([[1 / width, 0, 0.5], [0, 1 / height, 0.5]], np.float32)
    turns = 1 / material.width_m
    # A face shows its own part of a repeating texture, so that twins do not look alike.
    shift = (7.31 * width + 3.77 * height, 5.13 * width + 2.39 * height)
    if material.texture in GRAINED and height > width:
        return np.array([[0, turns, shift[0]], [turns, 0, shift[1]]], np.float32)
    foot = 1.0 if material.texture.startswith("books") else shift[1]
    scale = 1 / height if material.texture.startswith("books") else turns
    return np.array([[turns, 0, shift[0]], [0, scale, foot - 0.5]], np.float32)


def _turned(vectors: Floats, cos: Floats | np.float32, sin: Floats | np.float32) -> Floats:
    """World vectors (N, 3) in the frames of boxes with these yaws."""
    x, y, z = vectors.T
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=1)


def _irradiance(points: Floats, normals: Floats, light: Light) -> Floats:
    """Unshaded light of one source; a source with a zero normal shines to all sides."""
    towards = np.asarray(light.position, np.float32) - points
    squared = np.sum(towards * towards, axis=1)
    towards = towards / np.sqrt(squared)[:, None]
    received = np.maximum(0, np.sum(normals * towards, axis=1))
    source = np.asarray(light.normal, np.float32)
    sent = np.maximum(0, -(towards @ source)) if source.any() else np.float32(1)
    # 0.4 m^2 softens the bright spot right beside a lamp.
    strength = received * sent / (squared + np.float32(0.4))
    irradiance: Floats = strength[:, None] * np.asarray(light.rgb, np.float32)
    return irradiance


def _baked_light(solids: Solids, shapes: NDArray[np.intp], lights: tuple[Light, ...]) -> Floats:
    """Irradiance with shadows and dark corners on the grid of every box face, (S, 3)."""
    # The faces of a piece of furniture share most of their shadows; those of the room do not.
    groups = [[face] for face in range(6)]
    groups += [list(range(6 * box, 6 * box + 6)) for box in range(1, len(solids.box_centers))]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        grids = pool.map(lambda faces: _light_on(solids, faces, shapes, lights), groups)
        return np.concatenate(list(grids))


def _light_on(
    solids: Solids, faces: list[int], shapes: NDArray[np.intp], lights: tuple[Light, ...]
) -> Floats:
    grids = [_face_grid(solids, face, shapes[face]) for face in faces]
    points = np.concatenate([points for points, _ in grids])
    normals = np.concatenate([np.tile(normal, (len(points), 1)) for points, normal in grids])
    # The end of a board may lie inside its neighbour, and darkness from there would spread over
    # the whole board. On walls and floor it makes furniture stand firmly.
    inside_is_dark = faces[0] < 6
    sky = _sky_share(solids, points, normals, inside_is_dark)
    downward = 0.5 + 0.5 * normals[:, 1:2]
    light: Floats = ((AMBIENT + downward * FLOOR_BOUNCE) * sky[:, None]).astype(np.float32)
    for source in lights:
        direct = _irradiance(points, normals, source)
        (lit,) = np.nonzero(direct.any(axis=1))
        if len(lit):
            position = np.asarray(source.position)
            free = _reached(solids, points[lit], position, inside_is_dark)
            light[lit] += direct[lit] * free[:, None]
    return light


def _reached(
    solids: Solids, points: Floats, position: NDArray[np.float64], inside_is_dark: bool
) -> NDArray[np.bool_]:
    """Whether a small light reaches each point."""
    towards = position - points
    reach = np.linalg.norm(towards, axis=1)
    towards /= reach[:, None]
    casters, _ = solids.in_cone(position, -towards)
    casters = casters[solids.box_shadows[casters]]
    rays = np.ascontiguousarray(towards.T, np.float32)
    origins = np.ascontiguousarray(points.T)
    # The shell does not count: lamps hang a little below it.
    stops = free_ranges(solids, casters, origins, rays, inside_stops=inside_is_dark)
    reached: NDArray[np.bool_] = stops >= reach
    return reached


def _face_grid(solids: Solids, face: int, shape: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Sample points just off a face, first in-plane axis fastest, and its lit-side normal."""
    solid, axis, high = face // 6, face % 6 // 2, face % 2
    half, yaw = solids.box_halves[solid], float(solids.box_yaws[solid])
    first, second = FACE_AXES[axis]
    ticks = [(np.arange(n) + 0.5) / n * 2 - 1 for n in shape]
    local = np.zeros((shape[1], shape[0], 3))
    local[..., first] = ticks[0][None, :] * half[first]
    local[..., second] = ticks[1][:, None] * half[second]
    side = 1.0 if high else -1.0
    outward = -side if solid == 0 else side
    local[..., axis] = side * half[axis] + outward * LIFT_M
    normal = np.zeros((1, 3), np.float32)
    normal[0, axis] = outward
    cos, sin = np.float32(np.cos(-yaw)), np.float32(np.sin(-yaw))
    points = _turned(local.reshape(-1, 3).astype(np.float32), cos, sin)
    center = solids.box_centers[solid].astype(np.float32)
    return points + center, _turned(normal, cos, sin)[0]


def _sky_share(solids: Solids, points: Floats, normals: Floats, inside_is_dark: bool) -> Floats:
    """Light from all around that corners leave at points on faces."""
    casters = np.flatnonzero(solids.box_shadows)
    centers = solids.box_centers[casters]
    low, high = points.min(axis=0), points.max(axis=0)
    gap = np.linalg.norm(np.maximum(0, np.maximum(low - centers, centers - high)), axis=1)
    near = casters[gap < np.linalg.norm(solids.box_halves[casters], axis=1) + CORNER_REACH_M]
    # Sunflower points on the disc, lifted to the hemisphere: cosine-distributed.
    steps = np.arange(NUM_SKY_RAYS) + 0.5
    radius, azimuth = np.sqrt(steps / NUM_SKY_RAYS), steps * np.pi * (3 - np.sqrt(5))
    disc = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - radius**2)])
    tangents = np.roll(normals, 1, axis=1)
    tangents = tangents - normals * np.sum(tangents * normals, axis=1, keepdims=True)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    frames = np.stack([tangents, np.cross(normals, tangents), normals])
    rays = np.einsum("kr,knc->cnr", disc, frames).astype(np.float32)
    origins = np.repeat(points.T, NUM_SKY_RAYS, axis=1)
    directions = rays.reshape(3, -1)
    stops = free_ranges(solids, near, origins, directions, inside_stops=inside_is_dark)
    walls = box_ranges(solids, np.zeros(1, np.intp), origins, directions)[1][0]
    free = np.sqrt(np.clip(np.minimum(stops, walls) / CORNER_REACH_M, 0, 1))
    share: Floats = free.reshape(len(points), NUM_SKY_RAYS).mean(axis=1)
    return np.float32(DARKEST_SKY) + np.float32(1 - DARKEST_SKY) * share
