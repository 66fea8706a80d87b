# SPDX-License-Identifier: BSD-3-Clause
"""Bundle adjustment on the sphere in plain NumPy: the readable twin of the native core.

A residual is the direction to a point in the tangent plane of the measured bearing (the logarithm
map of the sphere), so its length is the angle between the two. All is in units of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.poses import rotation_from_vector

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-9, 1e8
FLOOR = 1e-10  # share of a block's own size that is added to its diagonal: no block is singular
LARGEST_STRETCH = 10.0  # a step may bring a point so many times nearer or farther


@dataclass(frozen=True)
class Problem:
    """What is adjusted: checked arrays without NaN, observations with their weights."""

    rotations: Array  # (F, 3, 3)
    translations: Array  # (F, 3)
    points: Array  # (P, 3)
    frame_index: Indices  # (M,)
    point_index: Indices  # (M,)
    bearings: Array  # (M, 3)
    weights: Array  # (M,)
    noise: float  # radians
    free: NDArray[np.bool_]  # (F,)
    points_free: bool
    gravity_weights: Array  # (F,) one over the variance in units of the noise's; 0: unknown
    gravity: Array  # (F, 3)
    world_gravity: Array  # (3,)


def tangent_bases(directions: Array) -> Array:
    """Return two unit tangents (N, 3, 2) at each unit direction (N, 3)."""
    rows = np.arange(len(directions))
    axis = np.abs(directions).argmin(axis=1)
    first = np.eye(3)[axis] - directions[rows, axis, None] * directions
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(directions, first)], axis=2)


def bearing_residuals(bearings: Array, points_in_camera: Array) -> tuple[Array, Array]:
    """Return the residuals (N, 2) of points against unit bearings and their derivatives (N, 2, 3).

    The derivatives are by the point in the camera's frame. They are zero more than 90 degrees
    away: such an observation counts, but pulls at nothing.
    """
    distances = np.maximum(np.linalg.norm(points_in_camera, axis=1), 1e-300)
    u = points_in_camera / distances[:, None]
    bases = tangent_bases(bearings)
    cosines = np.einsum("ni,ni->n", bearings, u)
    sines = np.linalg.norm(cosines[:, None] * u - bearings, axis=1)
    angles = np.arctan2(sines, cosines)
    small = sines < 1e-4
    safe = np.where(small, 1.0, sines)
    # The residual is stretch * p with p = B^T u; slope is what its derivative has along p.
    stretch = np.where(small, 1 + sines**2 / 6, angles / safe)
    slope = np.where(small, -2 / 3 - sines**2 / 5, (cosines - stretch) / safe**2)
    p = np.einsum("nij,ni->nj", bases, u)
    inner = slope[:, None] * np.einsum("nij,nj->ni", bases, p) - bearings
    by_direction = (
        stretch[:, None, None] * np.swapaxes(bases, 1, 2) + p[:, :, None] * inner[:, None]
    )
    across_ray = (np.eye(3) - u[:, :, None] * u[:, None, :]) / distances[:, None, None]
    jacobians = by_direction @ across_ray
    jacobians[cosines <= 0] = 0.0
    residuals = stretch[:, None] * p
    residuals[small & (cosines < 0)] = (np.pi, 0.0)  # right behind: any direction
    return residuals, jacobians


def loss_values(squares: Array, loss: str, scale: float) -> tuple[Array, Array]:
    """Return cost and weight (its derivative) of squared residuals."""
    if loss == "cauchy":
        return scale**2 * np.log1p(squares / scale**2), 1 / (1 + squares / scale**2)
    if loss == "squared":
        return squares, np.ones_like(squares)
    lengths = np.sqrt(np.maximum(squares, scale**2))
    inside = squares <= scale**2
    return np.where(inside, squares, 2 * scale * lengths - scale**2), scale / lengths


def points_in_cameras(problem: Problem) -> Array:
    """Return each observation's point in the frame of its camera (M, 3)."""
    turned = np.einsum(
        "mij,mj->mi", problem.rotations[problem.frame_index], problem.points[problem.point_index]
    )
    return np.asarray(turned + problem.translations[problem.frame_index])


def cost_of(problem: Problem, loss: str, scale: float) -> float:
    """Return the sum of all losses in units of the noise's variance."""
    residuals, _ = bearing_residuals(problem.bearings, points_in_cameras(problem))
    squares = np.einsum("mi,mi->m", residuals, residuals) / problem.noise**2
    down, _ = bearing_residuals(problem.gravity, problem.rotations @ problem.world_gravity)
    level = problem.gravity_weights @ np.einsum("fi,fi->f", down, down) / problem.noise**2
    return float(problem.weights @ loss_values(squares, loss, scale)[0] + level)


def normal_equations(problem: Problem, loss: str, scale: float) -> tuple[Array, Array]:
    """Return J^T W J and J^T W r by all poses (six each: w, d), then all points (three each).

    A pose moves to R' = exp([w]x) R, t' = exp([w]x) t + d: about the camera's own centre.
    """
    F, P = len(problem.rotations), len(problem.points)
    x = points_in_cameras(problem)
    residuals, by_x = bearing_residuals(problem.bearings, x)
    squares = np.einsum("mi,mi->m", residuals, residuals) / problem.noise**2
    weights = problem.weights * loss_values(squares, loss, scale)[1] / problem.noise**2
    H, g = np.zeros((6 * F + 3 * P,) * 2), np.zeros(6 * F + 3 * P)
    J = np.concatenate([_by_pose(by_x, x), by_x @ problem.rotations[problem.frame_index]], axis=2)
    poses = 6 * problem.frame_index[:, None] + np.arange(6)
    points = 6 * F + 3 * problem.point_index[:, None] + np.arange(3)
    at = np.concatenate([poses, points], axis=1)
    blocks = np.einsum("m,mki,mkj->mij", weights, J, J)
    np.add.at(H, (at[:, :, None], at[:, None, :]), blocks)
    np.add.at(g, at, np.einsum("m,mki,mk->mi", weights, J, residuals))
    down = problem.rotations @ problem.world_gravity
    residuals, by_x = bearing_residuals(problem.gravity, down)
    J = _by_pose(by_x, down)[:, :, :3]
    for f, weight in enumerate(problem.gravity_weights / problem.noise**2):
        at_turn = slice(6 * f, 6 * f + 3)
        H[at_turn, at_turn] += weight * J[f].T @ J[f]
        g[at_turn] += weight * J[f].T @ residuals[f]
    return H, g


def adjust_reference(
    problem: Problem, loss: str, scale: float, max_iterations: int, tolerance: float
) -> tuple[Problem, float, int, bool]:
    """Return the adjusted problem, its cost, the iterations and whether they converged."""
    cost, damping = cost_of(problem, loss, scale), FIRST_DAMPING
    for iteration in range(max_iterations):
        H, g = normal_equations(problem, loss, scale)
        decrease = 0.0
        while damping < MOST_DAMPING:
            trial = _moved(problem, _step(problem, H, g, damping))
            trial_cost = cost_of(trial, loss, scale)
            if trial_cost < cost:
                decrease = cost - trial_cost
                problem, cost = trial, trial_cost
                damping = max(0.1 * damping, LEAST_DAMPING)
                break
            damping *= 10.0
        if decrease <= tolerance * cost:
            return problem, cost, iteration + 1, True
    return problem, cost, max_iterations, False


def _step(problem: Problem, H: Array, g: Array, damping: float) -> Array:
    """Return -(H + damping * its blocks on the diagonal)^-1 g, zero for all that is held."""
    F = len(problem.rotations)
    damped = H.copy()
    for start, size in [(6 * f, 6) for f in range(F)] + [(k, 3) for k in range(6 * F, len(g), 3)]:
        block = slice(start, start + size)
        own = H[block, block]
        floor = np.diag(own) if size == 6 else np.full(3, np.trace(own))
        damped[block, block] += damping * own + np.diag(FLOOR * floor)
    points_free = np.full(len(g) - 6 * F, problem.points_free)
    moving = np.r_[np.repeat(problem.free, 6), points_free] & (np.diag(H) > 0)
    step = np.zeros(len(g))
    step[moving] = -np.linalg.solve(damped[np.ix_(moving, moving)], g[moving])
    return step


def _moved(problem: Problem, step: Array) -> Problem:
    F = len(problem.rotations)
    poses, shifts = step[: 6 * F].reshape(F, 6), step[6 * F :].reshape(-1, 3)
    turns = np.array([rotation_from_vector(w) for w in poses[:, :3]]).reshape(F, 3, 3)
    centers = -np.einsum("fji,fj->fi", problem.rotations, problem.translations)
    points = problem.points.copy()
    for p in np.unique(problem.point_index) if problem.points_free else []:
        seen_by = np.unique(problem.frame_index[(problem.point_index == p) & (problem.weights > 0)])
        if len(seen_by):
            points[p] = _stretched(points[p], centers[seen_by], shifts[p])
    return replace(
        problem,
        rotations=turns @ problem.rotations,
        translations=np.einsum("fij,fj->fi", turns, problem.translations) + poses[:, 3:],
        points=points,
    )


def _stretched(point: Array, centers: Array, shift: Array) -> Array:
    """Return the point after a step in direction and inverse distance from the nearest camera.

    It agrees with point + shift to first order, and takes a point to infinity in few steps, where
    residuals are linear in the inverse distance and not in the distance.
    """
    rays = point - centers
    ray = rays[np.linalg.norm(rays, axis=1).argmin()]
    square = ray @ ray
    if square == 0.0:
        return np.asarray(point + shift)
    along = ray @ shift / square
    stretch = 1 / np.clip(1 - along, 1 / LARGEST_STRETCH, LARGEST_STRETCH)
    return np.asarray(point - ray + stretch * (ray + shift - along * ray))


def _by_pose(by_x: Array, x: Array) -> Array:
    """Return derivatives (N, 2, 6) by (w, d) from those by the point x in the camera's frame."""
    return np.concatenate([np.cross(x[:, None], by_x), by_x], axis=2)
