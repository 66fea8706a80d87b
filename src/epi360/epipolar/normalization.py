# SPDX-License-Identifier: BSD-3-Clause
"""Normalising matrices N of the eight-point family: q^ = N q (paper eq. 5, 6 and Table 1)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearings_array, weights_array

Array = NDArray[np.float64]

NORMALIZATIONS = ("none", "isotropic", "non_isotropic", "isotropic+non_isotropic", "sk")
# Below this ratio of second moments (an angle of 1e-6 rad) the bearings lie in one plane.
_FLAT = 1e-12


def isotropic_normalizer(bearings: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return Hartley's similarity of the plane, applied to bearings as they are: Table 1 (a).

    It is [[s, 0, -s x], [0, s, -s y], [0, 0, 1]] with the mean bearing (x, y, z) and the scale
    s = sqrt 2 over the root mean square distance of the bearings from it. Rows of the
    bearings (N, 3) with NaN are left out; ``weights`` (N,) count in the sums.

    Raises
    ------
    ValueError
        If the array has another shape than (N, 3), or all bearings have one direction.

    Notes
    -----
    Hartley, "In defense of the eight-point algorithm", 1997, section 6.1, moves the centroid of
    pixels (x, y, 1) to the origin. The last coordinate of a bearing is not 1, so that the same
    matrix shears the sphere by z. The paper's "isotropic, in spherical projection" is read here as
    the authors' published code computes it: root mean square distances in three dimensions. Only
    this scale gives the order of the sigma_8 and alpha columns of Table 1.
    """
    b, w = _usable(bearings, weights)
    mean = w @ b / w.sum()
    spread = np.sqrt(w @ ((b - mean) ** 2).sum(axis=1) / w.sum())
    if not spread > 1e-12:
        raise ValueError("isotropic normalization needs two directions, all bearings are equal")
    s = np.sqrt(2.0) / spread
    return np.array([[s, 0.0, -s * mean[0]], [0.0, s, -s * mean[1]], [0.0, 0.0, 1.0]])


def non_isotropic_normalizer(bearings: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the whitening of the second moments about the sphere's centre: Table 1 (b).

    It is the inverse of the Cholesky factor L of sum q q^T = L L^T, so that sum q^ q^^T = I. The
    arguments are those of `isotropic_normalizer`.

    Raises
    ------
    ValueError
        If the array has another shape than (N, 3), or the bearings lie in one plane.

    Notes
    -----
    Hartley 1997, section 6.2. The moments are summed and not averaged, as in the authors' code:
    the scale of N does not change E, but only the sum gives Table 1's sigma_8 of 0.012. If the
    camera is turned, N turns with it up to a rotation from the left, which does not change E.
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
    """Return N = diag(S, S, K) (paper eq. 5), an ovoid about z; E depends on |K / S| alone.

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
    """Return the matrices N1 and N2, both (3, 3), of a named normalisation.

    It is "none", "isotropic", "non_isotropic", "isotropic+non_isotropic" or the two numbers of eq.
    5, which serve both views. "sk" is refused: `search_sk` finds its numbers first. Bearings and
    weights are those of `eight_point`.

    Raises
    ------
    ValueError
        If the name is unknown, or a matrix cannot be computed from these bearings.

    Notes
    -----
    "isotropic+non_isotropic", Table 1's (a) + (b), is (b) in view 1 and (a) in view 2, as in the
    authors' code. It cannot be (b) after (a) in the same view: whitening undoes every linear map
    before it, so that this would give the E of (b) alone. The order of all five sigma_8 in Table 1
    and its largest alpha agree with this reading.
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
    """Raise ``ValueError`` unless this is a known name or a pair (S, K)."""
    is_name = isinstance(normalization, str) and normalization in NORMALIZATIONS
    is_pair = isinstance(normalization, tuple) and len(normalization) == 2
    if not (is_name or is_pair):
        names = ", ".join(NORMALIZATIONS)
        got = repr(normalization) if isinstance(normalization, str | tuple) else "another type"
        raise ValueError(f"normalization must be one of {names} or a tuple (S, K), got {got}")


def _usable(bearings: ArrayLike, weights: ArrayLike | None) -> tuple[Array, Array]:
    b = bearings_array(bearings, "bearings")
    w = weights_array(weights, len(b))
    w = np.ones(len(b)) if w is None else w
    usable = np.isfinite(b).all(axis=1) & (w > 0.0)
    if not usable.any():
        raise ValueError("normalization needs bearings, got none with a positive weight")
    return b[usable], w[usable]
