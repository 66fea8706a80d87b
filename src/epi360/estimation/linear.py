# SPDX-License-Identifier: BSD-3-Clause
"""The eight-point family on the native core; its twin is `epi360.epipolar.eight_point`."""

from __future__ import annotations

from numpy.typing import ArrayLike

from epi360 import _core
from epi360.epipolar.arguments import usable_matches
from epi360.epipolar.linear import EightPointSolution, check_constraint
from epi360.epipolar.normalization import check_normalization, sk_normalizer
from epi360.epipolar.sk_search import check_sk_search


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
        What has length one: "unit" the vector E, "taubin" the mean squared gradient of the
        algebraic errors, which makes them angles to first order; with "none" only.
    weights : array_like, shape (N,), optional
        Weights of the squared algebraic errors, and of the matches wherever a normalisation or
        constraint sums over them: a weight of 3 counts like three copies, 0 removes a match.
    sk_search : str
        "line" or "lm": how "sk" is searched.

    Returns
    -------
    solution : EightPointSolution
        E, its normalisers and, on demand, the singular values of the observation matrix.

    Raises
    ------
    ValueError
        If the bearings are no valid pair, fewer than eight are usable, a name is unknown, or the
        bearings do not allow the normalisation or constraint.

    Notes
    -----
    Longuet-Higgins 1981; paper sections 3 and 4.1. More than eight matches are solved by the 9 x 9
    matrix A^T A, which keeps half the digits of sigma_8 / sigma_1; eight by a QR of A.
    """
    check_normalization(normalization)
    check_constraint(constraint, normalization)
    check_sk_search(sk_search)
    b1, b2, w = usable_matches(bearings1, bearings2, weights)
    if normalization == "sk":
        normalization = _core.search_sk(b1, b2, sk_search, w)[:2]
    if isinstance(normalization, tuple):
        S, K = (float(value) for value in normalization)
        sk_normalizer(S, K)  # refuses zeros
        E, N1, N2 = _core.solve_linear(b1, b2, "given", S=S, K=K, weights=w)
        return EightPointSolution(E, N1, N2, S, K, b1, b2, w)
    E, N1, N2 = _core.solve_linear(b1, b2, normalization, constraint == "taubin", weights=w)
    return EightPointSolution(E, N1, N2, None, None, b1, b2, w)
