# SPDX-License-Identifier: BSD-3-Clause
"""The eight-point algorithm on bearing vectors (paper section 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair, weights_array

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EightPointSolution:
    """Linear estimate of the essential matrix.

    Attributes
    ----------
    E : ndarray, shape (3, 3)
        Rank 2, Frobenius norm sqrt(2); its two singular values may differ.
    singular_values : ndarray, shape (9,)
        Of the observation matrix, descending (NaN where N < 9 leaves fewer): the eighth over the
        first tells how well the data determine E, the ninth how well they fit.
    """

    E: Array
    singular_values: Array


def observation_matrix(bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Return A with A vec(E) = 0, row i the Kronecker product b2 (x) b1 (paper eq. 4).

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.

    Returns
    -------
    A : ndarray, shape (N, 9)
        For the row-wise vec(E) of b2^T E b1 = 0. The printed order q1 (x) q2 belongs to E^T.

    Raises
    ------
    ValueError
        If the bearings are no valid pair.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    return np.asarray(np.einsum("ni,nj->nij", b2, b1).reshape(-1, 9))


def eight_point(
    bearings1: ArrayLike, bearings2: ArrayLike, weights: ArrayLike | None = None
) -> EightPointSolution:
    """Return the essential matrix of least algebraic error (DLT, then rank 2).

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        At least eight matches; rows with NaN are left out.
    weights : array_like, shape (N,), optional
        Of the squared algebraic errors.

    Raises
    ------
    ValueError
        If the bearings are no valid pair or fewer than eight matches are there.

    Notes
    -----
    Longuet-Higgins 1981; paper section 3. The last right singular vector of A is reshaped and its
    smallest singular value zeroed.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    w = weights_array(weights, len(b1))
    A = observation_matrix(b1, b2)
    if w is not None:
        A = A * np.sqrt(w)[:, None]
    A = A[np.isfinite(A).all(axis=1)]
    if len(A) < 8:
        raise ValueError(f"the eight-point algorithm needs at least 8 matches, got {len(A)}")
    _, singular, Vt = np.linalg.svd(A, full_matrices=True)
    U, s, Wt = np.linalg.svd(Vt[8].reshape(3, 3))
    s = np.array([s[0], s[1], 0.0]) * np.sqrt(2.0) / np.hypot(s[0], s[1])
    padded = np.full(9, np.nan)
    padded[: len(singular)] = singular
    return EightPointSolution(U @ np.diag(s) @ Wt, padded)
