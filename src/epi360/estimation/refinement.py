# SPDX-License-Identifier: BSD-3-Clause
"""Non-linear refinement of a pose over SO(3) x S^2 (the gold standard of paper section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import index

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360 import _core
from epi360.epipolar.arguments import (
    bearing_pair,
    jacobians_array,
    unit_of_weights,
    weights_array,
)
from epi360.epipolar.residuals import RESIDUALS, pose_residuals, residual_jacobians
from epi360.estimation.covariance import (
    inverse_information,
    loss_influence,
    reweighting_influence,
    sandwich_covariance,
)
from epi360.estimation.options import number_or_nan
from epi360.estimation.refinement_reference import (
    check_parameterization,
    levenberg_marquardt,
    refine_pose_reference,
    weighing,
)
from epi360.estimation.weights import check_weight_kind, weight_model
from epi360.poses import Pose, checked_pose

__all__ = ["LOSSES", "RefinementResult", "refine_pose", "refine_pose_reference"]

Array = NDArray[np.float64]

LOSSES = ("squared", "huber", "cauchy", "geman_mcclure", "mixture")
# In standard deviations: nearly as efficient as least squares on Gaussian noise (Huber 1981; Zhang,
# "Parameter estimation techniques", 1997; the last by measurement).
_TUNING = {"huber": 1.345, "cauchy": 2.385, "geman_mcclure": 3.0}
_LARGEST_SCALE = 1e30  # of a loss, whose sixth power is a number


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
        Radians squared, parameters as in ``RelativePoseResult`` whatever the parameterization: the
        inverse normal equations times the residual variance, which divides by the number of matches
        of equal weight that say as much, less five; for robust losses and `reweight` the
        M-estimator's sandwich, with the scale of the weights held; for "solarte2021" the sandwich
        too, because its residuals have different variances. The scale of the weights does not
        matter.
    scale : float
        Scale of the loss; for the mixture and for `reweight` the estimated standard deviation (or
        scale) of the inliers' residuals.
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
    reweight: str | None = None,
    parameterization: str = "manifold",
    scale: float | None = None,
    jacobians1: ArrayLike | None = None,
    jacobians2: ArrayLike | None = None,
    max_iterations: int = 100,
) -> RefinementResult:
    """Return the pose of least robust cost near a starting pose.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        Matches; rows with NaN (also in the Jacobians) are left out.
    cam2_from_cam1 : Pose
        Where the search starts; its translation needs a direction, not a length.
    residual : str
        "paper" (eq. 13), "solarte2021" (the authors' code, see `solarte2021_residuals`),
        "angular", "sampson" or "tangent_sampson" (needs the Jacobians).
    loss : str
        "squared", "huber", "cauchy", "geman_mcclure", or "mixture" (maximum likelihood of
        Gaussian inliers, near misses and uniform outliers, whose scale and shares are estimated).
    weights : array_like, shape (N,), optional
        Multiply each match's loss: the constant omega of paper eq. 15.
    reweight : str, optional
        "gaussian", "student_t" or "mixture": before each step every match gets the
        `residual_weights` of the current residuals (the paper's IRLS), times `weights`. In place
        of a robust loss.
    parameterization : str
        "manifold": steps over SO(3) x S^2. "se3": the paper's xi in R^6, in which the length of
        the translation is a sixth, idle parameter. Same minimum.
    scale : float, optional
        Scale of the robust losses in the residual's unit; by default 1.345 (huber), 2.385 (cauchy)
        or 3 (geman_mcclure) times the standard deviation that the median absolute residual at the
        start stands for.
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
        If an array has a wrong shape, a name is unknown, fewer than five matches are usable (with a
        positive weight), the starting pose has no direction, a number is out of range or two
        options exclude each other, or the start is no pose.

    Notes
    -----
    "solarte2021", `reweight` and "se3" run in NumPy, everything else in the compiled core.
    """
    _check_names(residual, loss, reweight, parameterization)
    b1, b2 = bearing_pair(bearings1, bearings2)
    w = weights_array(weights, len(b1))
    J1 = jacobians_array(jacobians1, len(b1), "jacobians1")
    J2 = jacobians_array(jacobians2, len(b1), "jacobians2")
    if residual == "tangent_sampson" and (J1 is None or J2 is None):
        raise ValueError("residual tangent_sampson needs jacobians1 and jacobians2")
    usable = np.asarray(np.isfinite(b1).all(axis=1) & np.isfinite(b2).all(axis=1))
    for J in (J1, J2):
        if J is not None and residual == "tangent_sampson":
            usable &= np.isfinite(J).all(axis=(1, 2))
    counted = usable if w is None else usable & (w > 0.0)
    start = _checked_start(cam2_from_cam1, int(counted.sum()))
    _check_numbers(scale, max_iterations)
    matches = _Matches(
        b1[usable], b2[usable], _of(w, usable), _of(J1, usable), _of(J2, usable), residual
    )
    if scale is None:
        scale = _default_scale(start, matches, loss)
    if reweight is not None or parameterization == "se3" or residual == "solarte2021":
        found = _refined_in_numpy(
            matches, start, loss, scale, reweight, parameterization, max_iterations
        )
    else:
        found = _refined_natively(matches, start, loss, scale, max_iterations)
    residuals = np.full(len(b1), np.nan)
    residuals[usable] = found.residuals
    return replace(found, residuals=residuals)


@dataclass(frozen=True)
class _Matches:
    """Matches without missing rows and the residual to judge them by."""

    b1: Array
    b2: Array
    weights: Array | None
    J1: Array | None
    J2: Array | None
    residual: str

    def residuals_at(self, pose: Pose) -> Array:
        return pose_residuals(pose, self.b1, self.b2, self.residual, self.J1, self.J2)

    def jacobians_at(self, pose: Pose) -> Array:
        if self.residual == "solarte2021":
            return residual_jacobians(pose, self.b1, self.b2, self.residual)
        _, J = _core.residuals(
            self.b1, self.b2, pose.rotation, pose.translation, self.residual, self.J1, self.J2
        )
        return J

    def constant_weights(self) -> Array:
        return np.ones(len(self.b1)) if self.weights is None else self.weights


def _refined_natively(
    matches: _Matches, start: Pose, loss: str, scale: float, max_iterations: int
) -> RefinementResult:
    weights, unit = matches.weights, 1.0
    if weights is not None:
        unit = unit_of_weights(weights)
        weights = weights / unit
    R, t, residuals, cost, information, squares, _, scale, iterations, converged = _core.refine(
        matches.b1,
        matches.b2,
        start.rotation,
        start.translation,
        residual=matches.residual,
        loss=loss,
        scale=float(scale),
        weights=weights,
        jacobians1=matches.J1,
        jacobians2=matches.J2,
        max_iterations=max_iterations,
    )
    pose = Pose(R, t)
    w = np.ones(len(matches.b1)) if weights is None else weights
    if loss in ("squared", "mixture"):
        variance = scale**2 if loss == "mixture" else _variance(squares, w)
        covariance = variance * inverse_information(information)
    else:
        influence = loss_influence(residuals, loss, scale)
        covariance = sandwich_covariance(matches.jacobians_at(pose), w, influence)
    cost *= unit
    return RefinementResult(pose, residuals, cost, covariance, scale, iterations, bool(converged))


def _refined_in_numpy(
    matches: _Matches,
    start: Pose,
    loss: str,
    scale: float,
    reweight: str | None,
    parameterization: str,
    max_iterations: int,
) -> RefinementResult:
    w = matches.constant_weights()
    found = levenberg_marquardt(
        start,
        matches.residuals_at,
        matches.jacobians_at,
        weighing(w, loss, scale, reweight),
        parameterization,
        max_iterations,
    )
    J, e = matches.jacobians_at(found.pose), found.residuals
    if reweight is not None:
        model = weight_model(e[w > 0.0], reweight)
        scale = model.scale
        covariance = sandwich_covariance(J, w, reweighting_influence(e, w > 0.0, model))
    elif loss == "squared" and matches.residual != "solarte2021":
        covariance = _variance(float(w @ e**2), w) * inverse_information((J.T * w) @ J)
    else:
        covariance = sandwich_covariance(J, w, loss_influence(e, loss, scale))
    return RefinementResult(
        found.pose, e, found.cost, covariance, scale, found.num_iterations, found.converged
    )


def _variance(weighted_squares: float, weights: Array) -> float:
    # As many matches of equal weight say as much (Kish 1965); five of them fix the pose.
    num_effective = float(weights.sum()) / unit_of_weights(weights)
    return weighted_squares / max(num_effective - 5.0, 1.0)


def _check_names(residual: str, loss: str, reweight: str | None, parameterization: str) -> None:
    residuals = (*RESIDUALS, "solarte2021")
    if residual not in residuals:
        raise ValueError(f"residual must be one of {', '.join(residuals)}, got {residual!r}")
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    check_parameterization(parameterization)
    if reweight is not None:
        check_weight_kind(reweight)
        if loss != "squared":
            raise ValueError(
                f"reweight takes the place of a robust loss: use loss='squared', got {loss!r}"
            )
    if loss == "mixture" and (parameterization == "se3" or residual == "solarte2021"):
        raise ValueError(
            "loss mixture goes with parameterization='manifold' and without residual solarte2021; "
            "use reweight='mixture'"
        )


def _check_numbers(scale: float | None, max_iterations: int) -> None:
    if scale is not None and not 1.0 / _LARGEST_SCALE <= number_or_nan(scale) <= _LARGEST_SCALE:
        raise ValueError(
            f"scale must be a positive number from {1.0 / _LARGEST_SCALE:g} to "
            f"{_LARGEST_SCALE:g}, got {scale!r}"
        )
    try:
        is_usable = 0 <= index(max_iterations) < 2**31
    except TypeError:
        is_usable = False
    if not is_usable:
        raise ValueError(f"max_iterations must be an integer, 0 or more, got {max_iterations!r}")


def _checked_start(pose: Pose, num_usable: int) -> Pose:
    if num_usable < 5:
        raise ValueError(f"refinement needs at least 5 usable matches, got {num_usable}")
    t = checked_pose(pose).translation
    largest = float(np.abs(t).max())
    if not largest > 0.0 or not np.isfinite(pose.rotation).all():
        raise ValueError("cam2_from_cam1 must be finite with a non-zero translation to start from")
    t = t / largest  # so that squares neither overflow nor vanish
    return Pose(pose.rotation, t / np.linalg.norm(t))


def _default_scale(start: Pose, matches: _Matches, loss: str) -> float:
    if loss in ("squared", "mixture"):
        return 0.0 if loss == "mixture" else 1.0
    deviation = 1.4826 * float(np.median(np.abs(matches.residuals_at(start))))
    return max(_TUNING[loss] * deviation, 1e-9)


def _of(array: Array | None, chosen: NDArray[np.bool_]) -> Array | None:
    return None if array is None else array[chosen]
