# SPDX-License-Identifier: BSD-3-Clause
"""Matches that do not determine a pose, or hardly, whatever their number: seeded, with truth."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose, rotation_from_vector
from epi360.synthetic import sample_relative_pose

Array = NDArray[np.float64]

NUM_MATCHES = 100
NOISE_RAD, TINY_NOISE_RAD = 1e-4, 1e-9
PATCH_RADIUS_M = 0.002
NEAREST_M, FARTHEST_M = 1.5, 5.0


@dataclass(frozen=True)
class DegenerateMatches:
    """Matches of two views that do not determine their pose.

    Attributes
    ----------
    bearings1, bearings2 : ndarray, shape (100, 3)
    cam2_from_cam1 : Pose
        Truth, metric.
    arguments : dict
        More arguments of `estimate_relative_pose`.
    """

    bearings1: Array
    bearings2: Array
    cam2_from_cam1: Pose
    arguments: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Kind:
    """Where the landmarks of a kind lie, how noisy their bearings are, and what goes with them.

    With ``apart_deg`` every second match is that of another pose, so far away in rotation, which
    has the same likelihood as the truth.
    """

    landmarks: Callable[[np.random.Generator, Pose], Array]
    noise_rad: float = NOISE_RAD
    jacobian: float | None = None
    apart_deg: float | None = None


def make_degenerate(name: str, index: int, seed: int) -> DegenerateMatches:
    """Trial `index` of a kind of `KINDS`: the same for equal arguments."""
    kind = KINDS[name]
    rng = np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode()), index]))
    pose = sample_relative_pose(rng)
    landmarks = kind.landmarks(rng, pose)
    seen = landmarks @ pose.rotation.T + pose.translation
    bearings = [_disturbed(rng, points, kind.noise_rad) for points in (landmarks, seen)]
    if kind.apart_deg is not None:
        for each, mirror in zip(bearings, _mirrors(rng, pose, kind.apart_deg), strict=True):
            each[1::2] = each[::2] @ mirror
    arguments: dict[str, Any] = {}
    if kind.jacobian is not None:
        jacobians = np.full((NUM_MATCHES, 3, 2), kind.jacobian)
        arguments = {
            "residual": "tangent_sampson",
            "jacobians1": jacobians,
            "jacobians2": jacobians,
        }
    return DegenerateMatches(bearings[0], bearings[1], pose, arguments)


def _mirrors(rng: np.random.Generator, pose: Pose, apart_deg: float) -> tuple[Array, Array]:
    """Mirrors of view 1 and view 2: what both show is seen from a pose with another rotation.

    If d2 b2 = d1 R b1 + t, then d2 M2 b2 = d1 (M2 R M1) M1 b1 + M2 t. The rotation M2 R M1 R^T
    turns by twice the angle between the normal of M2 and that of M1, which R has turned.
    """
    normal, across = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    turned = rotation_from_vector(np.radians(apart_deg / 2.0) * across) @ normal
    normals = (pose.rotation.T @ turned, normal)
    mirrors = [np.eye(3) - 2.0 * np.outer(each, each) for each in normals]
    return mirrors[0], mirrors[1]


def _disturbed(rng: np.random.Generator, points: Array, noise_rad: float) -> Array:
    """Unit bearings of points with noise of this standard deviation per tangent axis."""
    bearings = points / np.linalg.norm(points, axis=1, keepdims=True)
    noise = rng.normal(0.0, noise_rad, bearings.shape)
    noise -= bearings * np.sum(noise * bearings, axis=1, keepdims=True)
    disturbed = bearings + noise
    return np.asarray(disturbed / np.linalg.norm(disturbed, axis=1, keepdims=True))


def _anywhere(rng: np.random.Generator, num: int) -> Array:
    directions = rng.normal(size=(num, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(directions * rng.uniform(NEAREST_M, FARTHEST_M, (num, 1)))


def _points(rng: np.random.Generator, _: Pose, *, num: int) -> Array:
    """A few landmarks, each matched again and again."""
    return np.asarray(_anywhere(rng, num)[np.arange(NUM_MATCHES) % num])


def _patches(rng: np.random.Generator, _: Pose, *, num: int, radius_m: float) -> Array:
    """Landmarks in a few tiny clouds."""
    centers = _anywhere(rng, num)[np.arange(NUM_MATCHES) % num]
    return np.asarray(centers + rng.normal(0.0, radius_m, centers.shape))


def _line(rng: np.random.Generator, _: Pose) -> Array:
    """Landmarks on one straight line."""
    middle, direction = _anywhere(rng, 1), rng.normal(size=(1, 3))
    direction /= np.linalg.norm(direction)
    return np.asarray(middle + direction * rng.uniform(-3.0, 3.0, (NUM_MATCHES, 1)))


def _epipolar_plane(rng: np.random.Generator, pose: Pose) -> Array:
    """Landmarks all around in one plane with both cameras."""
    base = -pose.rotation.T @ pose.translation
    normal = np.cross(base, rng.normal(size=3))
    normal /= np.linalg.norm(normal)
    points = _anywhere(rng, NUM_MATCHES)
    return np.asarray(points - np.outer(points @ normal, normal))


def _everywhere(rng: np.random.Generator, _: Pose) -> Array:
    return _anywhere(rng, NUM_MATCHES)


KINDS: dict[str, Kind] = {
    **{f"{n} repeated points": Kind(partial(_points, num=n)) for n in (2, 3, 4)},
    **{
        f"{n} tiny patches": Kind(partial(_patches, num=n, radius_m=PATCH_RADIUS_M))
        for n in (2, 3, 4)
    },
    "points of one line": Kind(_line),
    "rays and base in one plane": Kind(_epipolar_plane),
    **{
        f"{n} repeated points, noise 1e-9": Kind(partial(_points, num=n), TINY_NOISE_RAD)
        for n in (3, 4)
    },
    "two clusters of spread 1e-9": Kind(partial(_patches, num=2, radius_m=1e-9), 0.0),
    **{f"two poses {deg} degrees apart": Kind(_everywhere, apart_deg=deg) for deg in (12, 40)},
    "Jacobians of 0": Kind(_everywhere, jacobian=0.0),
    "Jacobians of 1e-320": Kind(_everywhere, jacobian=1e-320),
}
