# SPDX-License-Identifier: BSD-3-Clause
"""Exact ray casting against a room of boxes (turned about the vertical) and ellipsoids."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

# Added to direction components, because a zero would give 0 / 0 in the slab test. Components above
# 1e-5 do not change in single precision.
OFF_PLANE = np.float32(1e-13)
# Cosine and sine of the eight azimuths of the planes around a bundle of rays.
AROUND = np.array([(np.cos(k * np.pi / 4), np.sin(k * np.pi / 4)) for k in range(8)])


@dataclass(frozen=True)
class Solids:
    """Geometry of a scene; solid 0 is the room itself, a box seen from inside."""

    # (B, 3): centres and half extents in metres.
    box_centers: NDArray[np.float64]
    box_halves: NDArray[np.float64]
    box_yaws: NDArray[np.float64]  # (B,): turn of each box about the vertical (y) axis in radians
    box_shadows: NDArray[np.bool_]  # (B,): which boxes shade others when the light is computed
    # (K, 3): axis-aligned ellipsoids; they are the solids B, B + 1 and so on.
    ellipsoid_centers: NDArray[np.float64]
    ellipsoid_radii: NDArray[np.float64]

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from each point to the nearest surface, for points inside the room."""
        # Coordinate rows: operations over contiguous memory take a third of the time.
        x, y, z = (points - self.box_centers[0]).T
        nearest = np.minimum.reduce(
            [h - np.abs(p) for h, p in zip(self.box_halves[0], (x, y, z), strict=True)]
        )
        x, y, z = points.T
        for (cx, cy, cz), (hx, hy, hz), yaw in zip(
            self.box_centers[1:], self.box_halves[1:], self.box_yaws[1:], strict=True
        ):
            cos, sin, dx, dz = np.cos(yaw), np.sin(yaw), x - cx, z - cz
            across = np.abs(cos * dx - sin * dz) - hx
            down = np.abs(y - cy) - hy
            along = np.abs(sin * dx + cos * dz) - hz
            inside = np.maximum(np.maximum(across, down), along)
            outside = [np.maximum(excess, 0.0) ** 2 for excess in (across, down, along)]
            distance = np.sqrt(outside[0] + outside[1] + outside[2]) + np.minimum(inside, 0.0)
            nearest = np.minimum(nearest, distance)
        for (cx, cy, cz), radii in zip(self.ellipsoid_centers, self.ellipsoid_radii, strict=True):
            away = np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2)
            nearest = np.minimum(nearest, away - radii.max())
        distances: NDArray[np.float64] = nearest
        return distances

    def in_cone(
        self, origin: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """All boxes and ellipsoids that rays of one bundle meet, and a few that they miss."""
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
        if half_angle < np.pi / 2:
            planes = _planes_around(axis, half_angle)
            boxes = boxes[self._reach_over(boxes, origin, planes)]
        return boxes, touched(self.ellipsoid_centers, self.ellipsoid_radii.max(axis=1))

    def _reach_over(
        self, boxes: NDArray[np.intp], origin: NDArray[np.float64], normals: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Which boxes have a part on the positive side of each plane (K, 3) through a point."""
        cos, sin = np.cos(self.box_yaws[boxes]), np.sin(self.box_yaws[boxes])
        zero, one = np.zeros(len(boxes)), np.ones(len(boxes))
        # World directions of the axes of each box, (3, B, 3).
        axes = np.array([[cos, zero, -sin], [zero, one, zero], [sin, zero, cos]]).swapaxes(1, 2)
        extents = np.abs(axes @ normals.T) * self.box_halves[boxes].T[:, :, None]
        heights = (self.box_centers[boxes] - origin) @ normals.T + extents.sum(axis=0)
        over: NDArray[np.bool_] = (heights >= 0.0).all(axis=1)
        return over


def _planes_around(axis: NDArray[np.float64], half_angle: float) -> NDArray[np.float64]:
    """Inward normals (9, 3) of planes that touch a cone of less than 90 deg from outside."""
    sides = np.sin(half_angle) * axis - np.cos(half_angle) * AROUND @ _frame(axis)
    planes: NDArray[np.float64] = np.concatenate([sides, axis[None]])
    return planes


def _frame(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two unit rows across a unit vector."""
    x, y, z = axis.tolist()
    # Duff et al. 2017, "Building an Orthonormal Basis, Revisited"; NumPy's cross product alone
    # takes longer.
    sign = 1.0 if z >= 0.0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]])


def box_ranges(
    solids: Solids, boxes: NDArray[np.intp], origins: Floats, directions: Floats
) -> tuple[Floats, Floats]:
    """Ranges at which rays enter and leave boxes (slab test)."""
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
    """Range at which rays from one point meet each ellipsoid, inf where they miss."""
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
    """First surface that rays from one point inside the room meet."""
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
    """How far rays get before one of the boxes stops them."""
    free = np.full(directions.shape[1], np.inf, np.float32)
    if len(boxes):
        entries, exits = box_ranges(solids, boxes, origins, directions)
        behind = (exits if inside_stops else entries) <= 0
        entries[(entries > exits) | behind] = np.inf
        free = np.maximum(entries, 0).min(axis=0)
    return free
