# SPDX-License-Identifier: BSD-3-Clause
"""Non-linear refinement of a pose over SO(3) x S^2 (the gold standard of paper section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360 import _core
from epi360.epipolar.arguments import bearing_pair, jacobians_array, weights_array
from epi360.epipolar.residuals import (
    RESIDUALS,
    pose_residuals,
    residual_jacobians,
    tangent_basis,
)
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]

LOSSES = ("squared", "huber", "cauchy", "geman_mcclure", "mixture")
# In standard deviations: nearly as efficient as least squares on Gaussian noise (Huber 1981; Zhang,
# "Parameter estimation techniques", 1997; the last by measurement).
_TUNING = {"huber": 1.345, "cauchy": 2.385, "geman_mcclure": 3.0}


@dataclass(frozen=True)
class RefinementResult:
    """A refined pose.

    Attributes
    ----------
    pose : Pose
        cam2_from_cam1 with unit translation.
    residuals : ndarray, shape (N,)
        Signed, at the refined pose; NaN for missing rows.
    cost : float
        Sum of the loss; for the mixture -2 scale^2 times the log-likelihood.
    covariance : ndarray, shape (5, 5)
        Radians squared, parameters as in ``RelativePoseResult``: the inverse normal equations
        times the residual variance, for robust losses the M-estimator's sandwich. The scale of
        the weights does not matter.
    scale : float
        Scale of the loss; for the mixture the estimated standard deviation of the inliers.
    num_iterations : int
        Iterations of Levenberg-Marquardt.
    converged : bool
        Whether no further step lowered the cost.
    """

    pose: Pose
    residuals: Array
    cost: float
    covariance: Array
    scale: float
    num_iterations: int
    converged: bool


def refine_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    cam2_from_cam1: Pose,
    residual: str = "angular",
    loss: str = "squared",
    weights: ArrayLike | None = None,
    *,
    scale: float | None = None,
    jacobians1: ArrayLike | None = None,
    jacobians2: ArrayLike | None = None,
    max_iterations: int = 100,
) -> RefinementResult:
    """Return the pose of least robust cost near a starting pose.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        Matches; rows with NaN are left out.
    cam2_from_cam1 : Pose
        Where the search starts; its translation needs a direction, not a length.
    residual : str
        "paper" (eq. 13), "angular", "sampson" or "tangent_sampson" (needs the Jacobians).
    loss : str
        "squared", "huber", "cauchy", "geman_mcclure", or "mixture" (maximum likelihood of
        Gaussian inliers, near misses and uniform outliers, whose scale and shares are estimated).
    weights : array_like, shape (N,), optional
        Multiply each match's loss.
    scale : float, optional
        Of the robust losses, in the residual's unit; by default 1.345 (huber), 2.385 (cauchy) or 3
        (geman_mcclure) times the standard deviation that the median absolute residual at the start
        stands for.
    jacobians1, jacobians2 : array_like, shape (N, 3, 2), optional
        Camera Jacobians for "tangent_sampson".
    max_iterations : int
        Limit of Levenberg-Marquardt iterations.

    Returns
    -------
    result : RefinementResult
        The pose and what goes with it.

    Raises
    ------
    ValueError
        If an array has a wrong shape, a name is unknown, fewer than five matches are usable or the
        starting pose has no direction.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    usable = np.asarray(np.isfinite(b1).all(axis=1) & np.isfinite(b2).all(axis=1))
    start = _checked_start(cam2_from_cam1, residual, loss, int(usable.sum()))
    w = weights_array(weights, len(b1))
    J1 = jacobians_array(jacobians1, len(b1), "jacobians1")
    J2 = jacobians_array(jacobians2, len(b1), "jacobians2")
    if residual == "tangent_sampson" and (J1 is None or J2 is None):
        raise ValueError("residual tangent_sampson needs jacobians1 and jacobians2")
    if scale is None:
        scale = _default_scale(start, b1[usable], b2[usable], residual, loss)
    R, t, found, cost, information, squares, _, scale, iterations, converged = _core.refine(
        b1[usable],
        b2[usable],
        start.rotation,
        start.translation,
        residual=residual,
        loss=loss,
        scale=float(scale),
        weights=_of(w, usable),
        jacobians1=_of(J1, usable),
        jacobians2=_of(J2, usable),
        max_iterations=max_iterations,
    )
    residuals = np.full(len(b1), np.nan)
    residuals[usable] = found
    pose = Pose(R, t)
    if loss in ("squared", "mixture"):
        num_matches = int(usable.sum()) if w is None else int((w[usable] > 0.0).sum())
        variance = scale**2 if loss == "mixture" else squares / max(num_matches - 5, 1)
        covariance = variance * _inverse(information)
    else:
        _, J = _core.residuals(
            b1[usable], b2[usable], R, t, residual, _of(J1, usable), _of(J2, usable)
        )
        covariance = _sandwich(J, found, _of(w, usable), loss, scale)
    return RefinementResult(pose, residuals, cost, covariance, scale, iterations, bool(converged))


def refine_pose_reference(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    cam2_from_cam1: Pose,
    residual: str = "angular",
    loss: str = "squared",
    weights: ArrayLike | None = None,
    *,
    scale: float = 1.0,
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
        "paper", "angular" or "sampson".
    loss : str
        "squared", "huber", "cauchy" or "geman_mcclure".
    weights : array_like, shape (N,), optional
        Multiply each match's loss.
    scale : float
        Of the robust losses.
    max_iterations : int
        Limit of iterations.

    Raises
    ------
    ValueError
        If a name is unknown.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    w = np.ones(len(b1)) if weights is None else np.asarray(weights, dtype=np.float64)
    t = cam2_from_cam1.translation
    pose = Pose(cam2_from_cam1.rotation, t / np.linalg.norm(t))
    residuals = pose_residuals(pose, b1, b2, residual)
    cost = float(w @ _loss(residuals**2, loss, scale)[0])
    damping = 1e-4
    for _ in range(max_iterations):
        J = residual_jacobians(pose, b1, b2, residual)
        irls = w * _loss(residuals**2, loss, scale)[1]
        hessian, gradient = (J.T * irls) @ J, J.T @ (irls * residuals)
        damped = hessian + damping * np.diag(np.diag(hessian))
        step = np.asarray(np.linalg.solve(damped, -gradient), dtype=np.float64)
        if np.linalg.norm(step) < 1e-10:
            break
        candidate = _moved(pose, step)
        candidate_residuals = pose_residuals(candidate, b1, b2, residual)
        candidate_cost = float(w @ _loss(candidate_residuals**2, loss, scale)[0])
        if candidate_cost < cost:
            pose, residuals, cost = candidate, candidate_residuals, candidate_cost
            damping = max(damping * 0.1, 1e-9)
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return pose, cost


def _checked_start(pose: Pose, residual: str, loss: str, num_usable: int) -> Pose:
    if residual not in RESIDUALS:
        raise ValueError(f"residual must be one of {', '.join(RESIDUALS)}, got {residual!r}")
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    if num_usable < 5:
        raise ValueError(f"refinement needs at least 5 usable matches, got {num_usable}")
    norm = float(np.linalg.norm(pose.translation))
    if not norm > 0.0 or not np.isfinite(pose.rotation).all():
        raise ValueError("cam2_from_cam1 must be finite with a non-zero translation to start from")
    return Pose(pose.rotation, pose.translation / norm)


def _default_scale(pose: Pose, b1: Array, b2: Array, residual: str, loss: str) -> float:
    if loss in ("squared", "mixture"):
        return 0.0 if loss == "mixture" else 1.0
    kind = "sampson" if residual == "tangent_sampson" else residual
    deviation = 1.4826 * float(np.median(np.abs(pose_residuals(pose, b1, b2, kind))))
    return max(_TUNING[loss] * deviation, 1e-9)


def _of(array: Array | None, chosen: NDArray[np.bool_]) -> Array | None:
    return None if array is None else array[chosen]


def _inverse(matrix: Array) -> Array:
    try:
        return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:  # the matches do not determine the pose
        return np.full((5, 5), np.nan)


def _sandwich(J: Array, residuals: Array, weights: Array | None, loss: str, scale: float) -> Array:
    """Covariance of an M-estimator (Huber 1981): H^-1 (sum psi^2 J^T J) H^-1 with psi' in H."""
    u = (residuals / scale) ** 2
    psi = residuals * _loss(residuals**2, loss, scale)[1]
    slopes = {
        "huber": (u <= 1.0).astype(np.float64),
        "cauchy": (1.0 - u) / (1.0 + u) ** 2,
        "geman_mcclure": (1.0 - 3.0 * u) / (1.0 + u) ** 3,
    }
    w = np.ones(len(psi)) if weights is None else weights
    bread = _inverse((J.T * (w * slopes[loss])) @ J)
    return np.asarray(bread @ ((J.T * (w * psi) ** 2) @ J) @ bread)


def _moved(pose: Pose, step: Array) -> Pose:
    t = pose.translation + tangent_basis(pose.translation) @ step[3:]
    return Pose(rotation_from_vector(step[:3]) @ pose.rotation, t / np.linalg.norm(t))


def _loss(squared: Array, loss: str, scale: float) -> tuple[Array, Array]:
    """Cost and weight of squared residuals, as in native/core/loss.h."""
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
