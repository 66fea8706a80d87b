# SPDX-License-Identifier: BSD-3-Clause
"""Where the landmarks of a two-view scene are: on walls, all around, in a cone, on a plane."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose
from epi360.synthetic.directions import cap_directions, tangents

Array = NDArray[np.float64]

Layout = Literal["room", "sphere", "cone", "plane", "behind"]

# No landmark is closer than this to either camera, so that every bearing is well defined.
MIN_RANGE_M = 0.3
# In layouts without walls, ranges are log-uniform between these, as in an indoor scene.
NEAREST_M, FARTHEST_M = 1.0, 10.0
# Half extents of the room of the layout "room"; it grows where camera 2 stands outside.
ROOM_HALF_M = (3.5, 1.6, 2.5)
WALL_CLEARANCE_M = 0.5

Sampler = Callable[[np.random.Generator, int], Array]


def sample_points(
    rng: np.random.Generator, num: int, layout: Layout, half_angle: float, pose: Pose
) -> Array:
    """Landmarks of a layout that keep their distance from both cameras, by rejection."""
    center2 = pose.inverse().translation
    samplers: dict[str, Sampler] = {
        "room": lambda rng, num: _room_points(rng, num, center2),
        "sphere": lambda rng, num: _ranged(rng, cap_directions(rng, num, np.pi)),
        "cone": lambda rng, num: _ranged(rng, cap_directions(rng, num, half_angle)),
        "behind": lambda rng, num: _ranged(rng, -cap_directions(rng, num, np.pi / 2)),
    }
    sample = _plane_sampler(rng, center2) if layout == "plane" else samplers[layout]
    kept: list[Array] = [np.empty((0, 3))]
    for _ in range(1000):
        missing = num - sum(len(points) for points in kept)
        if missing == 0:
            return np.concatenate(kept)
        points = sample(rng, max(missing, 16))
        points2 = points @ pose.rotation.T + pose.translation
        ranges = np.minimum(np.linalg.norm(points, axis=1), np.linalg.norm(points2, axis=1))
        good = ranges >= MIN_RANGE_M
        if layout == "behind":
            good &= (points[:, 2] < 0.0) & (points2[:, 2] < 0.0)
        kept.append(points[good][:missing])
    raise ValueError(f"cam2_from_cam1 sees no landmarks of the layout {layout!r}; turn it less")


def _room_points(rng: np.random.Generator, num: int, center2: Array) -> Array:
    low = np.minimum(-np.array(ROOM_HALF_M), center2 - WALL_CLEARANCE_M)
    high = np.maximum(ROOM_HALF_M, center2 + WALL_CLEARANCE_M)
    size = high - low
    areas = np.prod(size) / size
    axis = rng.choice(3, num, p=areas / areas.sum())
    points = rng.uniform(low, high, (num, 3))
    points[np.arange(num), axis] = np.where(rng.random(num) < 0.5, low[axis], high[axis])
    return points


def _plane_sampler(rng: np.random.Generator, center2: Array) -> Sampler:
    """One random plane in front of both cameras, and a sampler of an 8 m square on it."""
    normal = cap_directions(rng, 1, np.pi)
    distance = rng.uniform(1.5, 3.0) + max(0.0, float(normal[0] @ center2))
    span = np.concatenate(tangents(normal))

    def sample(rng: np.random.Generator, num: int) -> Array:
        return np.asarray(distance * normal + rng.uniform(-4, 4, (num, 2)) @ span)

    return sample


def _ranged(rng: np.random.Generator, directions: Array) -> Array:
    ranges = np.exp(rng.uniform(np.log(NEAREST_M), np.log(FARTHEST_M), (len(directions), 1)))
    return np.asarray(ranges * directions)
