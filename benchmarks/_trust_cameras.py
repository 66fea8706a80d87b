# SPDX-License-Identifier: BSD-3-Clause
"""Matches as real 360-degree cameras give them: stitched, and with something that they carry."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]

NUM_MATCHES = 400
WRONG_SHARE = 0.3
NOISE_RAD = np.radians(0.05)
REACH_RAD = np.radians(45.0)  # over which the error of stitching falls to 1 / e of its correlation
ROOM_M = (4.0, 1.5, 4.0)  # half its sides
STEP_M = 0.7  # of the camera along an axis, at most
FAR_M = 1000.0
CLOUDS_ABOVE, CLOUDS_DRIFT = 0.6, 0.05  # sine of their elevation; over their height
CARRIED_DEG = 40.0  # around straight down
CAR_DEG = 30.0  # around what passes
CAR_M = 3.0  # to a car that drives by
TRAM_M, CLUMP, CLUMP_M, CORNER_NOISE_RAD = 4.0, 10, 0.03, np.radians(0.2)  # to a tram; corners
AHEAD_DEG, SWAY_DEG, TURN_DEG = 60.0, 2.5, 6.0  # around who walks ahead, who sways; of the camera


@dataclass(frozen=True)
class CameraMatches:
    """Matches of two views, (N, 3) each, and the true pose; NaN translation of a turn."""

    bearings1: Array
    bearings2: Array
    cam2_from_cam1: Pose


def make_camera_matches(name: str, index: int, seed: int) -> CameraMatches:
    """Trial `index` of a kind of `CAMERAS`: the same for equal arguments."""
    rng = np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode()), index]))
    return CAMERAS[name](rng)


def _stitched(rng: np.random.Generator, *, strength: float, moved: bool) -> CameraMatches:
    """A room or its surroundings, in two views that are each bent by a smooth random field."""
    pose = _pose(rng, moved=moved)
    seen = [_bent(rng, each, strength) for each in _room(rng, pose, NUM_MATCHES)]
    return _disturbed(rng, seen[0], seen[1], pose)


def _carried(rng: np.random.Generator, *, num: int, moved: bool) -> CameraMatches:
    """A hundred matches of a room, and what carries the camera, which never moves."""
    pose = _pose(rng, moved=moved)
    first, second = _room(rng, pose, 100)
    carrier = _cap(rng, num, CARRIED_DEG)
    return _disturbed(
        rng, np.concatenate([first, carrier]), np.concatenate([second, carrier]), pose
    )


def _passed(rng: np.random.Generator, *, num: int) -> CameraMatches:
    """A camera that stands still on its tripod while a car drives by and turns."""
    scene = _unit(rng.normal(size=(100, 3)))
    car = _cap(rng, num, CAR_DEG)[:, [0, 2, 1]] * rng.uniform(3.0, 5.0, (num, 1))
    turn = rotation_from_vector(np.array([0.0, rng.uniform(0.1, 0.6), 0.0]))
    middle = car.mean(axis=0)
    later = (car - middle) @ turn.T + middle + rng.uniform(-1.5, 1.5, 3) * [1.0, 0.0, 1.0]
    first, second = (np.concatenate([scene, _unit(each)]) for each in (car, later))
    return _disturbed(rng, first, second, Pose(np.eye(3), np.full(3, np.nan)))


def _driven_by(rng: np.random.Generator, *, num: int, step_m: float) -> CameraMatches:
    """Three hundred matches of a street and a car that drives by, of a camera that takes a step."""
    turn = rotation_from_vector(np.radians(20.0) * _unit(rng.normal(size=(1, 3)))[0])
    azimuth = rng.uniform(0.0, 2.0 * np.pi)
    step = step_m * np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    pose = Pose(turn, -turn @ step)
    street = rng.uniform([-25.0, -4.0, -25.0], [25.0, 1.6, 25.0], (1000, 3))
    street = street[np.hypot(street[:, 0], street[:, 2]) > CAR_M][:300]
    car = rng.uniform([-2.0, -0.2, CAR_M], [2.0, 1.2, CAR_M + 1.0], (num, 3))
    later = _unit((car + [1.5, 0.0, 0.0] - step) @ turn.T)
    first, second = _seen(rng, street, pose, wrong_share=0.2)
    return _disturbed(
        rng, np.concatenate([first, _unit(car)]), np.concatenate([second, later]), pose
    )


def _beside_tram(rng: np.random.Generator, *, num: int, step_m: float) -> CameraMatches:
    """A street, of a camera that moves on beside a tram which is about as fast.

    The tram has more corners than all the rest, in clumps of ten, as detectors of corners find
    them on windows and letters.
    """
    turn = rotation_from_vector(np.radians(8.0 * rng.random()) * _unit(rng.normal(size=(1, 3)))[0])
    step = step_m * _unit(rng.normal([[1.0, 0.0, 0.0]], [[0.0, 0.03, 0.15]]))[0]
    pose = Pose(turn, -turn @ step)
    street = rng.uniform([-30.0, -8.0, -30.0], [30.0, 1.6, 30.0], (1000, 3))
    street = street[np.hypot(street[:, 0], street[:, 2]) > CAR_M][:150]
    tram = rng.uniform([-4.0, -1.0, TRAM_M], [4.0, 2.0, TRAM_M], (num // CLUMP, 3))
    tram = np.repeat(tram, CLUMP, axis=0)
    tram += rng.normal(0.0, CLUMP_M, tram.shape)
    went = np.array([step_m * rng.uniform(0.8, 1.1), 0.0, 0.0])
    first, second = _seen(rng, street, pose)
    later = _unit((tram + went - step) @ turn.T)
    bearings = np.concatenate([first, _unit(tram)]), np.concatenate([second, later])
    return _disturbed(rng, *bearings, pose, CORNER_NOISE_RAD)


def _followed(rng: np.random.Generator, *, num: int) -> CameraMatches:
    """Two hundred matches of a room, and somebody close by who walks ahead of the camera.

    Each of their matches is where it was, to a few degrees.
    """
    turn = rotation_from_vector(np.radians(TURN_DEG * rng.normal(size=3) * [0.1, 1.0, 0.1]))
    pose = Pose(turn, np.array([0.2, 0.05, -1.0]) * rng.uniform(0.3, 1.0))
    first, second = _room(rng, pose, 200)
    ahead = _cap(rng, num, AHEAD_DEG)[:, [0, 2, 1]]
    swayed = _unit(ahead + np.radians(SWAY_DEG) * _across(ahead, rng.normal(size=ahead.shape)))
    return _disturbed(rng, np.concatenate([first, ahead]), np.concatenate([second, swayed]), pose)


def _far_away(rng: np.random.Generator, *, near_share: float) -> CameraMatches:
    """A camera outdoors that has moved: most of what it sees is far away, the others all around."""
    pose = _pose(rng, moved=True)
    landmarks = _unit(rng.normal(size=(NUM_MATCHES, 3))) * FAR_M
    near = rng.random(NUM_MATCHES) < near_share
    landmarks[near] *= rng.uniform(2.0, 6.0, (near.sum(), 1)) / FAR_M
    return _disturbed(rng, *_seen(rng, landmarks, pose), pose)


def _below_clouds(rng: np.random.Generator) -> CameraMatches:
    """A camera that has turned on its tripod, far from anything, while clouds drift by."""
    pose = _pose(rng, moved=False)
    scene = _unit(rng.normal(size=(NUM_MATCHES, 3)))
    clouds = scene[:, 1] < -CLOUDS_ABOVE
    later = scene.copy()
    later[clouds] = _unit(scene[clouds] / -scene[clouds, 1:2] + [CLOUDS_DRIFT, 0.0, 0.0])
    second = later @ pose.rotation.T
    wrong = rng.random(NUM_MATCHES) < WRONG_SHARE
    second[wrong] = _unit(rng.normal(size=(wrong.sum(), 3)))
    return _disturbed(rng, scene, second, pose)


def _copied(rng: np.random.Generator, *, share: float) -> CameraMatches:
    """Matches of which a share takes the room for its copy, and the others are right or wrong."""
    num_copied = round(share * NUM_MATCHES)
    pose, of_copy = _pose(rng, moved=True), _pose(rng, moved=True)
    first, second = _room(rng, pose, NUM_MATCHES - num_copied, wrong_share=0.0)
    again, copied = _room(rng, of_copy, num_copied, wrong_share=0.0)
    return _disturbed(rng, np.concatenate([first, again]), np.concatenate([second, copied]), pose)


def _mirrored(rng: np.random.Generator) -> CameraMatches:
    """A room whose second view is mirrored left to right: no pose is right."""
    first, second = _room(rng, _pose(rng, moved=True), NUM_MATCHES)
    nothing = Pose(np.eye(3), np.full(3, np.nan))
    return _disturbed(rng, first, second * [-1.0, 1.0, 1.0], nothing)


def _pose(rng: np.random.Generator, *, moved: bool) -> Pose:
    """Pose of a camera that stands upright to a degree and has turned by 30 degrees or more."""
    turn = rotation_from_vector(np.radians([rng.normal(), rng.uniform(30.0, 330.0), rng.normal()]))
    step = rng.uniform(-STEP_M, STEP_M, 3) * [1.0, 0.2, 1.0]
    return Pose(turn, -turn @ step if moved else np.full(3, np.nan))


def _room(
    rng: np.random.Generator, pose: Pose, num: int, wrong_share: float = WRONG_SHARE
) -> tuple[Array, Array]:
    """Bearings of landmarks in a room, some of them matched with anything."""
    return _seen(rng, rng.uniform(-1.0, 1.0, (num, 3)) * ROOM_M, pose, wrong_share)


def _seen(
    rng: np.random.Generator, landmarks: Array, pose: Pose, wrong_share: float = WRONG_SHARE
) -> tuple[Array, Array]:
    """Bearings of landmarks, a share of them matched with anything."""
    second = _unit(landmarks @ pose.rotation.T + np.nan_to_num(pose.translation))
    wrong = rng.random(len(landmarks)) < wrong_share
    second[wrong] = _unit(rng.normal(size=(wrong.sum(), 3)))
    return _unit(landmarks), second


def _bent(rng: np.random.Generator, bearings: Array, strength: float) -> Array:
    """Bearings moved by a field of so many standard deviations of the noise in each component."""
    angles = np.arccos(np.clip(bearings @ bearings.T, -1.0, 1.0))
    covariance = np.exp(-angles / REACH_RAD) + 1e-9 * np.eye(len(bearings))
    field = np.linalg.cholesky(covariance) @ rng.normal(size=bearings.shape)
    return _unit(bearings + strength * NOISE_RAD * _across(bearings, field))


def _disturbed(
    rng: np.random.Generator,
    first: Array,
    second: Array,
    pose: Pose,
    noise_rad: float = NOISE_RAD,
) -> CameraMatches:
    noisy = [
        _unit(each + noise_rad * _across(each, rng.normal(size=each.shape)))
        for each in (first, second)
    ]
    return CameraMatches(noisy[0], noisy[1], pose)


def _cap(rng: np.random.Generator, num: int, radius_deg: float) -> Array:
    """Directions within so many degrees of straight down."""
    down = rng.uniform(np.cos(np.radians(radius_deg)), 1.0, num)
    turn = rng.uniform(0.0, 2.0 * np.pi, num)
    side = np.sqrt(1.0 - down**2)
    return np.column_stack([side * np.cos(turn), down, side * np.sin(turn)])


def _across(bearings: Array, vectors: Array) -> Array:
    """The parts of vectors that are tangent to the sphere."""
    return np.asarray(vectors - bearings * np.sum(vectors * bearings, axis=1, keepdims=True))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


CAMERAS: dict[str, Callable[[np.random.Generator], CameraMatches]] = {
    **{f"turn, stitched {s} x": partial(_stitched, strength=s, moved=False) for s in (1, 3, 10)},
    **{f"step, stitched {s} x": partial(_stitched, strength=s, moved=True) for s in (1, 3, 10)},
    **{f"step, {n} carried": partial(_carried, num=n, moved=True) for n in (50, 150, 400)},
    **{f"turn, {n} carried": partial(_carried, num=n, moved=False) for n in (50, 150, 400)},
    **{f"still, {n} passing": partial(_passed, num=n) for n in (50, 100, 200)},
    **{
        f"step of {step_m} m, {n} on a car": partial(_driven_by, num=n, step_m=step_m)
        for step_m in (0.1, 0.3, 1.0)
        for n in (100, 250)
    },
    **{
        f"step of {step_m} m, {n} on a tram": partial(_beside_tram, num=n, step_m=step_m)
        for step_m in (1.0, 3.0)
        for n in (200, 400)
    },
    **{f"step, {n} walk ahead": partial(_followed, num=n) for n in (100, 200, 300)},
    **{f"step, {p} % near": partial(_far_away, near_share=p / 100) for p in (10, 20, 40)},
    "turn, below clouds": _below_clouds,
    **{f"step, {p} % of a copy": partial(_copied, share=p / 100) for p in (30, 40, 47, 53)},
    "step, mirrored": _mirrored,
}
