# SPDX-License-Identifier: BSD-3-Clause
"""Normalising matrices N of the eight-point family: q^ = N q (paper eq. 5, 6 and Table 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearings_array, weights_array

Array = NDArray[np.float64]

NORMALIZATIONS = ("none", "isotropic", "non_isotropic", "isotropic+non_isotropic", "sk")
# Below this ratio of second moments a view has no third direction left to whiten: 1e-6 rad.
_FLAT = 1e-12


def isotropic_normalizer(bearings: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Hartley's similarity of the plane, applied to bearings as they are: Table 1 (a).

    Parameters
    ----------
    bearings : array_like, shape (N, 3)
        One view; rows with NaN are left out.
    weights : array_like, shape (N,), optional
        Of the rows in mean and spread.

    Returns
    -------
    N : ndarray, shape (3, 3)
        [[s, 0, -s x], [0, s, -s y], [0, 0, 1]] with the mean bearing (x, y, z) and the scale
        s = sqrt 2 over the root mean square distance of the bearings from it.

    Raises
    ------
    ValueError
        If the array is no valid set of bearings or all of them are one direction.

    Notes
    -----
    Hartley, "In defense of the eight-point algorithm", 1997, section 6.1, moves the centroid of
    pixels (x, y, 1) to the origin. A bearing has no last coordinate 1, so on a sphere the same
    matrix shears by z. We read "isotropic, in spherical projection" as the authors' published code
    computes it: distances in three dimensions, root mean square. Only this scale gives the order
    of the sigma_8 and alpha columns of Table 1.
    """
    b, w = _usable(bearings, weights)
    mean = w @ b / w.sum()
    spread = np.sqrt(w @ ((b - mean) ** 2).sum(axis=1) / w.sum())
    if not spread > 1e-12:
        raise ValueError("isotropic normalization needs two directions, all bearings are equal")
    s = np.sqrt(2.0) / spread
    return np.array([[s, 0.0, -s * mean[0]], [0.0, s, -s * mean[1]], [0.0, 0.0, 1.0]])


def non_isotropic_normalizer(bearings: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Whitening of the second moments about the centre of the sphere: Table 1 (b).

    Parameters
    ----------
    bearings : array_like, shape (N, 3)
        One view; rows with NaN are left out.
    weights : array_like, shape (N,), optional
        Of the rows in the moments.

    Returns
    -------
    N : ndarray, shape (3, 3)
        L^-1 of the Cholesky factor in sum q q^T = L L^T, so that sum q^ q^^T = I.

    Raises
    ------
    ValueError
        If the array is no valid set of bearings, or they lie in one plane through the centre.

    Notes
    -----
    Hartley 1997, section 6.2. The sum, not the mean, as in the authors' code: the scale of N does
    not change E, but it is what makes Table 1's sigma_8 of 0.012. Follows a turn of the camera up
    to a turn from the left, which does not change E either.
    """
    b, w = _usable(bearings, weights)
    moments = (b.T * w) @ b
    spectrum = np.linalg.eigvalsh(moments)
    if not spectrum[0] > _FLAT * spectrum[2]:
        raise ValueError(
            "non_isotropic normalization needs bearings in three dimensions, these lie in one "
            "plane; use normalization='none'"
        )
    return np.asarray(np.linalg.inv(np.linalg.cholesky(moments)))


def sk_normalizer(S: float, K: float) -> Array:
    """Return N = diag(S, S, K), an ovoid about the z axis (paper eq. 5).

    Parameters
    ----------
    S, K : float
        Not zero; E depends on |K / S| alone.

    Raises
    ------
    ValueError
        If a number is zero or not finite.
    """
    if not (np.isfinite([S, K]).all() and S != 0.0 and K != 0.0):
        raise ValueError(f"S and K must be finite and not zero, got {S} and {K}")
    return np.diag([float(S), float(S), float(K)])


def normalizers(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    normalization: str | tuple[float, float] = "none",
    weights: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """Return the matrices N1 and N2 of a named normalisation; "sk" has to be searched first.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        The two views.
    normalization : str or tuple (S, K)
        "none", "isotropic", "non_isotropic", "isotropic+non_isotropic" or the two numbers of
        eq. 5, which serve both views.
    weights : array_like, shape (N,), optional
        Of the matches.

    Raises
    ------
    ValueError
        If the name is unknown or a normaliser cannot be computed.

    Notes
    -----
    "isotropic+non_isotropic", Table 1's (a) + (b), is (b) in view 1 and (a) in view 2, as in the
    authors' code. One after the other in the same view would be nothing new: whitening undoes
    every linear map before it, so (b) after (a) gives the E of (b). With this reading the order of
    all five sigma_8 and of the largest alpha in Table 1 come out.
    """
    check_normalization(normalization)
    if isinstance(normalization, tuple):
        N = sk_normalizer(*normalization)
        return N, N
    if normalization == "sk":
        raise ValueError("normalization sk is searched: use search_sk, or give (S, K)")
    if normalization == "none":
        return np.eye(3), np.eye(3)
    first = isotropic_normalizer if normalization == "isotropic" else non_isotropic_normalizer
    second = non_isotropic_normalizer if normalization == "non_isotropic" else isotropic_normalizer
    return first(bearings1, weights), second(bearings2, weights)


def check_normalization(normalization: str | tuple[float, float]) -> None:
    """Refuse what is neither a known name nor a pair (S, K).

    Parameters
    ----------
    normalization : str or tuple (S, K)
        To be checked.

    Raises
    ------
    ValueError
        With the names that exist.
    """
    known = isinstance(normalization, str) and normalization in NORMALIZATIONS
    pair = isinstance(normalization, tuple) and len(normalization) == 2
    if not (known or pair):
        names = ", ".join(NORMALIZATIONS)
        came = repr(normalization) if isinstance(normalization, str | tuple) else "another type"
        raise ValueError(f"normalization must be one of {names} or a tuple (S, K), got {came}")


def _usable(bearings: ArrayLike, weights: ArrayLike | None) -> tuple[Array, Array]:
    b = bearings_array(bearings, "bearings")
    w = weights_array(weights, len(b))
    w = np.ones(len(b)) if w is None else w
    usable = np.isfinite(b).all(axis=1) & (w > 0.0)
    if not usable.any():
        raise ValueError("normalization needs bearings, got none with a positive weight")
    return b[usable], w[usable]
