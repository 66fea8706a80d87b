# SPDX-License-Identifier: BSD-3-Clause
"""The way of a hand-held camera through a scene: smooth, free of collisions, in six degrees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose
from epi360.synthetic.landmarks import rotation_from_heading
from epi360_scenes.walks import plan_walk

# A person walks two steps every 1.4 m; head and hand rise and sway by about 2 cm.
STRIDE_M = 1.4
BOB_M, SWAY_M = 0.018, 0.022
# Slow changes of the height at which the camera is held, and of where it looks.
HEIGHT_CHANGE_M = 0.08
GLANCE_DEG, TILT_DEG, ROLL_DEG = 35.0, 6.0, 4.0
# The path is computed this many times finer than the steps between frames.
SUBSTEPS = 4

Floats = NDArray[np.float64]


class WalkableScene(Protocol):
    """A scene as `handheld_path` needs it; metres."""

    @property
    def up(self) -> Floats:
        """Unit vector (3,) against gravity, in the world."""

    @property
    def bounds(self) -> Floats:
        """Lowest and highest world coordinates (2, 3) of the scene."""

    def distances(self, points: Floats) -> Floats:
        """Distance (N,) from each point (N, 3) to the nearest surface, negative inside a solid."""


@dataclass(frozen=True)
class _Options:
    """How the camera is carried."""

    step_m: float
    height_m: float
    clearance_m: float
    max_turn_deg: float

    def __post_init__(self) -> None:
        for name in ("step_m", "height_m", "clearance_m", "max_turn_deg"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


def handheld_path(
    scene: WalkableScene,
    num_frames: int,
    seed: int = 0,
    *,
    step_m: float = 0.04,
    height_m: float = 1.5,
    clearance_m: float = 0.35,
    max_turn_deg: float = 2.0,
    loop: bool = False,
) -> list[Pose]:
    """Poses of a camera that somebody carries through a scene, looking around.

    Parameters
    ----------
    scene : WalkableScene
        A `Room` or a `MeshScene`.
    num_frames : int
        At least 1.
    seed : int
        Equal arguments and seed give equal paths.
    step_m : float
        Largest way between two frames; 0.04 m is 1.2 m/s at 30 frames a second, so that the
        camera moves 0.5 m in 13 frames.
    height_m : float
        Mean height of the camera over the floor.
    clearance_m : float
        Least distance of the camera from every surface.
    max_turn_deg : float
        Largest turn of the camera between two frames.
    loop : bool
        Whether the last pose is the first one again. Steps are then a little shorter.

    Returns
    -------
    world_from_cam : list of Pose
        One pose a frame; steps are `step_m` long, or shorter where the walker turns round.

    Raises
    ------
    ValueError
        If `num_frames` is below 1, another number is not positive, the scene has no room to walk,
        or the frames are too few for a loop.

    Notes
    -----
    Shortest ways between random places, kept away from furniture, are smoothed to a curve. The
    walker's steps make the camera bob and sway; its height, heading, pitch and roll drift with
    noise of the length of a step or more. Turns are slowed down to `max_turn_deg`.
    """
    if num_frames < 1:
        raise ValueError(f"num_frames must be 1 or more, got {num_frames}")
    options = _Options(step_m, height_m, clearance_m, max_turn_deg)
    rng = np.random.Generator(np.random.PCG64(seed))
    level = _Level(scene)
    if loop:
        positions = _loop(seed, num_frames, level, options)
    else:
        length = step_m * num_frames
        walk = plan_walk(rng, level.distances, level.bounds, length, height_m, clearance_m)
        positions = _carried(rng, walk, options, level.distances)
        positions = _in_steps(positions, options.step_m / SUBSTEPS, options.step_m)[:num_frames]
    rotations = _looking_around(rng, positions, options, loop)
    return [
        level.world_from_level @ Pose(rotation, position)
        for rotation, position in zip(rotations, positions, strict=True)
    ]


class _Level:
    """A scene in a frame with y straight down, which the planner needs."""

    def __init__(self, scene: WalkableScene) -> None:
        down = -scene.up
        # The axis furthest from the vertical becomes about z: a room keeps its axes.
        axis = np.eye(3)[2 - int(np.argmin(np.abs(down[::-1])))]
        right = np.cross(down, axis)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, down, np.cross(right, down)], axis=1)
        self.world_from_level = Pose(rotation, np.zeros(3))
        corners = np.array(np.meshgrid(*scene.bounds.T)).reshape(3, -1).T @ rotation
        self.bounds = np.stack([corners.min(axis=0), corners.max(axis=0)])
        self.distances: Callable[[Floats], Floats] = lambda points: scene.distances(
            points @ rotation.T
        )


def _loop(seed: int, num_frames: int, level: _Level, options: _Options) -> Floats:
    """Positions of a walk that ends where it begins, in as many steps as asked for."""
    for share in 0.9 ** np.arange(1, 40):
        rng = np.random.Generator(np.random.PCG64([seed, 1]))
        length = share * options.step_m * num_frames
        walk = plan_walk(
            rng, level.distances, level.bounds, length, options.height_m, options.clearance_m,
            loop=True,
        )  # fmt: skip
        positions = _carried(rng, walk, options, level.distances, loop=True)
        times = _times(positions, options.step_m / SUBSTEPS)
        if times[-1] <= options.step_m * (num_frames - 1):
            at = np.linspace(0.0, times[-1], num_frames)
            return np.stack([np.interp(at, times, column) for column in positions.T], axis=1)
    raise ValueError(f"num_frames must be more for a loop of steps of {options.step_m} m")


def _carried(
    rng: np.random.Generator,
    walk: Floats,
    options: _Options,
    distances: Callable[[Floats], Floats],
    *,
    loop: bool = False,
) -> Floats:
    """Positions (M, 3) of the hand, fine along the walk, that keep the clearance."""
    fine = options.step_m / SUBSTEPS
    way = _evenly(walk, fine)
    offsets = _gait(rng, len(way), fine)
    for smoothing_m in (0.5, 0.35, 0.25, 0.15, 0.1, 0.05):
        ground = _smooth(way, smoothing_m / fine)
        positions = ground + _sideways(ground, fine) * offsets[:, :1]
        positions[:, 1] -= offsets[:, 1]
        if loop:
            positions += _closing(positions[0] - positions[-1], len(positions), 1.0 / fine)
        if distances(positions).min() >= options.clearance_m:
            return positions
    raise ValueError(
        f"the scene is too narrow for a clearance of {options.clearance_m} m; use a smaller one"
    )


def _gait(rng: np.random.Generator, num: int, fine: float) -> Floats:
    """Offsets (M, 2) of the hand from a smooth walk, to the side and up."""
    phase = 2 * np.pi * np.arange(num) * fine / STRIDE_M + rng.uniform(0, 2 * np.pi)
    strength = 1.0 + 0.3 * smooth_noise(rng, num, 1.5 / fine)
    up = BOB_M * strength * np.cos(2 * phase) + HEIGHT_CHANGE_M * smooth_noise(rng, num, 2.0 / fine)
    return np.stack([SWAY_M * strength * np.sin(phase), up], axis=1)


def _sideways(ground: Floats, fine: float) -> Floats:
    """Vectors (M, 3) across the walk; they are shorter where the walker is slow."""
    x, _, z = np.gradient(ground, fine, axis=0).T
    return np.stack([z, np.zeros(len(ground)), -x], axis=1)


def _closing(difference: Floats, num: int, samples: float) -> Floats:
    """Shifts (num, D) that grow smoothly to a difference over the last samples."""
    share = np.clip((np.arange(num) - (num - 1)) / min(samples, num - 1) + 1, 0.0, 1.0)
    shifts: Floats = (share**2 * (3 - 2 * share))[:, None] * difference
    return shifts


def _looking_around(
    rng: np.random.Generator, positions: Floats, options: _Options, loop: bool = False
) -> Floats:
    """Rotations (F, 3, 3) of a camera that looks about where it goes, turning slowly enough."""
    num, step = len(positions), options.step_m
    moves = np.gradient(positions, axis=0) if num > 1 else np.array([[0.0, 0.0, 1.0]])
    heading = np.unwrap(np.arctan2(moves[:, 0], moves[:, 2]))
    glance = np.radians(GLANCE_DEG) * smooth_noise(rng, num, 1.2 / step)
    pitch = np.radians(TILT_DEG) * smooth_noise(rng, num, 0.8 / step)
    roll = np.radians(ROLL_DEG) * smooth_noise(rng, num, 0.8 / step)
    shake = np.radians(0.25) * np.stack([smooth_noise(rng, num, 0.12 / step) for _ in range(3)])
    for smoothing_m in 0.6 * 1.5 ** np.arange(20):
        yaw = _smooth(heading + glance, smoothing_m / step)
        angles = np.stack([pitch, yaw, roll]) + shake
        if loop and num > 1:
            angles += _closed_angles(angles, options.max_turn_deg)
        rotations = np.array([rotation_from_heading(row) for row in angles.T])
        if num == 1 or _turns_deg(rotations).max() <= options.max_turn_deg:
            return rotations
        pitch, roll, shake = (0.9 * part for part in (pitch, roll, shake))
    return rotations


def _closed_angles(angles: Floats, max_turn_deg: float) -> Floats:
    """Shifts of pitch, yaw and roll (3, F) after which the last ones are the first again."""
    difference = angles[:, 0] - angles[:, -1]
    difference[1] = (difference[1] + np.pi) % (2 * np.pi) - np.pi  # whole turns are kept
    # At most half of the allowed turn a frame goes into it; the smooth step is 1.5 times as steep.
    frames = max(10.0, 3.0 * float(np.degrees(np.abs(difference).max())) / max_turn_deg)
    return _closing(difference, angles.shape[1], frames).T


def _turns_deg(rotations: Floats) -> Floats:
    """Angle between each rotation and the next; chords are exact for small turns."""
    chords = np.linalg.norm(np.diff(rotations, axis=0), axis=(1, 2)) / np.sqrt(8.0)
    angles: Floats = np.degrees(2 * np.arcsin(np.minimum(chords, 1.0)))
    return angles


def smooth_noise(rng: np.random.Generator, num: int, correlation: float) -> Floats:
    """Noise (num,) of about unit deviation, correlated over so many samples."""
    # Knots from a generator in order, so that a longer path starts as a shorter one does.
    spacing = 1.5 * correlation
    knots = rng.standard_normal(int(num / spacing) + 6)
    at = np.arange(num) / spacing + 2.0
    whole = at.astype(np.intp)
    offsets = at - whole
    # Uniform cubic B-spline through random control values.
    weights = np.array([
        (1 - offsets) ** 3,
        3 * offsets**3 - 6 * offsets**2 + 4,
        -3 * offsets**3 + 3 * offsets**2 + 3 * offsets + 1,
        offsets**3,
    ]) / 6  # fmt: skip
    mixed: Floats = sum(weights[k] * knots[whole + k - 1] for k in range(4)) / 0.69
    return mixed


def _smooth(values: Floats, deviation: float) -> Floats:
    """Gaussian mean along axis 0, the ends held."""
    from scipy.ndimage import gaussian_filter1d

    if deviation <= 0.0:
        return values
    smooth: Floats = gaussian_filter1d(values, deviation, axis=0, mode="nearest")
    return smooth


def _evenly(positions: Floats, spacing: float) -> Floats:
    """Points at equal distances along a polyline."""
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return _sampled(positions, np.concatenate([[0.0], np.cumsum(lengths)]), spacing)


def _in_steps(positions: Floats, fine: float, step_m: float) -> Floats:
    """Points of a fine polyline at equal times; a step is shorter where the walker is slow."""
    return _sampled(positions, _times(positions, fine), step_m)


def _times(positions: Floats, fine: float) -> Floats:
    """When the walker is at each point of a fine polyline, as the way at full speed."""
    lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    times: Floats = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, fine))])
    return times


def _sampled(positions: Floats, times: Floats, spacing: float) -> Floats:
    at = np.arange(0.0, times[-1] + 1e-9, spacing)
    return np.stack([np.interp(at, times, column) for column in positions.T], axis=1)
