# SPDX-License-Identifier: BSD-3-Clause
"""Levenberg-Marquardt over poses in plain NumPy: the gold standard of paper section 4.3, eq. 15."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair
from epi360.epipolar.essential import skew
from epi360.epipolar.residuals import pose_residuals, residual_jacobians, tangent_basis
from epi360.estimation.weights import check_weight_kind, weight_model
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]
Evaluate = Callable[[Pose], Array]

PARAMETERIZATIONS = ("manifold", "se3")


@dataclass(frozen=True)
class Minimum:
    """Where Levenberg-Marquardt stopped.

    Attributes
    ----------
    pose : Pose
        With unit translation.
    residuals, weights : ndarray, shape (N,)
        There; the weights are those of the loss or of the last reweighting.
    cost : float
        Of the loss, or sum of weight times squared residual.
    num_iterations : int
        Steps tried.
    converged : bool
        Whether it stopped by itself.
    """

    pose: Pose
    residuals: Array
    weights: Array
    cost: float
    num_iterations: int
    converged: bool


def refine_pose_reference(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    cam2_from_cam1: Pose,
    residual: str = "angular",
    loss: str = "squared",
    weights: ArrayLike | None = None,
    *,
    scale: float = 1.0,
    reweight: str | None = None,
    parameterization: str = "manifold",
    max_iterations: int = 100,
) -> tuple[Pose, float]:
    """Return pose and cost of the same refinement in plain NumPy: the twin that tests compare.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        Matches without missing rows.
    cam2_from_cam1 : Pose
        Start.
    residual : str
        "paper", "solarte2021", "angular" or "sampson".
    loss : str
        "squared", "huber", "cauchy" or "geman_mcclure".
    weights : array_like, shape (N,), optional
        Multiply each match's loss.
    scale : float
        Of the robust losses.
    reweight : str, optional
        "gaussian", "student_t" or "mixture": weights from the current residuals at every step.
    parameterization : str
        "manifold" (SO(3) x S^2) or "se3".
    max_iterations : int
        Limit of iterations.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    w = np.ones(len(b1)) if weights is None else np.asarray(weights, dtype=np.float64)
    found = levenberg_marquardt(
        cam2_from_cam1,
        lambda pose: pose_residuals(pose, b1, b2, residual),
        lambda pose: residual_jacobians(pose, b1, b2, residual),
        weighing(w, loss, scale, reweight),
        parameterization,
        max_iterations,
    )
    return found.pose, found.cost


@dataclass(frozen=True)
class Weighing:
    """How residuals become weights and a cost.

    Attributes
    ----------
    weights : callable
        Residuals (N,) to the weights (N,) of the normal equations.
    cost : callable
        Residuals (N,) and those weights to the cost.
    """

    weights: Callable[[Array], Array]
    cost: Callable[[Array, Array], float]


def weighing(w: Array, loss: str, scale: float, reweight: str | None) -> Weighing:
    """Return the weights of a robust loss, or of iterative reweighting, times constant weights.

    Parameters
    ----------
    w : ndarray, shape (N,)
        Constant weights: omega of eq. 15.
    loss : str
        As in `refine_pose_reference`.
    scale : float
        Of the loss.
    reweight : str or None
        Kind of `residual_weights`.

    Raises
    ------
    ValueError
        If a name is unknown or both ways are asked for.
    """
    if reweight is None:
        loss_terms(np.zeros(1), loss, scale)  # refuses an unknown name before any work
        return Weighing(
            lambda e: w * loss_terms(e**2, loss, scale)[1],
            lambda e, _: float(w @ loss_terms(e**2, loss, scale)[0]),
        )
    check_weight_kind(reweight)
    if loss != "squared":
        raise ValueError(
            f"reweight takes the place of a robust loss: use loss='squared', got {loss!r}"
        )
    used = w > 0.0

    def weights(e: Array) -> Array:
        updated = np.zeros_like(e)
        updated[used] = w[used] * weight_model(e[used], reweight).weights
        return updated

    # The weights are held while a step is judged: else it would pay to call all matches outliers.
    return Weighing(weights, lambda e, held: float(held @ e**2))


def levenberg_marquardt(
    start: Pose,
    residuals_at: Evaluate,
    jacobians_at: Evaluate,
    weigh: Weighing,
    parameterization: str = "manifold",
    max_iterations: int = 100,
) -> Minimum:
    """Return the pose of least cost near a start (paper eq. 15).

    Parameters
    ----------
    start : Pose
        With a non-zero translation.
    residuals_at, jacobians_at : callable
        Pose with unit translation to residuals (N,), and to their derivatives (N, 5) by (w, d).
    weigh : Weighing
        Loss, constant weights or reweighting.
    parameterization : str
        "manifold": steps (w, d) of R' = exp([w]x) R, t' = (t + B d) / |.|. "se3": steps
        xi = (w, v) of exp(xi) T, the paper's; the length of t, on which no residual depends, goes
        where it likes, and damping deals with the Jacobian of rank five.
    max_iterations : int
        Limit of steps tried.

    Raises
    ------
    ValueError
        If the parameterization is unknown.
    """
    check_parameterization(parameterization)
    on_se3 = parameterization == "se3"
    pose = start if on_se3 else _unit(start)
    residuals, J = residuals_at(_unit(pose)), jacobians_at(_unit(pose))
    weights = weigh.weights(residuals)
    cost = weigh.cost(residuals, weights)
    damping, converged, iteration = 1e-4, False, 0
    while iteration < max_iterations and not converged:
        iteration += 1
        step = _step(_by_se3(J, pose) if on_se3 else J, residuals, weights, damping)
        if np.linalg.norm(step) < 1e-10:
            converged = True
            break
        candidate = se3_moved(pose, step) if on_se3 else _moved(pose, step)
        candidate_residuals = residuals_at(_unit(candidate))
        if weigh.cost(candidate_residuals, weights) < cost:
            pose, residuals, J = candidate, candidate_residuals, jacobians_at(_unit(candidate))
            weights = weigh.weights(residuals)
            cost = weigh.cost(residuals, weights)
            damping = max(damping * 0.1, 1e-9)
        else:
            damping *= 10.0
            converged = damping > 1e8  # no step lowers the cost
    return Minimum(_unit(pose), residuals, weights, cost, iteration, converged)


def check_parameterization(parameterization: str) -> None:
    """Refuse an unknown parameterization.

    Parameters
    ----------
    parameterization : str
        To be checked.

    Raises
    ------
    ValueError
        With the names that exist.
    """
    if parameterization not in PARAMETERIZATIONS:
        names = " or ".join(PARAMETERIZATIONS)
        raise ValueError(f"parameterization must be {names}, got {parameterization!r}")


def se3_moved(pose: Pose, xi: Array) -> Pose:
    """Return exp(xi) T on SE(3).

    Parameters
    ----------
    pose : Pose
        T.
    xi : ndarray, shape (6,)
        (w, v): rotation vector and the velocity that goes with it.

    Notes
    -----
    exp(w, v) = (exp [w]x, V v), V = I + (1 - cos a) / a^2 [w]x + (a - sin a) / a^3 [w]x^2 with
    a = |w|: Sola, Deray & Atchuthan, "A micro Lie theory", 2018, eq. 172 and 174.
    """
    w, v = xi[:3], xi[3:]
    a2 = float(w @ w)
    a, W = np.sqrt(a2), skew(w)
    if a < 1e-4:  # the series is exact to working precision
        first, second = 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0
    else:
        first, second = (1.0 - np.cos(a)) / a2, (a - np.sin(a)) / (a2 * a)
    turn = rotation_from_vector(w)
    shift = (np.eye(3) + first * W + second * W @ W) @ v
    return Pose(turn @ pose.rotation, turn @ pose.translation + shift)


def _by_se3(J: Array, pose: Pose) -> Array:
    """Derivatives by xi = (w, v) from those by (w, d): d = B^T (w x t + v) / |t|."""
    t = pose.translation
    length = float(np.linalg.norm(t))
    by_t = J[:, 3:] @ tangent_basis(t / length).T / length
    return np.hstack([J[:, :3] - by_t @ skew(t), by_t])


def _step(J: Array, residuals: Array, weights: Array, damping: float) -> Array:
    hessian, gradient = (J.T * weights) @ J, J.T @ (weights * residuals)
    diagonal = np.diag(hessian)
    # The floor matters only where a column of J vanishes: se3 with t along an axis.
    damped = hessian + damping * np.diag(np.maximum(diagonal, 1e-12 * diagonal.max()))
    try:
        return np.asarray(np.linalg.solve(damped, -gradient), dtype=np.float64)
    except np.linalg.LinAlgError:  # nothing left to determine a step
        return np.zeros(len(gradient))


def _moved(pose: Pose, step: Array) -> Pose:
    t = pose.translation + tangent_basis(pose.translation) @ step[3:]
    return Pose(rotation_from_vector(step[:3]) @ pose.rotation, t / np.linalg.norm(t))


def _unit(pose: Pose) -> Pose:
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))


def loss_terms(squared: Array, loss: str, scale: float) -> tuple[Array, Array]:
    """Cost and weight of squared residuals, as in native/core/refinement/loss.h.

    Parameters
    ----------
    squared : ndarray, shape (N,)
        Squared residuals.
    loss : str
        "squared", "huber", "cauchy" or "geman_mcclure".
    scale : float
        Of the loss.

    Raises
    ------
    ValueError
        If the name is unknown.
    """
    c2 = scale**2
    if loss == "squared":
        return squared, np.ones_like(squared)
    if loss == "huber":
        root = np.sqrt(np.maximum(squared, 1e-300))
        inside = squared <= c2
        return np.where(inside, squared, 2.0 * scale * root - c2), np.where(
            inside, 1.0, scale / root
        )
    if loss == "cauchy":
        return c2 * np.log1p(squared / c2), 1.0 / (1.0 + squared / c2)
    if loss == "geman_mcclure":
        d = 1.0 / (1.0 + squared / c2)
        return squared * d, d**2
    raise ValueError(f"loss must be squared, huber, cauchy or geman_mcclure, got {loss!r}")
