# SPDX-License-Identifier: BSD-3-Clause
"""Points from the rays of two or more cameras."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearings_array

Array = NDArray[np.float64]

ROUNDS = 3  # of weighting rays by the inverse distance: then they are met by angle, not by length
SMALLEST_PARALLAX = 1e-7  # radians: beyond, the distance is only rounding


class TriangulatedTracks(NamedTuple):
    """One row a track; NaN where the rays do not meet: fewer than two, or all parallel.

    ``residual_rad`` is the largest angle between a ray and the direction to the point,
    ``in_front`` whether the point lies ahead on every ray.
    """

    points: Array
    parallax_rad: Array
    residual_rad: Array
    in_front: NDArray[np.bool_]


def triangulate_tracks(
    centers: ArrayLike, rays: ArrayLike, track_index: ArrayLike, num_tracks: int
) -> TriangulatedTracks:
    """Return the point of each track from its rays (M, 3) in the world, in any order.

    Rows with NaN are missing. ``ValueError`` if shapes or indices are wrong.
    """
    b = bearings_array(rays, "rays")
    c = np.asarray(centers, dtype=np.float64)
    track = np.asarray(track_index)
    if c.shape != b.shape or track.shape != (len(b),):
        raise ValueError(
            f"centers, rays and track_index must have one row a ray, got {c.shape}, {b.shape} "
            f"and {track.shape}"
        )
    if len(track) and (track.min() < 0 or track.max() >= num_tracks):
        raise ValueError(f"track_index must hold whole numbers from 0 to {num_tracks - 1}")
    if np.isinf(c).any():
        raise ValueError("centers must be finite (NaN marks a missing row)")
    present = np.isfinite(b[:, 0]) & np.isfinite(c).all(axis=1)
    order = np.flatnonzero(present)
    order = order[np.argsort(track[order], kind="stable")]
    b, c, track = b[order], c[order], track[order].astype(np.int64)
    parallax = _widest_parallax(b, track, num_tracks)
    points = _nearest_points(c, b, track, num_tracks, parallax > SMALLEST_PARALLAX)
    towards = points[track] - c
    angles = np.arctan2(
        np.linalg.norm(np.cross(b, towards), axis=1), np.einsum("mi,mi->m", b, towards)
    )
    residuals = np.full(num_tracks, -np.inf)
    met = np.isfinite(angles)
    np.maximum.at(residuals, track[met], angles[met])
    residuals[np.isinf(residuals)] = np.nan
    in_front = residuals < np.pi / 2  # false where NaN
    return TriangulatedTracks(points, parallax, residuals, in_front)


def _nearest_points(
    c: Array, b: Array, track: NDArray[np.int64], num_tracks: int, meets: NDArray[np.bool_]
) -> Array:
    """Return the points of least squared distances to the rays, each over its own distance."""
    origin = (
        _sums(c, track, num_tracks)
        / np.maximum(np.bincount(track, minlength=num_tracks), 1)[:, None]
    )
    local = c - origin[track]  # the digits of far worlds are not lost
    across = np.eye(3) - b[:, :, None] * b[:, None, :]
    weights = np.ones(len(b))
    points = np.full((num_tracks, 3), np.nan)
    for _ in range(ROUNDS):
        A = _sums(weights[:, None, None] * across, track, num_tracks)
        y = _sums(weights[:, None] * np.einsum("mij,mj->mi", across, local), track, num_tracks)
        points[meets] = np.linalg.solve(A[meets], y[meets][:, :, None])[:, :, 0]
        squares = np.square(points[track] - local).sum(axis=1)
        # Only ratios within a track matter; the least distance keeps a point at a camera finite.
        mean = _sums(squares, track, num_tracks) / np.maximum(
            np.bincount(track, minlength=num_tracks), 1
        )
        mean = np.where(mean > 0.0, mean, 1.0)
        weights = 1.0 / np.maximum(squares / mean[track], 1e-6)
    return points + origin


def _widest_parallax(b: Array, track: NDArray[np.int64], num_tracks: int) -> Array:
    """Return the largest angle between two rays of each track; NaN for fewer than two."""
    counts = np.bincount(track, minlength=num_tracks)
    starts = np.cumsum(counts) - counts
    widest = np.full(num_tracks, np.nan)
    for length in np.unique(counts[counts > 1]):
        tracks = np.flatnonzero(counts == length)
        rays = b[starts[tracks, None] + np.arange(length)]
        pairs = (rays @ np.swapaxes(rays, 1, 2)).reshape(len(tracks), -1).argmin(axis=1)
        one, other = (rays[np.arange(len(tracks)), k] for k in divmod(pairs, length))
        sines = np.linalg.norm(np.cross(one, other), axis=1)
        widest[tracks] = np.arctan2(sines, np.einsum("ti,ti->t", one, other))
    return widest


def _sums(values: Array, track: NDArray[np.int64], num_tracks: int) -> Array:
    """Return the sum of the rows of each track."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    columns = [np.bincount(track, flat[:, k], num_tracks) for k in range(flat.shape[1])]
    sums = np.stack(columns, axis=1).astype(np.float64)  # counts, if there are no rows
    return sums.reshape(num_tracks, *values.shape[1:])
