# SPDX-License-Identifier: BSD-3-Clause
"""Wrong matches by a stated model, and noise in metres as in the code of the paper's authors."""

from collections.abc import Callable
from functools import partial
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from epi360.synthetic.directions import cap_directions

Array = NDArray[np.float64]

Sampler = Callable[[np.random.Generator, int], Array]
OutlierModel = Literal["uniform", "shuffled", "authors"]


def add_metric_noise(
    rng: np.random.Generator,
    points: Array,
    *,
    sigma_m: float | None = None,
    kappa: float | None = None,
) -> Array:
    """Points in the frame of a camera with independent noise on each coordinate, in metres.

    This is what the authors' published code does to the points of view 2 in place of von
    Mises-Fisher noise on the bearings: the nearer a point, the larger its angle of error.

    Parameters
    ----------
    rng : numpy.random.Generator
    points : ndarray, shape (N, 3)
        Metres.
    sigma_m : float, optional
        Standard deviation of Gaussian noise.
    kappa : float, optional
        Concentration of a scalar von Mises variable whose radians are taken for metres, as in the
        authors' code; nearly Gaussian of ``1 / sqrt(kappa)`` m, 4.5 cm for 500.

    Raises
    ------
    ValueError
        Unless one of `sigma_m` >= 0 and `kappa` > 0 is given.
    """
    if (sigma_m is None) == (kappa is None):
        raise ValueError(f"give one of sigma_m and kappa, got {sigma_m} and {kappa}")
    if sigma_m is not None:
        if not 0.0 <= sigma_m < np.inf:
            raise ValueError(f"sigma_m must be 0 or more, got {sigma_m}")
        return points + sigma_m * rng.standard_normal(points.shape)
    if kappa is None or not kappa > 0:
        raise ValueError(f"kappa must be positive, got {kappa}")
    return points + rng.vonmises(0.0, kappa, points.shape)


def replace_with_outliers(
    rng: np.random.Generator,
    bearings2: Array,
    ratio: float,
    *,
    model: OutlierModel = "uniform",
    uniform_directions: Sampler | None = None,
) -> tuple[Array, NDArray[np.bool_]]:
    """Bearings (N, 3) of view 2 with a share of wrong ones, and the mask (N,) of the right ones.

    Parameters
    ----------
    rng : numpy.random.Generator
    bearings2 : ndarray, shape (N, 3)
        Unit vectors; row i matches row i of view 1. Unchanged.
    ratio : float
        Nominal share of outliers in [0, 1].
    model : {"uniform", "shuffled", "authors"}
        "uniform": exactly ``round(ratio N)`` rows become uniform random directions. "shuffled":
        that many rows exchange their bearings, as wrong matches between true key points do.
        "authors": as in the published code, that many rows are drawn *with* replacement, and each
        becomes the bearing of a random row or its antipode. A nominal 50 % is then 39 %, because
        only 1 - exp(-ratio) of the rows are drawn.
    uniform_directions : callable, optional
        Makes the directions (count, 3) of "uniform" from the generator and their number; by
        default they cover the whole sphere.

    Raises
    ------
    ValueError
        If `ratio` or `model` is unknown, or one single match is to be shuffled.
    """
    check_outliers(ratio, model)
    num = len(bearings2)
    count = round(ratio * num)
    disturbed = bearings2.copy()
    if model == "authors":
        rows, others = rng.integers(0, max(num, 1), (2, count))
        signs = rng.choice(np.array([-1.0, 1.0]), count)
        disturbed[rows] = signs[:, None] * bearings2[others]
        return disturbed, np.asarray((disturbed == bearings2).all(axis=1))
    rows = rng.choice(num, count, replace=False)
    if model == "uniform":
        all_around = partial(cap_directions, half_angle=np.pi)
        disturbed[rows] = (uniform_directions or all_around)(rng, count)
    else:
        disturbed[rows] = bearings2[_other_rows(rng, rows, num)]
    inlier_mask = np.ones(num, dtype=np.bool_)
    inlier_mask[rows] = False
    return disturbed, inlier_mask


def check_outliers(ratio: float, model: str) -> None:
    """Raise ``ValueError`` for an unknown model of outliers or a share outside [0, 1]."""
    if not 0.0 <= ratio <= 1.0:
        raise ValueError(f"outlier_ratio must be in [0, 1], got {ratio}; 0.2 is 20 %")
    if model not in get_args(OutlierModel):
        known = ", ".join(get_args(OutlierModel))
        raise ValueError(f"outlier_model must be one of {known}, got {model!r}")


def _other_rows(rng: np.random.Generator, rows: NDArray[np.intp], num: int) -> NDArray[np.intp]:
    if len(rows) != 1:
        return np.roll(rows, 1)
    if num == 1:
        raise ValueError("one single match cannot be shuffled; use more matches")
    return (rows + rng.integers(1, num, 1)) % num
