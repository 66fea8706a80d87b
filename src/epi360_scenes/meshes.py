# SPDX-License-Identifier: BSD-3-Clause
"""Textured meshes as scenes: loaded by trimesh, rays cast by Embree (extra ``render``)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from epi360.extras import extra_library
from epi360_scenes.mesh_looks import MeshLooks, looks_of_parts
from epi360_scenes.rendering import RayCaster, Rays

UpAxis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Floats = NDArray[np.float64]

# Faces that meet at a smaller angle are one surface, whose inner edges are not smoothed.
CREASE_RAD = 0.5
# Number of directions that `distances` looks into, about 15 deg from each other.
NUM_FEELERS = 180
# A place is outside the scene if a smaller share of its rays meets something.
LEAST_ENCLOSED = 0.5
RAYS_AT_A_TIME = 1 << 19


@dataclass(frozen=True)
class MeshScene(RayCaster):
    """A mesh to take pictures in, in metres of its own coordinates; see `load_mesh_scene`."""

    vertices: Floats  # (V, 3)
    faces: NDArray[np.intp]  # (F, 3)
    surfaces: NDArray[np.intp]  # (F,): faces of one number are one smooth surface
    looks: MeshLooks  # colours of the faces
    up: Floats  # (3,): unit vector against gravity

    @property
    def bounds(self) -> Floats:
        """Lowest and highest coordinates, shape (2, 3)."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def cast(self, rays: Rays) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.intp]]:
        """Colours, ranges and surfaces that rays meet, see `RayCaster`."""
        origins = np.broadcast_to(rays.origin, rays.directions.shape)
        face = self._first_faces(origins, rays.directions)
        hit = face >= 0
        ranges, weights = self._meet(face[hit], origins[hit], rays.directions[hit])
        colors = np.zeros((len(face), 3), np.float32)
        colors[hit] = self.looks.colors(face[hit], weights, ranges * rays.widths[hit])
        depth = np.zeros(len(face), np.float32)
        depth[hit] = ranges
        return colors, depth, np.where(hit, self.surfaces[face], -1)

    def distances(self, points: Floats) -> Floats:
        """Distance from points to the nearest surface among rays to all sides; -1 outside."""
        feelers = _feelers()
        step = max(1, RAYS_AT_A_TIME // len(feelers))
        parts = [self._felt(points[i : i + step], feelers) for i in range(0, len(points), step)]
        return np.concatenate([np.empty(0), *parts])

    def _felt(self, points: Floats, feelers: Floats) -> Floats:
        origins = np.repeat(points, len(feelers), axis=0)
        directions = np.tile(feelers, (len(points), 1))
        face = self._first_faces(origins, directions)
        hit = face >= 0
        felt = np.full(len(face), np.inf)
        normals = self._normals[face[hit]]
        heights = np.einsum(
            "ni,ni->n", self.vertices[self.faces[face[hit], 0]] - origins[hit], normals
        )
        felt[hit] = heights / np.einsum("ni,ni->n", directions[hit], normals)
        ranges = felt.reshape(len(points), len(feelers))
        enclosed = np.isfinite(ranges).mean(axis=1) >= LEAST_ENCLOSED
        return np.where(enclosed, ranges.min(axis=1), -1.0)

    @cached_property
    def _normals(self) -> Floats:
        """Normals (F, 3) of the faces, of any length."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def _embree(self) -> Any:
        scene = _library("embreex.rtcore_scene").EmbreeScene(robust=True)
        triangles = self.vertices.astype(np.float32), self.faces.astype(np.int32)
        _library("embreex.mesh_construction").TriangleMesh(scene, *triangles)
        return scene

    def _first_faces(self, origins: Floats, directions: Floats) -> NDArray[np.intp]:
        """Face that each ray meets first, -1 where it meets none."""
        starts = np.ascontiguousarray(origins, np.float32)
        faces = self._embree.run(starts, np.ascontiguousarray(directions, np.float32))
        return np.asarray(faces, np.intp)

    def _meet(
        self, face: NDArray[np.intp], origins: Floats, directions: Floats
    ) -> tuple[Floats, Floats]:
        """Ranges (N,) of rays on their faces and barycentric weights (N, 3)."""
        # Möller and Trumbore 1997; Embree itself computes in single precision.
        a, b, c = (self.vertices[self.faces[face, k]] for k in range(3))
        edge1, edge2, start = b - a, c - a, origins - a
        across, beside = np.cross(directions, edge2), np.cross(start, edge1)
        scale = 1.0 / np.einsum("ni,ni->n", edge1, across)
        u = np.einsum("ni,ni->n", start, across) * scale
        v = np.einsum("ni,ni->n", directions, beside) * scale
        ranges = np.maximum(np.einsum("ni,ni->n", edge2, beside) * scale, 0.0)
        weights = np.clip(np.stack([1.0 - u - v, u, v], axis=1), 0.0, 1.0)
        return ranges, weights / weights.sum(axis=1, keepdims=True)


def load_mesh_scene(path: str | os.PathLike[str], *, up: UpAxis = "+y") -> MeshScene:
    """Scene of a mesh file: OBJ, PLY, GLB and what else trimesh reads."""
    if up not in get_args(UpAxis):
        raise ValueError(f"up must be one of {', '.join(get_args(UpAxis))}, got {up!r}")
    parts = _read_parts(Path(path))
    starts: NDArray[np.intp] = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts]).astype(np.float64)
    faces = np.concatenate(
        [part.faces + start for part, start in zip(parts, starts, strict=False)]
    ).astype(np.intp)
    sign, axis = (1.0 if up[0] == "+" else -1.0), "xyz".index(up[1])
    return MeshScene(
        vertices, faces, _smooth_surfaces(parts), looks_of_parts(parts), sign * np.eye(3)[axis]
    )


def _library(name: str) -> Any:
    return extra_library(name, extra="render", purpose="scenes of meshes")


def _read_parts(path: Path) -> list[Any]:
    """Meshes of a file, each with one material, in world coordinates."""
    if not path.is_file():
        raise FileNotFoundError(f"mesh file {path} does not exist")
    trimesh = _library("trimesh")
    _library("embreex.rtcore_scene")  # before the work of reading
    try:
        loaded = trimesh.load_scene(path).dump(concatenate=False)
    except Exception as error:  # its readers raise what they like
        raise ValueError(f"mesh file {path} cannot be read: {error}") from error
    parts = [part for part in loaded if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    if not parts:
        raise ValueError(f"mesh file {path} holds no faces")
    return parts


def _smooth_surfaces(parts: list[Any]) -> NDArray[np.intp]:
    """Number of the smooth surface that each face belongs to."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    numbers: list[NDArray[np.intp]] = []
    count = 0
    for part in parts:
        pairs = part.face_adjacency[part.face_adjacency_angles < CREASE_RAD]
        links = coo_matrix(
            (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=2 * (len(part.faces),)
        )
        num, labels = connected_components(links, directed=False)
        numbers.append(labels + count)
        count += num
    return np.concatenate(numbers).astype(np.intp)


def _feelers() -> Floats:
    """Directions (NUM_FEELERS, 3) spread evenly over the sphere, and the six along the axes."""
    steps = np.arange(NUM_FEELERS) + 0.5
    z, azimuth = 1.0 - 2.0 * steps / NUM_FEELERS, steps * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    spread = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
    return np.concatenate([spread, np.eye(3), -np.eye(3)])
