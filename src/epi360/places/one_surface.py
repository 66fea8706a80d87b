# SPDX-License-Identifier: BSD-3-Clause
"""Whether the inliers of a pair lie on the floor, or on one wall.

Floors are printed, walls are tiled or papered, and the same doors hang everywhere: of two rooms one
surface may be the same. Where it is all that matches, it says nothing about the rest. Right pairs
often lie on the floor, which is seen from everywhere; on one wall fewer than one in a hundred does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.places.shared_points import FLOOR_SHARE, PosedPair, cloud_of, floor_share, some_of

Array = NDArray[np.float64]

_PLANE_SHARE = 0.9  # of the inliers
_THICKNESS = 0.05  # of a wall, as a share of the distance: panels, frames, what hangs there
_NUM_SIGMAS, _LARGEST_SIGMA = 2.5, 0.1  # of a distance that tells whether a point is on a plane
_UPRIGHT = 0.7  # a plane whose unit normal has more of it along the vertical is no wall
_NUM_SAMPLES, _MOST_POINTS = 300, 1000


class Plane(NamedTuple):
    """The plane normal x = 1 that most inliers lie on, and the share of them that does."""

    normal: Array
    share: float


def on_floor(pair: PosedPair) -> bool:
    """Whether both views see nearly all inliers well below the horizon."""
    return floor_share(*pair.bearings) > FLOOR_SHARE


def on_one_wall(pair: PosedPair) -> bool:
    """Whether nearly all inliers lie on one plane that is upright in both views."""
    return not on_floor(pair) and all(
        plane.share > _PLANE_SHARE and _is_upright(plane.normal)
        for plane in (main_plane(pair, side) for side in (0, 1))
    )


def main_plane(pair: PosedPair, side: int) -> Plane:
    """The plane that most inliers lie on, in the frame of the camera of one side.

    A point whose distance is not known to a tenth lies on no plane.
    """
    cloud = cloud_of(pair, side, 0.0)
    known = np.flatnonzero(cloud.log_sigmas < _LARGEST_SIGMA)
    rows = some_of(known, _MOST_POINTS)
    points = cloud.points[rows]
    allowed = np.maximum(_THICKNESS, _NUM_SIGMAS * cloud.log_sigmas[rows])
    normal, num_on_plane = _best_of_samples(points, allowed)
    if num_on_plane == 0:
        return Plane(normal, 0.0)
    share_known = len(known) / len(pair.bearings[0])
    return Plane(normal, share_known * num_on_plane / len(rows))


def _best_of_samples(points: Array, allowed: Array) -> tuple[Array, int]:
    """Normal of the plane through three of the points on which most of them lie, and how many."""
    if len(points) < 3:
        return np.zeros(3), 0
    triples = np.random.default_rng(0).integers(len(points), size=(_NUM_SAMPLES, 3))
    corners = points[triples]
    # Through corners a, b and c leads the plane (b - a) x (c - a) x = a (b x c).
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        normals /= np.linalg.det(corners)[:, None]
    normals = np.nan_to_num(normals, nan=0.0, posinf=0.0, neginf=0.0)
    # Along a ray, normal x is the distance over that of the plane.
    on_planes = np.abs(points @ normals.T - 1.0) < allowed[:, None]
    counts = on_planes.sum(axis=0)
    best = int(np.argmax(counts))
    return normals[best], int(counts[best])


def _is_upright(normal: Array) -> bool:
    return bool(abs(normal[1]) < _UPRIGHT * np.linalg.norm(normal))
