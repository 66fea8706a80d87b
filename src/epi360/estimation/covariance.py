# SPDX-License-Identifier: BSD-3-Clause
"""Covariance of a refined pose in its five parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.refinement_reference import loss_terms
from epi360.estimation.weights import WeightModel

Array = NDArray[np.float64]


def inverse_information(information: Array) -> Array:
    """Return the inverse of the normal equations, NaN where the matches do not determine the pose.

    Parameters
    ----------
    information : ndarray, shape (5, 5)
        J^T W J.
    """
    try:
        return np.asarray(np.linalg.inv(information), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full((5, 5), np.nan)


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
