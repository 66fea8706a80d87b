# SPDX-License-Identifier: BSD-3-Clause
"""Exact ray casting against a room of boxes (turned about the vertical) and ellipsoids."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

# Added to direction components, for which 0 would make the slab test's 0 / 0; float32 components
# above 1e-5 do not change at all.
OFF_PLANE = np.float32(1e-13)


@dataclass(frozen=True)
class Solids:
    """Geometry of a scene; solid 0 is the room itself, a box seen from inside.

    Attributes
    ----------
    box_centers, box_halves : ndarray, shape (B, 3)
        Centres and half extents in metres.
    box_yaws : ndarray, shape (B,)
        Turn of each box about the vertical (y) axis in radians.
    box_shadows : ndarray, shape (B,), bool
        Which boxes shade others when the light is computed.
    ellipsoid_centers, ellipsoid_radii : ndarray, shape (K, 3)
        Axis-aligned ellipsoids; they are solids B, B + 1, ...
    """

    box_centers: NDArray[np.float64]
    box_halves: NDArray[np.float64]
    box_yaws: NDArray[np.float64]
    box_shadows: NDArray[np.bool_]
    ellipsoid_centers: NDArray[np.float64]
    ellipsoid_radii: NDArray[np.float64]

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from each point to the nearest surface, for points inside the room.

        Parameters
        ----------
        points : ndarray, shape (N, 3)

        Returns
        -------
        distances : ndarray, shape (N,)
            Metres; negative inside a solid or outside the room. Lower bounds for ellipsoids.
        """
        nearest = np.min(self.box_halves[0] - np.abs(points - self.box_centers[0]), axis=1)
        for center, half, yaw in zip(
            self.box_centers[1:], self.box_halves[1:], self.box_yaws[1:], strict=True
        ):
            excess = np.abs(_turned(points - center, yaw)) - half
            outside = np.linalg.norm(np.maximum(excess, 0.0), axis=1)
            nearest = np.minimum(nearest, outside + np.minimum(0.0, excess.max(axis=1)))
        for center, radii in zip(self.ellipsoid_centers, self.ellipsoid_radii, strict=True):
            nearest = np.minimum(nearest, np.linalg.norm(points - center, axis=1) - radii.max())
        distances: NDArray[np.float64] = nearest
        return distances

    def in_cone(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Boxes and ellipsoids that rays of one bundle may meet, by bounding spheres.

        Parameters
        ----------
        origin : ndarray, shape (3,)
        directions : ndarray, shape (N, 3)
            Unit directions of the bundle.

        Returns
        -------
        boxes, ellipsoids : ndarray of int
            Indices into the boxes (0, the room, left out) and into the ellipsoids.
        """
        axis = directions.mean(axis=0)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
        half_angle = np.arccos(np.clip((directions @ axis).min(), -1.0, 1.0)) + 1e-3

        def touched(centers: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.intp]:
            offsets = centers - origin
            distances = np.maximum(np.linalg.norm(offsets, axis=1), 1e-9)
            between = np.arccos(np.clip(offsets @ axis / distances, -1.0, 1.0))
            spread = np.where(
                distances > radii, np.arcsin(np.minimum(1.0, radii / distances)), np.pi
            )
            return np.flatnonzero(between <= half_angle + spread)

        box_radii = np.linalg.norm(self.box_halves[1:], axis=1)
        boxes = touched(self.box_centers[1:], box_radii) + 1
        return boxes, touched(self.ellipsoid_centers, self.ellipsoid_radii.max(axis=1))


def _turned(vectors: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
    """Coordinates of world vectors (N, 3) in the frame of a box with a yaw."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = vectors.T
    return np.stack([c * x - s * z, y, s * x + c * z], axis=1)


def box_ranges(
    solids: Solids, boxes: NDArray[np.intp], origins: Floats, directions: Floats
) -> tuple[Floats, Floats]:
    """Ranges at which rays enter and leave boxes (slab test).

    Parameters
    ----------
    solids : Solids
    boxes : ndarray of int, shape (B,)
    origins : ndarray, shape (3, N) or (3, 1)
        Coordinate rows, so that every operation runs over contiguous memory.
    directions : ndarray, shape (3, N)

    Returns
    -------
    entries, exits : ndarray, shape (B, N)
        The ray meets the box where entry <= exit and exit > 0.
    """
    cos = np.cos(solids.box_yaws[boxes]).astype(np.float32)[:, None]
    sin = np.sin(solids.box_yaws[boxes]).astype(np.float32)[:, None]
    center = solids.box_centers[boxes].astype(np.float32)
    half = solids.box_halves[boxes].astype(np.float32)
    ox, oy, oz = (origins[axis] - center[:, axis, None] for axis in range(3))
    dx, dy, dz = directions[:, None]
    entries = exits = np.empty(0, np.float32)
    local_rays = (
        (cos * ox - sin * oz, cos * dx - sin * dz),
        (oy, dy),
        (sin * ox + cos * oz, sin * dx + cos * dz),
    )
    for axis, (start, slope) in enumerate(local_rays):
        inverse = np.float32(1) / (slope + OFF_PLANE)
        middle = start * inverse
        reach = half[:, axis, None] * np.abs(inverse)
        if axis == 0:
            entries, exits = -middle - reach, reach - middle
        else:
            entries = np.maximum(entries, -middle - reach)
            exits = np.minimum(exits, reach - middle)
    return entries, exits


def ellipsoid_ranges(
    centers: NDArray[np.float64],
    radii: NDArray[np.float64],
    origin: NDArray[np.float64],
    directions: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Range at which rays from one point meet each ellipsoid, inf where they miss.

    Parameters
    ----------
    centers, radii : ndarray, shape (K, 3)
    origin : ndarray, shape (3,)
    directions : ndarray, shape (3, N)

    Returns
    -------
    ranges : ndarray, shape (K, N)
    """
    start = ((origin - centers) / radii)[:, :, None]
    slope = directions[None] / radii[:, :, None]
    a = np.sum(slope * slope, axis=1)
    b = np.sum(start * slope, axis=1)
    c = np.sum(start * start, axis=1) - 1.0
    discriminant = b * b - a * c
    with np.errstate(invalid="ignore"):
        ranges = (-b - np.sqrt(discriminant)) / a
    return np.where((discriminant > 0.0) & (ranges > 0.0), ranges, np.inf)


def nearest_hits(
    solids: Solids, origin: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[Floats, NDArray[np.intp]]:
    """First surface that rays from one point inside the room meet.

    Parameters
    ----------
    solids : Solids
    origin : ndarray, shape (3,)
    directions : ndarray, shape (N, 3)
        Unit directions of neighbouring rays (the narrower the bundle, the fewer solids to test).

    Returns
    -------
    ranges : ndarray, shape (N,)
        Distance along the ray in metres.
    solid : ndarray, shape (N,), int
        Index of the solid: boxes first, then ellipsoids.
    """
    boxes, ellipsoids = solids.in_cone(origin, directions)
    rays = np.ascontiguousarray(directions.T)
    rays32, origin32 = rays.astype(np.float32), origin.astype(np.float32)[:, None]
    ranges = box_ranges(solids, np.zeros(1, np.intp), origin32, rays32)[1][0]
    solid = np.zeros(len(directions), np.intp)
    if len(boxes):
        entries, exits = box_ranges(solids, boxes, origin32, rays32)
        entries[(entries > exits) | (entries <= 0)] = np.inf
        ranges, solid = _nearer(ranges, solid, entries, boxes)
    if len(ellipsoids):
        entries = ellipsoid_ranges(
            solids.ellipsoid_centers[ellipsoids], solids.ellipsoid_radii[ellipsoids], origin, rays
        ).astype(np.float32)
        ranges, solid = _nearer(ranges, solid, entries, ellipsoids + len(solids.box_centers))
    return ranges, solid


def _nearer(
    ranges: Floats, solid: NDArray[np.intp], candidates: Floats, names: NDArray[np.intp]
) -> tuple[Floats, NDArray[np.intp]]:
    """Keep the nearer of the hits so far and those of more solids, (B, N) ranges."""
    best = np.argmin(candidates, axis=0)
    best_ranges = candidates[best, np.arange(candidates.shape[1])]
    nearer = best_ranges < ranges
    return np.where(nearer, best_ranges, ranges), np.where(nearer, names[best], solid)


def free_ranges(
    solids: Solids,
    boxes: NDArray[np.intp],
    origins: Floats,
    directions: Floats,
    *,
    inside_stops: bool,
) -> Floats:
    """How far rays get before one of the boxes stops them.

    Parameters
    ----------
    solids : Solids
    boxes : ndarray of int, shape (B,)
        The boxes that may stop a ray.
    origins, directions : ndarray, shape (3, N)
    inside_stops : bool
        Whether a box that holds the origin stops the ray at once; otherwise it is transparent.

    Returns
    -------
    ranges : ndarray, shape (N,)
        Metres; inf for a free ray.
    """
    free = np.full(directions.shape[1], np.inf, np.float32)
    if len(boxes):
        entries, exits = box_ranges(solids, boxes, origins, directions)
        last = exits if inside_stops else entries
        entries[(entries > exits) | (last <= 0)] = np.inf
        free = np.maximum(entries, 0).min(axis=0)
    return free
