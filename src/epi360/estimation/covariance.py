# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of a refined pose in its five parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar.residuals import residual_jacobians, tangent_basis
from epi360.estimation.refinement_reference import loss_terms
from epi360.estimation.weights import WeightModel
from epi360.poses import Pose

Array = NDArray[np.float64]


def inverse_information(information: Array) -> Array:
    """Return the inverse of the normal equations, NaN where the matches do not determine the pose.

    Parameters
    ----------
    information : ndarray, shape (K, K)
        J^T W J of K parameters, which are the five of a pose but where something else is said.
    """
    try:
        return np.asarray(np.linalg.inv(information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(information, np.nan)


def sandwich_covariance(J: Array, weights: Array, influence: tuple[Array, Array]) -> Array:
    """Return H^-1 (sum psi^2 J^T J) H^-1 with H = sum psi' J^T J, that of an M-estimator.

    Parameters
    ----------
    J : ndarray, shape (N, 5)
        Derivatives of the residuals at the minimum.
    weights : ndarray, shape (N,)
        Constant factors of each match's loss.
    influence : tuple of ndarray, shape (N,)
        psi, half the derivative of each match's loss by its residual, and its slope psi'.

    Notes
    -----
    Huber, "Robust Statistics", 1981. With psi = residual it allows for residuals of different
    variances (White 1980).
    """
    psi, slopes = influence
    bread = inverse_information((J.T * (weights * slopes)) @ J)
    return np.asarray(bread @ ((J.T * (weights * psi) ** 2) @ J) @ bread)


def loss_influence(residuals: Array, loss: str, scale: float) -> tuple[Array, Array]:
    """Return psi and psi' of a loss.

    Parameters
    ----------
    residuals : ndarray, shape (N,)
        Signed.
    loss : str
        "squared", "huber", "cauchy" or "geman_mcclure".
    scale : float
        Of the loss.
    """
    u = (residuals / scale) ** 2
    slopes = {
        "squared": np.ones_like(u),
        "huber": (u <= 1.0).astype(np.float64),
        "cauchy": (1.0 - u) / (1.0 + u) ** 2,
        "geman_mcclure": (1.0 - 3.0 * u) / (1.0 + u) ** 3,
    }
    return residuals * loss_terms(residuals**2, loss, scale)[1], slopes[loss]


def reweighting_influence(
    residuals: Array, used: NDArray[np.bool_], model: WeightModel
) -> tuple[Array, Array]:
    """Return psi and psi' of iteratively reweighted least squares, mean and scale held.

    Parameters
    ----------
    residuals : ndarray, shape (N,)
        Signed.
    used : ndarray, shape (N,), bool
        The matches that the model was fitted to.
    model : WeightModel
        Weights and slopes of those.
    """
    psi, slopes = np.zeros_like(residuals), np.zeros_like(residuals)
    psi[used], slopes[used] = model.weights * residuals[used], model.slopes
    return psi, slopes


# Noise of the bearings, per axis and view, over that of a residual which sees both views' noise.
ONE_SIDED = {"paper": 0.5**0.5, "angular": 0.5**0.5}
HALF_TRUSTED = 0.05  # share of a match's information that is noise, at which half of it counts
FREE_RAD = np.radians(60.0)  # standard deviation of an angle of which nothing is known
STEP_RAD = 1e-5  # of a bearing, in numeric derivatives


def errors_in_variables(
    cam2_from_cam1: Pose,
    bearings1: Array,
    bearings2: Array,
    scale: float,
    residual: str = "sampson",
) -> Array:
    """Return the covariance (5, 5) of a pose that allows for the noise of its own derivatives.

    Parameters
    ----------
    cam2_from_cam1 : Pose
        With a unit translation.
    bearings1, bearings2 : ndarray, shape (N, 3)
        Unit bearings of the inliers.
    scale : float
        Standard deviation of the residuals, in radians.
    residual : str
        As `residual_jacobians` knows it.

    Notes
    -----
    J^T W J / scale^2 = A + N, where N is what the noise of the bearings adds to it: of each match
    w D D^T, with the derivatives D of its J by both bearings along two axes each. Matches of which
    it makes up much, as near an epipole, have less weight. The covariance is A^-1 + A^-1 N A^-1
    (Fuller, "Measurement Error Models", 1987, section 2.2). N is a sum of squares and scatters; in
    A^-1 it is taken one standard deviation larger.
    """
    J = residual_jacobians(cam2_from_cam1, bearings1, bearings2, residual)
    D = _by_bearings(cam2_from_cam1, bearings1, bearings2, residual) * ONE_SIDED.get(residual, 1.0)
    added = np.sum(D**2, axis=(1, 2))
    noisy_share = scale**2 * added / np.sum(J**2, axis=1)
    weights = 1.0 / (1.0 + noisy_share / HALF_TRUSTED)
    N = np.einsum("n,nki,nkj->ij", weights, D, D)
    deviation = np.sqrt(2.0 * np.sum((weights * added) ** 2)) / np.sum(weights * added)
    inverse = bounded_inverse((J.T * weights) @ J / scale**2 - (1.0 + deviation) * N)
    variances, axes = np.linalg.eigh(inverse + inverse @ N @ inverse)
    return np.asarray((axes * np.minimum(variances, FREE_RAD**2)) @ axes.T)


def _by_bearings(pose: Pose, bearings1: Array, bearings2: Array, residual: str) -> Array:
    """Derivatives (N, 4, 5) of J by bearings that move along two axes in either view."""

    def jacobians(moved1: Array, moved2: Array) -> Array:
        b1, b2 = bearings1 + moved1, bearings2 + moved2
        b1, b2 = (b / np.linalg.norm(b, axis=1, keepdims=True) for b in (b1, b2))
        return residual_jacobians(pose, b1, b2, residual)

    axes1, axes2 = (np.stack(list(map(tangent_basis, view))) for view in (bearings1, bearings2))
    still = np.zeros_like(bearings1)
    moves = [(STEP_RAD * axes1[:, :, k], still) for k in (0, 1)]
    moves += [(still, STEP_RAD * axes2[:, :, k]) for k in (0, 1)]
    differences = [jacobians(*move) - jacobians(-move[0], -move[1]) for move in moves]
    return np.stack(differences, axis=1) / (2.0 * STEP_RAD)


def bounded_inverse(information: Array) -> Array:
    """Inverse of an information matrix; what it does not determine has the variance of 60 deg."""
    values, axes = np.linalg.eigh(information)
    return np.asarray((axes / np.maximum(values, FREE_RAD**-2)) @ axes.T)


SHARED_ERROR_REACH_RAD = np.radians(45.0)  # as a chord: there the correlation has fallen to 1 / e
SIGNIFICANT = 4.0  # standard deviations: once in sixty by chance
BANDS, SECTORS = 12, 16  # of the sphere: the matches of one cell are one observation of the field
FEWEST_CELLS = 20  # that the field is estimated from


def shared_error_covariance(
    bearings: tuple[Array, Array],
    gradients: tuple[Array, Array],
    residuals: Array,
    J: Array,
    *,
    scale: float,
    least: float,
) -> Array:
    """Return what a pose may be off by an error that neighbouring matches share, shape (K, K).

    Parameters
    ----------
    bearings, gradients : tuple of ndarray, shape (N, 3)
        Unit bearings of both views, and the derivatives of the residuals by them.
    residuals : ndarray, shape (N,)
        What the fit has left of the residuals, in radians.
    J : ndarray, shape (N, K)
        Derivatives of the residuals by the five numbers of a pose, or by more.
    scale : float
        Standard deviation of the residuals, in radians.
    least : float
        Least standard deviation of the shared error, in units of the scale.

    Notes
    -----
    Each view has a random field of displacements with standard deviation tau, whose correlation
    falls off exponentially with the distance on the sphere. tau^2 follows from the residuals by the
    method of moments, as a variance component does (Searle, "Linear Models", 1971). Where matches
    lie in fewer cells than ``FEWEST_CELLS``, the least is assumed.
    """
    lengths = np.sqrt(sum((g**2).sum(axis=1) for g in gradients))
    group = _groups(bearings[1])
    count = group.sum(axis=1)
    roots = np.sqrt(count)
    H = inverse_information(J.T @ J)
    squares = group @ residuals**2
    residuals, J = group @ residuals / roots, group @ J / roots[:, None]
    K = np.zeros((len(J), len(J)))
    for b, g in zip(bearings, gradients, strict=True):
        middle, direction = group @ b, group @ (g / lengths[:, None]) / count[:, None]
        middle /= np.linalg.norm(middle, axis=1)[:, None]
        chords = np.sqrt(np.maximum(2.0 - 2.0 * middle @ middle.T, 0.0))
        K += np.exp(-chords / SHARED_ERROR_REACH_RAD) * (direction @ direction.T)
    own = np.diag(K).copy()  # correlation of the matches of one cell
    K *= np.outer(roots, roots)
    np.fill_diagonal(K, 0.0)
    observed = float(residuals @ K @ residuals) + float(own @ (count * residuals**2 - squares))
    np.fill_diagonal(K, (count - 1.0) * own)  # pairs of different matches of one cell, too
    A = J.T @ K @ J
    KP = K - K @ J @ H @ J.T
    slope = float(np.sum(KP * KP.T))
    excess = observed + scale**2 * float(np.trace(H @ A))
    enough = len(J) >= FEWEST_CELLS and slope > 0.0
    shows = enough and excess > SIGNIFICANT * scale**2 * np.sqrt(2.0 * slope)
    tau2 = max(excess / slope if shows else 0.0, (least * scale) ** 2)
    return np.asarray(tau2 * H @ (A + (J.T * own) @ J) @ H)


def independent_share(bearings2: Array, shared: float) -> float:
    """Return the share of matches that tell as much if no neighbours are wrong together.

    It is of the size of the angles between R b1 and ``bearings2``, unit, of shape (N, 3), under the
    rotation that fits best, which takes up part of every shared error. ``shared`` is the variance
    of that, in each of two components, over the variance of the error of one match.

    Notes
    -----
    Of a Gaussian vector with covariance C, the squared length has the mean tr C and the variance
    2 tr C^2. The square of the one over the other is n for n matches with equal, independent
    errors (Satterthwaite 1946).
    """
    cells = _groups(bearings2)
    middle = cells @ bearings2
    middle = cells.T @ (middle / np.linalg.norm(middle, axis=1)[:, None])  # of the cell of each
    axes = np.stack([tangent_basis(bearing) for bearing in middle])  # (N, 3, 2)
    near = np.exp(-np.linalg.norm(middle[:, None] - middle, axis=2) / SHARED_ERROR_REACH_RAD)
    C = shared * np.einsum("ij,ika,jkb->iajb", near, axes, axes)
    C = C.reshape(2 * len(axes), 2 * len(axes)) + np.eye(2 * len(axes))
    turned = np.cross(np.eye(3), middle[:, None])  # how the bearing moves as the camera turns
    by_rotation = np.einsum("nka,nrk->nar", axes, turned).reshape(-1, 3)
    Q = np.linalg.qr(by_rotation)[0]
    left = np.eye(len(C)) - Q @ Q.T
    C = left @ C @ left
    return float(np.trace(C) ** 2 / (2.0 * (C**2).sum()) / len(bearings2))


def _groups(bearings: Array) -> Array:
    """Which match (columns) lies in which cell of the sphere (rows): 0 or 1."""
    x, y, z = bearings.T
    band = np.minimum((0.5 + 0.5 * np.clip(y, -1.0, 1.0)) * BANDS, BANDS - 1).astype(int)
    turn = 0.5 + np.arctan2(x, z) / (2.0 * np.pi)
    sector = np.minimum(turn * SECTORS, SECTORS - 1).astype(int)
    cell = band * SECTORS + sector
    return np.asarray(np.unique(cell)[:, None] == cell, dtype=np.float64)
