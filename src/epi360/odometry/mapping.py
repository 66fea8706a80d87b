# SPDX-License-Identifier: BSD-3-Clause
"""How the map grows and is adjusted: new landmarks, and the last key frames together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.odometry.gravity import GravityPrior
from epi360.odometry.key_frames import Ids, SparseMap
from epi360.odometry.points import triangulate_tracks
from epi360.odometry.turning import nearest_rotation
from epi360.odometry.window import WindowProblem, WindowResult, adjust_window

Array = NDArray[np.float64]

# In units of the noise. A point whose parallax is eight times the noise has its depth to an eighth.
_SMALLEST_PARALLAX = 8.0
_KEY_FRAMES_BACK = 16  # that may see a new landmark, or are held while the window is adjusted
_FEWEST_SHARED = 10  # landmarks that a held key frame shares with the window
_NOISE_OF_MEDIAN = 1.0 / 1.1774  # of the length of a two-dimensional normal error


@dataclass(frozen=True)
class Noise:
    """Standard deviation of tracks per axis, and from which angle on they count as wrong."""

    sigma_rad: float
    outlier_rad: float


def triangulate_new(sparse_map: SparseMap, noise: Noise) -> int:
    """Place the landmarks of tracks of the last key frame that have enough parallax by now."""
    last = sparse_map.key_frames[-1]
    ids = np.unique(last.ids[last.is_used & sparse_map.is_free(last.ids)])
    return triangulate(sparse_map, ids, noise)


def triangulate(
    sparse_map: SparseMap, ids: Ids, noise: Noise, smallest_parallax: float = _SMALLEST_PARALLAX
) -> int:
    """Place landmarks (sorted identities) that the last key frames see well enough."""
    if len(ids) == 0:
        return 0
    centers, rays, tracks = [], [], []
    for number in sparse_map.newest(_KEY_FRAMES_BACK):
        key_frame = sparse_map.key_frames[number]
        rows = np.flatnonzero(key_frame.is_used & np.isin(key_frame.ids, ids))
        centers.append(np.broadcast_to(key_frame.center, (len(rows), 3)))
        rays.append(key_frame.bearings[rows] @ key_frame.rotation)
        tracks.append(np.searchsorted(ids, key_frame.ids[rows]))
    found = triangulate_tracks(
        np.concatenate(centers), np.concatenate(rays), np.concatenate(tracks), len(ids)
    )
    good = (
        found.in_front
        & np.isfinite(found.points).all(axis=1)
        & (found.parallax_rad >= smallest_parallax * noise.sigma_rad)
        & (found.residual_rad <= noise.outlier_rad)
    )
    sparse_map.set_positions(ids[good], found.points[good])
    return int(good.sum())


def adjust_last(
    sparse_map: SparseMap,
    window: int,
    noise: Noise,
    *,
    gravity: GravityPrior | None = None,
    max_iterations: int = 5,
) -> float:
    """Adjust the last key frames and what they see; returns the noise that is left, in radians."""
    free = sparse_map.newest(window)
    are_all_free = len(free) == len(sparse_map.key_frames)
    held = [] if are_all_free else _held(sparse_map, free)
    numbers = held + free
    fixed = np.zeros(len(numbers), np.bool_)
    fixed[: max(len(held), 1)] = True
    if not are_all_free and len(held) < 2:  # nothing older holds the scale
        fixed[:2] = True
    return adjust(sparse_map, numbers, fixed, noise, gravity=gravity, max_iterations=max_iterations)


def adjust_all(
    sparse_map: SparseMap,
    noise: Noise,
    *,
    gravity: GravityPrior | None = None,
    max_iterations: int = 15,
) -> float:
    """Adjust all key frames together, the first one held; returns the noise that is left."""
    numbers = list(range(len(sparse_map.key_frames)))
    fixed = np.arange(len(numbers)) == 0
    return adjust(sparse_map, numbers, fixed, noise, gravity=gravity, max_iterations=max_iterations)


def adjust(
    sparse_map: SparseMap,
    numbers: list[int],
    fixed: NDArray[np.bool_],
    noise: Noise,
    *,
    gravity: GravityPrior | None = None,
    max_iterations: int,
) -> float:
    """Adjust these key frames but the fixed ones, and the landmarks that the others see."""
    places, ids, bearings = sparse_map.observations(numbers)
    landmarks, points = np.unique(ids, return_inverse=True)
    seen_free = np.zeros(len(landmarks), np.bool_)
    seen_free[points[~fixed[places]]] = True
    kept = seen_free[points] & (np.bincount(points)[points] > 1)
    places, ids, bearings = places[kept], ids[kept], bearings[kept]
    landmarks, points = np.unique(ids, return_inverse=True)
    if len(landmarks) < _FEWEST_SHARED:
        return noise.sigma_rad
    key_frames = [sparse_map.key_frames[number] for number in numbers]
    problem = WindowProblem(
        rotations=np.array([each.rotation for each in key_frames]),
        translations=np.array([each.translation for each in key_frames]),
        points=sparse_map.positions_of(landmarks),
        frame_index=places,
        point_index=points.astype(np.int64),
        bearings=bearings,
        noise_rad=noise.sigma_rad,
        fixed=fixed,
    )
    if gravity is not None:
        problem = _with_gravity(problem, gravity, gravity.in_world(sparse_map.key_frames))
    result = adjust_window(problem, loss="cauchy", max_iterations=max_iterations)
    for place, key_frame in enumerate(key_frames):
        key_frame.rotation = nearest_rotation(result.rotations[place])
        key_frame.translation = result.translations[place]
    sparse_map.set_positions(landmarks, result.points)
    _cull(sparse_map, numbers, places, ids, result, noise.outlier_rad)
    # Points that few frames see fit better than their noise: two numbers an observation, three a
    # landmark.
    share = max(1.0 - 1.5 * len(landmarks) / len(ids), 0.25)
    return float(np.nanmedian(result.residuals_rad) * _NOISE_OF_MEDIAN / np.sqrt(share))


def _with_gravity(problem: WindowProblem, gravity: GravityPrior, in_world: Array) -> WindowProblem:
    num_frames = len(np.asarray(problem.rotations))
    return replace(
        problem,
        gravity=np.tile(gravity.direction, (num_frames, 1)),
        gravity_sigma_rad=gravity.sigma_rad,
        world_gravity=in_world,
    )


def _held(sparse_map: SparseMap, free: list[int]) -> list[int]:
    """Older key frames that see most of what the free ones see; they hold world and scale."""
    _, ids, _ = sparse_map.observations(free)
    wanted = np.unique(ids)
    shared = []
    for number in sparse_map.newest(_KEY_FRAMES_BACK + len(free))[: -len(free)]:
        key_frame = sparse_map.key_frames[number]
        count = int(np.isin(key_frame.ids[key_frame.is_used], wanted).sum())
        if count >= _FEWEST_SHARED:
            shared.append((count, number))
    return sorted(number for _, number in sorted(shared)[-len(free) :])


def _cull(
    sparse_map: SparseMap,
    numbers: list[int],
    places: NDArray[np.int64],
    ids: Ids,
    result: WindowResult,
    outlier_rad: float,
) -> None:
    """Set aside observations that disagree, and landmarks that fewer than two are left of."""
    bad = ~(result.residuals_rad <= outlier_rad)
    for place in np.unique(places[bad]):
        key_frame = sparse_map.key_frames[numbers[place]]
        key_frame.is_used &= ~np.isin(key_frame.ids, ids[bad & (places == place)])
    landmarks, rows = np.unique(ids, return_inverse=True)
    num_bad = np.bincount(rows, bad)
    total = np.bincount(rows)
    gone = (total - num_bad < 2) | (num_bad > 0.5 * total)
    sparse_map.unplace(landmarks[gone])
