# SPDX-License-Identifier: BSD-3-Clause
"""Whether the inliers of a pair lie on the floor, or on one wall.

Floors are printed, walls are tiled or papered, and the same doors hang everywhere: of two rooms one
surface may be the same. Where it is all that matches, it says nothing about the rest. Right pairs
often lie on the floor, which is seen from everywhere; on one wall fewer than one in a hundred does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.places.shared_points import (
    FLOOR_SHARE,
    Cloud,
    PosedPair,
    cloud_of,
    floor_share,
    some_of,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PLANE_SHARE = 0.9  # of the inliers
_THICKNESS = 0.05  # of a surface, as a share of the distance: panels, frames, a wavy floor
_LARGEST_SIGMA, _KNOWN_SHARE = 0.25, 0.5  # of distances that tell surfaces apart, and of the points
_NUM_SAMPLES, _MOST_POINTS, _NUM_FITS = 300, 1000, 3


def on_floor(pair: PosedPair) -> bool:
    """Whether both views see nearly all inliers well below the horizon."""
    return floor_share(*pair.bearings) > FLOOR_SHARE


def on_one_wall(pair: PosedPair) -> bool:
    """Whether nearly all inliers lie on one plane that is not the floor."""
    return not on_floor(pair) and plane_share(pair) > _PLANE_SHARE


def plane_share(pair: PosedPair) -> float:
    """Share of the inliers on the plane that most lie on, as seen from the side where it is less.

    It is 0 if most distances are not known well enough to tell.
    """
    return min(_plane_share(cloud_of(pair, side, 0.0), len(pair.bearings[0])) for side in (0, 1))


def _plane_share(cloud: Cloud, num_inliers: int) -> float:
    known = np.flatnonzero(cloud.log_sigmas < _LARGEST_SIGMA)
    if len(known) < max(3, _KNOWN_SHARE * num_inliers):
        return 0.0
    rows = some_of(known, _MOST_POINTS)
    points, allowed = cloud.points[rows], np.maximum(_THICKNESS, cloud.log_sigmas[rows])
    on_plane = _on_best_of_samples(points, allowed)
    for _ in range(_NUM_FITS):
        normal = np.linalg.lstsq(points[on_plane], np.ones(np.count_nonzero(on_plane)))[0]
        better = _on_plane(points, np.asarray(normal, np.float64), allowed)
        if np.count_nonzero(better) <= np.count_nonzero(on_plane):
            break
        on_plane = better
    return float(np.mean(on_plane))


def _on_best_of_samples(points: Array, allowed: Array) -> Mask:
    """Which points lie on the plane through three of them on which most do."""
    triples = np.random.default_rng(0).integers(len(points), size=(_NUM_SAMPLES, 3))
    corners = points[triples]
    is_plane = np.abs(np.linalg.det(corners)) > 1e-9 * np.prod(
        np.linalg.norm(corners, axis=2), axis=1
    )
    normals = np.linalg.solve(corners[is_plane], np.ones((np.count_nonzero(is_plane), 3, 1)))
    on_planes = _on_plane(points, normals[:, :, 0].T, allowed[:, None])
    best: Mask = on_planes[:, np.argmax(on_planes.sum(axis=0))]
    return best


def _on_plane(points: Array, normals: Array, allowed: Array) -> Mask:
    """Whether points (N, 3) lie on planes n x = 1, to a share of their distances.

    Along a ray n x is the distance over that of the plane.
    """
    found: Mask = np.abs(points @ normals - 1.0) < allowed
    return found
