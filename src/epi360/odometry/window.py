# SPDX-License-Identifier: BSD-3-Clause
"""Poses and points that agree best with all bearings at once: bundle adjustment on the sphere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360 import _core
from epi360.epipolar.arguments import bearings_array, direction_array, weights_array
from epi360.odometry.window_reference import Problem, points_in_cameras
from epi360.poses import Pose

Array = NDArray[np.float64]

LOSSES = ("squared", "huber", "cauchy")


@dataclass
class WindowProblem:
    """Frames, points and what each frame saw of them.

    Attributes
    ----------
    rotations, translations : ndarray, shape (F, 3, 3) and (F, 3)
        Of ``cam_from_world``. A frame with NaN has no observations, and stays NaN.
    points : ndarray, shape (P, 3)
        In the world. A point with NaN has no observations, and stays NaN.
    frame_index, point_index : ndarray, shape (M,)
        Which frame saw which point.
    bearings : ndarray, shape (M, 3)
        Where it saw it; rows with NaN are missing.
    noise_rad : float
        Standard deviation of a bearing in radians, per axis.
    fixed : ndarray, shape (F,)
        Frames that hold the world in its place: at least one. With two of them that stand apart
        the scale is held too; otherwise the distance from the first of them to the frame that is
        farthest from it is kept.
    weights : ndarray, shape (M,), optional
        Multiply the losses.
    gravity : ndarray, shape (F, 3), optional
        Direction of ``world_gravity`` in each camera; NaN where it is not known.
    gravity_sigma_rad : float
        Its standard deviation in radians, per axis.
    world_gravity : ndarray, shape (3,)
        Direction of gravity in the world.
    """

    rotations: Array
    translations: Array
    points: Array
    frame_index: ArrayLike
    point_index: ArrayLike
    bearings: Array
    noise_rad: float
    fixed: ArrayLike
    weights: ArrayLike | None = None
    gravity: ArrayLike | None = None
    gravity_sigma_rad: float = 0.02
    world_gravity: ArrayLike = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class WindowResult:
    """Adjusted frames and points.

    Attributes
    ----------
    rotations, translations : ndarray, shape (F, 3, 3) and (F, 3)
        Of ``cam_from_world``.
    points : ndarray, shape (P, 3)
        In the world; points that fewer than two frames see are where they were.
    residuals_rad : ndarray, shape (M,)
        Angle between each bearing and the direction to its point, up to pi; NaN where either is
        missing.
    cost : float
        Sum of the losses of residuals in units of the noise, and of the gravity's.
    num_iterations : int
        Steps tried.
    converged : bool
        Whether a step no longer lowered the cost, rather than the iterations ran out.
    """

    rotations: Array
    translations: Array
    points: Array
    residuals_rad: Array
    cost: float
    num_iterations: int
    converged: bool

    @property
    def cam_from_world(self) -> list[Pose]:
        """Poses of all frames."""
        pairs = zip(self.rotations, self.translations, strict=True)
        return [Pose(rotation, translation) for rotation, translation in pairs]


def adjust_window(
    problem: WindowProblem,
    *,
    loss: str = "cauchy",
    loss_scale: float = 2.0,
    max_iterations: int = 20,
    tolerance: float = 1e-6,
    points_fixed: bool = False,
) -> WindowResult:
    """Return the poses and points of least robust angular error.

    Parameters
    ----------
    problem : WindowProblem
        Start and observations. Points that fewer than two frames see are ignored, unless
        ``points_fixed``.
    loss : str
        "cauchy", "huber" or "squared".
    loss_scale : float
        Scale of the loss in units of the noise.
    max_iterations : int
        Limit of the steps of Levenberg-Marquardt.
    tolerance : float
        Relative decrease of the cost below which the iteration has converged.
    points_fixed : bool
        Whether only the poses move.

    Raises
    ------
    ValueError
        If a shape, an index or a name is wrong, a number is infinite, or no frame is fixed.
    """
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    if not loss_scale > 0.0:
        raise ValueError(f"loss_scale must be positive, got {loss_scale}")
    checked, used = _checked(problem, points_fixed)
    start = _observations(checked, used)
    rotations, translations, points, cost, num_iterations, converged = _core.adjust_window(
        start.rotations, start.translations, start.points, start.free,
        start.frame_index.astype(np.uint32), start.point_index.astype(np.uint32), start.bearings,
        start.weights, gravity=start.gravity, world_gravity=start.world_gravity,
        gravity_weights=start.gravity_weights / start.noise**2, noise=start.noise,
        loss=loss, loss_scale=loss_scale, max_iterations=max_iterations, tolerance=tolerance,
        points_free=start.points_free,
    )  # fmt: skip
    found = replace(
        checked,
        rotations=np.where(
            np.isnan(checked.rotations), np.nan, rotations.reshape(checked.rotations.shape)
        ),
        translations=np.where(np.isnan(checked.translations), np.nan, translations.reshape(-1, 3)),
        points=np.where(np.isnan(checked.points), np.nan, points.reshape(-1, 3)),
    )
    found = _with_held_scale(found, checked, points_fixed)
    return WindowResult(
        found.rotations,
        found.translations,
        found.points,
        _angles(found),
        cost,
        num_iterations,
        converged,
    )


def _checked(problem: WindowProblem, points_fixed: bool) -> tuple[Problem, NDArray[np.bool_]]:
    """Return the problem as arrays, and which observations count."""
    rotations = _array(problem.rotations, (-1, 3, 3), "rotations")
    F = len(rotations)
    translations = _array(problem.translations, (F, 3), "translations")
    points = _array(problem.points, (-1, 3), "points")
    bearings = bearings_array(problem.bearings, "bearings")
    M = len(bearings)
    frames = _indices(problem.frame_index, M, F, "frame_index")
    tracks = _indices(problem.point_index, M, len(points), "point_index")
    weights = weights_array(problem.weights, M)
    fixed = np.asarray(problem.fixed, dtype=bool)
    if fixed.shape != (F,):
        raise ValueError(f"fixed must have shape ({F},), got {fixed.shape}")
    if not fixed.any():
        raise ValueError("at least one frame must be fixed, or nothing holds the world in place")
    for name in ("noise_rad", "gravity_sigma_rad"):
        if not (np.isfinite(getattr(problem, name)) and getattr(problem, name) > 0.0):
            raise ValueError(f"{name} must be positive, got {getattr(problem, name)}")
    gravity, levels = _gravity(problem, F)
    checked = Problem(
        rotations, translations, points, frames, tracks, bearings,
        np.ones(M) if weights is None else weights, float(problem.noise_rad), ~fixed,
        not points_fixed, levels, gravity, direction_array(problem.world_gravity, "world_gravity"),
    )  # fmt: skip
    used = np.isfinite(points_in_cameras(checked)).all(axis=1) & np.isfinite(bearings[:, 0])
    if not points_fixed:
        used &= _num_frames(checked, used)[tracks] > 1
    return checked, used


def _num_frames(problem: Problem, used: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return how many different frames see each point."""
    pairs = problem.point_index[used] * len(problem.rotations) + problem.frame_index[used]
    points = np.unique(pairs) // len(problem.rotations)
    return np.bincount(points, minlength=len(problem.points))


def _observations(problem: Problem, used: NDArray[np.bool_]) -> Problem:
    """Return the problem with the observations that count, by point and frame, and no NaN."""
    order = np.flatnonzero(used)
    order = order[np.lexsort((problem.frame_index[order], problem.point_index[order]))]
    lost = np.asarray(np.isnan(_centers(problem)).any(axis=1))
    return replace(
        problem,
        rotations=np.where(lost[:, None, None], np.eye(3), problem.rotations),
        translations=np.where(lost[:, None], 0.0, problem.translations),
        points=np.nan_to_num(problem.points),
        frame_index=problem.frame_index[order],
        point_index=problem.point_index[order],
        bearings=problem.bearings[order],
        weights=problem.weights[order],
        free=problem.free & ~lost,
        gravity_weights=np.where(lost, 0.0, problem.gravity_weights),
    )


def _with_held_scale(found: Problem, start: Problem, points_fixed: bool) -> Problem:
    """Return the world scaled about the only fixed frame, so that its size is what it was.

    Scale is free then: the cost does not depend on it.
    """
    before, after = _centers(start), _centers(found)
    present = np.isfinite(before).all(axis=1)
    held = np.flatnonzero(~start.free & present)
    if points_fixed or len(held) == 0:
        return found
    origin = before[held[0]]
    distances = np.where(present, np.linalg.norm(before - origin, axis=1), 0.0)
    if distances[held].max() > 0.0 or not distances.max() > 0.0:
        return found
    far = int(distances.argmax())
    size = float(np.linalg.norm(after[far] - origin))
    if not size > 0.0:
        return found
    scale = distances[far] / size
    centers = origin + scale * (after - origin)
    shifted = -np.einsum("fij,fj->fi", found.rotations, centers)
    return replace(
        found,
        translations=np.where(start.free[:, None], shifted, found.translations),
        points=origin + scale * (found.points - origin),
    )


def _centers(problem: Problem) -> Array:
    return np.asarray(-np.einsum("fji,fj->fi", problem.rotations, problem.translations))


def _angles(problem: Problem) -> Array:
    x = points_in_cameras(problem)
    across = np.linalg.norm(np.cross(problem.bearings, x), axis=1)
    return np.asarray(np.arctan2(across, np.einsum("mi,mi->m", problem.bearings, x)))


def _gravity(problem: WindowProblem, num_frames: int) -> tuple[Array, Array]:
    """Return unit directions without NaN, and their weights in units of the noise's variance."""
    if problem.gravity is None:
        return np.tile([0.0, 1.0, 0.0], (num_frames, 1)), np.zeros(num_frames)
    gravity = bearings_array(problem.gravity, "gravity")
    if len(gravity) != num_frames:
        raise ValueError(f"gravity must have shape ({num_frames}, 3), got {gravity.shape}")
    known = np.asarray(np.isfinite(gravity).all(axis=1))
    weight = (problem.noise_rad / problem.gravity_sigma_rad) ** 2
    return np.where(known[:, None], gravity, [0.0, 1.0, 0.0]), np.where(known, weight, 0.0)


def _array(values: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != len(shape) or any(
        want not in (-1, got) for want, got in zip(shape, array.shape, strict=True)
    ):
        expected = ", ".join("N" if length < 0 else str(length) for length in shape)
        raise ValueError(f"{name} must have shape ({expected}), got {array.shape}")
    if np.isinf(array).any():
        raise ValueError(f"{name} must be finite (NaN marks what is missing)")
    return array


def _indices(values: ArrayLike, length: int, bound: int, name: str) -> NDArray[np.int64]:
    array = np.asarray(values)
    if array.shape != (length,):
        raise ValueError(f"{name} must have shape ({length},), got {array.shape}")
    if array.size and (array.dtype.kind not in "iu" or array.min() < 0 or array.max() >= bound):
        raise ValueError(f"{name} must hold whole numbers from 0 to {bound - 1}")
    return np.ascontiguousarray(array, dtype=np.int64)
