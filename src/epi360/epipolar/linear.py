# SPDX-License-Identifier: BSD-3-Clause
"""The eight-point algorithm on bearing vectors, normalised or not (paper sections 3 and 4.1)."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair, usable_matches
from epi360.epipolar.essential import kronecker_rows, rank_two
from epi360.epipolar.normalization import check_normalization, normalizers
from epi360.epipolar.sk_search import check_sk_search, search_sk

Array = NDArray[np.float64]

CONSTRAINTS = ("unit", "taubin")


@dataclass(frozen=True, eq=False)
class EightPointSolution:
    """Linear estimate of the essential matrix.

    ``E`` has rank 2 and Frobenius norm sqrt(2). Its two singular values may differ, and its sign is
    arbitrary. It was made from the vectors N b with ``normalizer1`` and ``normalizer2`` (paper eq.
    6). ``S`` and ``K`` are the parameters of eq. 5, or None if the normalisation has none.
    """

    E: Array
    normalizer1: Array = field(default_factory=lambda: np.eye(3))
    normalizer2: Array = field(default_factory=lambda: np.eye(3))
    S: float | None = None
    K: float | None = None
    # The matches used and their weights, for what is computed on demand.
    _bearings1: Array = field(default_factory=lambda: np.empty((0, 3)), repr=False)
    _bearings2: Array = field(default_factory=lambda: np.empty((0, 3)), repr=False)
    _weights: Array | None = field(default=None, repr=False)

    @cached_property
    def singular_values(self) -> Array:
        """Singular values of the (weighted) normalised observation matrix, descending, shape (9,).

        The eighth divided by the first says how well the data determine E; the ninth divided by
        the eighth says how badly they fit it. With eight matches the ninth is NaN.
        """
        b1, b2 = self._bearings1 @ self.normalizer1.T, self._bearings2 @ self.normalizer2.T
        return nine_singular_values(_weighted_rows(b1, b2, self._weights))


def observation_matrix(bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Return the matrix A (N, 9) with A vec(E) = 0 (paper eq. 4).

    Row i is the Kronecker product b2 (x) b1 of the directions in rows i of ``bearings1`` and
    ``bearings2``, both (N, 3); vec(E) has the rows of E one after the other. The order q1 (x) q2
    that the paper prints belongs to E^T.

    Raises
    ------
    ValueError
        If an array has another shape than (N, 3), or the lengths differ.
    """
    return kronecker_rows(*bearing_pair(bearings1, bearings2))


def eight_point(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    normalization: str | tuple[float, float] = "none",
    constraint: str = "unit",
    weights: ArrayLike | None = None,
    *,
    sk_search: str = "line",
) -> EightPointSolution:
    """Return the essential matrix of least algebraic error (DLT, then rank 2).

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        At least eight matches; rows with NaN are left out.
    normalization : str or tuple (S, K)
        "none", "isotropic", "non_isotropic", "isotropic+non_isotropic", "sk" (searched, eq. 14)
        or S and K of eq. 5 themselves.
    constraint : str
        "unit" fixes the length of vec(E). "taubin" fixes the mean squared gradient of the algebraic
        errors, so that these become angles to first order; it gives the same E in every normalised
        domain and is accepted only with the normalisation "none".
    weights : array_like, shape (N,), optional
        Weights of the matches, in the squared algebraic errors and in every sum of a normalisation
        or constraint: a weight of 3 counts like three copies, 0 removes a match.
    sk_search : str
        How "sk" is searched: "line" or "lm".

    Raises
    ------
    ValueError
        If an array has the wrong shape, fewer than eight matches are usable, a name is unknown, or
        the bearings do not allow the normalisation or constraint.

    Notes
    -----
    Longuet-Higgins 1981; paper sections 3 and 4.1. Taubin, "Estimation of planar curves", PAMI
    1991, in the tangent planes of the sphere. Eight matches give the same vec(E) under both
    constraints.
    """
    check_normalization(normalization)
    check_constraint(constraint, normalization)
    check_sk_search(sk_search)
    b1, b2, w = usable_matches(bearings1, bearings2, weights)
    if constraint == "taubin":
        return EightPointSolution(_taubin(b1, b2, w), _bearings1=b1, _bearings2=b2, _weights=w)
    if normalization == "sk":
        normalization = search_sk(b1, b2, sk_search, w)[:2]
    N1, N2 = normalizers(b1, b2, normalization, w)
    E = _least_algebraic_error(b1, b2, N1, N2, w)
    S, K = normalization if isinstance(normalization, tuple) else (None, None)
    return EightPointSolution(E, N1, N2, S, K, b1, b2, w)


def check_constraint(constraint: str, normalization: str | tuple[float, float]) -> None:
    """Raise ``ValueError`` unless the constraint is known and has an effect on E."""
    if constraint not in CONSTRAINTS:
        raise ValueError(f"constraint must be one of {', '.join(CONSTRAINTS)}, got {constraint!r}")
    if constraint == "taubin" and normalization != "none":
        raise ValueError(
            "constraint taubin gives the same E in every normalised domain: use it with "
            f"normalization='none', got {normalization!r}"
        )


def _least_algebraic_error(b1: Array, b2: Array, N1: Array, N2: Array, w: Array | None) -> Array:
    A = _weighted_rows(b1 @ N1.T, b2 @ N2.T, w)  # eq. 6 and 4
    E_hat = rank_two(np.linalg.svd(A, full_matrices=len(A) < 9)[2][8])
    return _scaled(N2.T @ E_hat @ N1)  # eq. 9, with an N for each view


def _taubin(b1: Array, b2: Array, w: Array | None) -> Array:
    """Minimise e^T M e / e^T D e; e^T D e = sum |P2 E b1|^2 + |P1 E^T b2|^2, P = I - b b^T."""
    weights = np.ones(len(b1)) if w is None else w
    outer1, outer2 = np.einsum("ni,nj->nij", b1, b1), np.einsum("ni,nj->nij", b2, b2)
    tangent1, tangent2 = np.eye(3) - outer1, np.eye(3) - outer2
    gradients2 = np.einsum("n,nij,nkl->ikjl", weights, tangent2, outer1)
    gradients1 = np.einsum("n,nij,nkl->ikjl", weights, outer2, tangent1)
    try:
        L = np.linalg.cholesky((gradients1 + gradients2).reshape(9, 9))
    except np.linalg.LinAlgError:
        raise ValueError(
            "constraint taubin needs bearings in three dimensions; use constraint='unit'"
        ) from None
    # With e = L^-T y and D = L L^T the constraint is |y| = 1.
    A = _weighted_rows(b1, b2, w) @ np.linalg.inv(L).T
    y = np.linalg.svd(A, full_matrices=len(A) < 9)[2][8]
    return _scaled(rank_two(np.linalg.solve(L.T, y)))


def nine_singular_values(A: Array) -> Array:
    """Return nine singular values of an observation matrix, NaN where it has fewer."""
    values = np.linalg.svd(A, compute_uv=False)
    return np.concatenate([values, np.full(9 - len(values), np.nan)])


def _weighted_rows(b1: Array, b2: Array, w: Array | None) -> Array:
    A = kronecker_rows(b1, b2)
    return np.asarray(A if w is None else A * np.sqrt(w)[:, None])


def _scaled(E: Array) -> Array:
    return np.asarray(E * (np.sqrt(2.0) / np.linalg.norm(E)))
