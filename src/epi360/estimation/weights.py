# SPDX-License-Identifier: BSD-3-Clause
"""Confidence of each match from its residual: the weights omega of paper section 4.3."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

WEIGHT_KINDS = ("gaussian", "student_t", "mixture")

DEGREES_OF_FREEDOM = 5.0  # nu of Student's t: the paper does not print one, Kerl 2013 takes 5
STUDENT_ROUNDS = 20
_LARGEST = 1e100  # residual, whose square is a number
MIXTURE_ROUNDS = 50
# Density of an outlier's residual. The signed sine between a random direction and a plane is
# uniform over [-1, 1] (Archimedes); an angle in radians is near it where it competes with inliers.
OUTLIER_DENSITY = 0.5


@dataclass(frozen=True)
class WeightModel:
    """Weights and what an M-estimator's covariance needs of them.

    Attributes
    ----------
    weights : ndarray, shape (N,)
        omega.
    slopes : ndarray, shape (N,)
        Derivative of omega times residual by the residual, mean and scale held.
    scale : float
        Standard deviation (or scale) of the inliers' residuals.
    """

    weights: Array
    slopes: Array
    scale: float


def residual_weights(residuals: ArrayLike, kind: str = "gaussian") -> Array:
    """Return how much each match is to be believed, from its signed residual.

    Parameters
    ----------
    residuals : array_like, shape (N,)
        Signed, as `epi360.epipolar` gives them. Absolute values would hide that the mean is near
        zero and are measurably worse. NaN marks missing data.
    kind : str
        "gaussian": the normal density of the residuals' own mean and standard deviation, 1 at its
        top (paper eq. 15). "student_t": (nu + 1) / (nu + u^2), nu = 5, of the residual u about
        the mean in units of a scale; both are fitted. "mixture": probability of being an inlier
        among Gaussian inliers of mean zero and uniform outliers, whose standard deviation and
        share are fitted by expectation-maximisation; for sines or radians.

    Returns
    -------
    weights : ndarray, shape (N,)
        0 where the residual is NaN. In [0, 1], for "student_t" in [0, 1.2].

    Raises
    ------
    ValueError
        If the residuals are not one-dimensional, one is over 1e100 or the kind is unknown.

    Notes
    -----
    With Student's t of a scale of one, as in the paper's Table 2, the weights of sines are all
    equal, which is why it seemed useless there. Kerl, Sturm & Cremers 2013 fit the scale as here.
    """
    e = np.asarray(residuals, dtype=np.float64)
    if e.ndim != 1:
        raise ValueError(f"residuals must have shape (N,), got {e.shape}")
    if np.isinf(e).any():
        raise ValueError("residuals must be finite (NaN marks a missing match)")
    sizes = np.abs(e)
    if (sizes > _LARGEST).any():
        raise ValueError(f"residuals must be at most {_LARGEST:g}, got {np.nanmax(sizes):g}")
    e = np.where(sizes < 1.0 / _LARGEST, 0.0, e)  # NaN stays; squares would vanish
    check_weight_kind(kind)
    weights = np.zeros(len(e))
    present = np.isfinite(e)
    if present.any():
        weights[present] = weight_model(e[present], kind).weights
    return weights


def check_weight_kind(kind: str) -> None:
    """Refuse an unknown kind of weights.

    Parameters
    ----------
    kind : str
        To be checked.

    Raises
    ------
    ValueError
        With the kinds that exist.
    """
    if kind not in WEIGHT_KINDS:
        raise ValueError(f"kind of weights must be one of {', '.join(WEIGHT_KINDS)}, got {kind!r}")


def weight_model(residuals: Array, kind: str) -> WeightModel:
    """Return the weights of residuals without NaN, with their slopes and scale.

    Parameters
    ----------
    residuals : ndarray, shape (N,)
        At least one, finite.
    kind : str
        As in `residual_weights`.
    """
    functions: dict[str, Callable[[Array], WeightModel]] = {
        "gaussian": _gaussian,
        "student_t": _student_t,
        "mixture": _mixture,
    }
    return functions[kind](residuals)


def _gaussian(e: Array) -> WeightModel:
    deviation = float(e.std())
    if not deviation > 0.0:  # all residuals equal: nothing to tell them apart
        return WeightModel(np.ones_like(e), np.ones_like(e), 0.0)
    u2 = ((e - e.mean()) / deviation) ** 2
    w = np.exp(-0.5 * u2)
    return WeightModel(w, w * (1.0 - u2), deviation)


def _student_t(e: Array) -> WeightModel:
    nu = DEGREES_OF_FREEDOM
    mean, variance = float(e.mean()), float(e.var())
    if not variance > 0.0:
        return WeightModel(np.ones_like(e), np.ones_like(e), 0.0)
    w, u2 = np.ones_like(e), np.zeros_like(e)
    for _ in range(STUDENT_ROUNDS):
        squares = (e - mean) ** 2
        u2 = squares / variance
        w = (nu + 1.0) / (nu + u2)
        mean, variance = float(w @ e / w.sum()), float(np.mean(w * squares))
        if not variance > 0.0:
            break
    return WeightModel(w, (nu + 1.0) * (nu - u2) / (nu + u2) ** 2, math.sqrt(variance))


def _mixture(e: Array) -> WeightModel:
    share = 0.5
    deviation = 1.4826 * float(np.median(np.abs(e)))
    p = np.ones_like(e)
    if not deviation > 0.0:
        return WeightModel((e == 0.0).astype(np.float64), p, 0.0)
    for _ in range(MIXTURE_ROUNDS):
        density = np.exp(-0.5 * (e / deviation) ** 2) / (math.sqrt(2.0 * math.pi) * deviation)
        inlier, outlier = share * density, (1.0 - share) * OUTLIER_DENSITY
        p = inlier / (inlier + outlier)
        share = float(p.mean())
        if not share > 0.0:
            break
        updated = math.sqrt(float(p @ e**2 / p.sum()))
        if not updated > 0.0:
            break
        deviation = updated
    return WeightModel(p, p - p * (1.0 - p) * (e / deviation) ** 2, deviation)
