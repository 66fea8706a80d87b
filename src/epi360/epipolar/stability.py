# SPDX-License-Identifier: BSD-3-Clause
"""How well matches determine an essential matrix (paper section 4.2, eq. 10 to 12)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair
from epi360.epipolar.essential import kronecker_rows
from epi360.epipolar.linear import nine_singular_values
from epi360.epipolar.normalization import check_normalization, normalizers
from epi360.epipolar.sk_search import search_sk
from epi360.poses import Pose, angles_between

Array = NDArray[np.float64]

# How many rows of an N x N table are in memory at a time.
_BLOCK = 512


@dataclass(frozen=True, eq=False)
class Stability:
    """The paper's measures of a set of matches, in the normalised domain q^ = N q.

    Measures that need all N^2 pairs of matches are computed on first use.

    Attributes
    ----------
    singular_values : ndarray, shape (9,)
        Singular values of the normalised observation matrix, descending; with eight matches the
        ninth is NaN.
    normalizer1, normalizer2 : ndarray, shape (3, 3)
        N of each view.
    alpha_rad : ndarray, shape (M,)
        Angle between N1 q1 and N2 q2 of every match, which contains the camera's rotation; NaN for
        rows with NaN. Table 1's alpha is the mean.
    parallax_rad : ndarray, shape (M,)
        Motion parallax, the angle between R q1 and q2; NaN if no pose was given.
    normalized_parallax_rad : ndarray, shape (M,)
        Angle between N2 R q1 and N2 q2; NaN if no pose was given.
    """

    singular_values: Array
    normalizer1: Array
    normalizer2: Array
    alpha_rad: Array = field(repr=False)
    parallax_rad: Array = field(repr=False)
    normalized_parallax_rad: Array = field(repr=False)
    _q1: Array = field(repr=False)  # normalised, without missing rows
    _q2: Array = field(repr=False)
    _usable: NDArray[np.bool_] = field(repr=False)

    @property
    def num_matches(self) -> int:
        """Number n of the matches without NaN."""
        return len(self._q1)

    @property
    def sigma_8(self) -> float:
        """Eighth singular value, the paper's measure; it grows with n and with the square of N."""
        return float(self.singular_values[7])

    @property
    def sigma_8_over_sigma_1(self) -> float:
        """How well the data determine E, whatever n and the scale of N are."""
        return float(self.singular_values[7] / self.singular_values[0])

    @property
    def sigma_9_over_sigma_8(self) -> float:
        """How badly the data fit the best E: 0 for exact data, 1 if no E is better than another."""
        return float(self.singular_values[8] / self.singular_values[7])

    @property
    def gram_norm_squared(self) -> float:
        """Left side of eq. 10: squared Frobenius norm of A A^T, from the singular values."""
        return float(np.nansum(self.singular_values**4))

    @cached_property
    def internal_angle_sum(self) -> float:
        """Right side of eq. 10: sum over all i, j of cos^2 beta1_ij cos^2 beta2_ij.

        In a normalised domain, where vectors are not of unit length, each term is multiplied by the
        squared lengths of its four vectors; only so the equation holds there too.
        """
        return float(
            sum(((a @ self._q1.T) ** 2 * (b @ self._q2.T) ** 2).sum() for a, b in self._blocks())
        )

    @property
    def sigma_8_bound(self) -> float:
        """Right side of eq. 11, an upper bound of sigma_8.

        It bounds the smallest of eight numbers whose sum and sum of squares are known; a ninth
        number above zero only lowers sigma_8. In a normalised domain n becomes tr(A^T A).
        """
        n = float(np.nansum(self.singular_values**2))
        spread = max(8.0 * self.gram_norm_squared - n**2, 0.0)
        return float(np.sqrt(max(n / 8.0 - np.sqrt(spread / 7.0) / 8.0, 0.0)))

    @property
    def mean_alpha_rad(self) -> float:
        """Mean of alpha_rad over the matches without NaN: Table 1's alpha."""
        return _mean(self.alpha_rad)

    @property
    def mean_parallax_rad(self) -> float:
        """Mean motion parallax, NaN if no pose was given."""
        return _mean(self.parallax_rad)

    @property
    def mean_normalized_parallax_rad(self) -> float:
        """Mean motion parallax in the normalised domain of view 2, NaN if no pose was given."""
        return _mean(self.normalized_parallax_rad)

    @cached_property
    def mean_internal_angles_rad(self) -> tuple[float, float]:
        """Means of the internal angles beta1_ij and beta2_ij over all pairs i < j."""
        sums = np.zeros(2)
        for a, b in self._blocks():
            sums += (
                angles_between(a[:, None], self._q1).sum(),
                angles_between(b[:, None], self._q2).sum(),
            )
        pairs = self.num_matches * (self.num_matches - 1)
        return float(sums[0] / pairs), float(sums[1] / pairs)

    def internal_angles_rad(self) -> tuple[Array, Array]:
        """Return the internal angles beta1 and beta2, each (n, n) for the n matches without NaN."""
        return angles_between(self._q1[:, None], self._q1), angles_between(
            self._q2[:, None], self._q2
        )

    def essential_error_bound(self, bearings1: ArrayLike, bearings2: ArrayLike) -> float:
        """Return the right side of eq. 12, |Q|_2 / sigma_8, from the matches without noise.

        It bounds the sine of the angle between the vec(E) of the DLT and the true one, both in the
        normalised domain and before E is made to have rank 2. ``bearings1`` and ``bearings2``, both
        (M, 3), are the true bearings in the rows of those that were given to `stability`.

        Raises
        ------
        ValueError
            If there are not M rows, or a row is NaN that was not NaN for `stability`.

        Notes
        -----
        Q is A - A_true, and sigma_8 is that of the noisy A. If A_true e = 0 and theta is the angle
        between e and the last right singular vector of A, then
        sigma_8 sin theta <= |A e| = |Q e| <= |Q|_2.
        """
        b1, b2 = bearing_pair(bearings1, bearings2)
        if len(b1) != len(self._usable):
            rows = len(self._usable)
            raise ValueError(f"bearings must have the {rows} rows of stability(), got {len(b1)}")
        true1, true2 = b1[self._usable] @ self.normalizer1.T, b2[self._usable] @ self.normalizer2.T
        if not (np.isfinite(true1).all() and np.isfinite(true2).all()):
            raise ValueError("the true bearings must not be NaN where those of stability() are not")
        Q = kronecker_rows(self._q1, self._q2) - kronecker_rows(true1, true2)
        return float(np.linalg.norm(Q, 2) / self.sigma_8)

    def _blocks(self) -> Iterator[tuple[Array, Array]]:
        for start in range(0, self.num_matches, _BLOCK):
            yield self._q1[start : start + _BLOCK], self._q2[start : start + _BLOCK]


def stability(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    normalization: str | tuple[float, float] = "none",
    cam2_from_cam1: Pose | None = None,
) -> Stability:
    """Return how well matches determine an essential matrix.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (M, 3)
        At least eight matches; rows with NaN are left out.
    normalization : str or tuple (S, K)
        Domain to measure in, named as in `eight_point`; "sk" is searched first.
    cam2_from_cam1 : Pose, optional
        True pose, which the motion parallax needs.

    Raises
    ------
    ValueError
        If an array has the wrong shape, fewer than eight matches are usable, or the normalisation
        is unknown or impossible with these bearings.

    Notes
    -----
    Paper section 4.2; da Silveira & Jung, "Perturbation analysis of the 8-point algorithm", CVPR
    2019. Do not compare sigma_8 alone: S = K = 2 makes it four times larger and does not change
    E. Compare sigma_8_over_sigma_1 and sigma_9_over_sigma_8.
    """
    check_normalization(normalization)
    b1, b2 = bearing_pair(bearings1, bearings2)
    usable = np.isfinite(b1).all(axis=1) & np.isfinite(b2).all(axis=1)
    if usable.sum() < 8:
        raise ValueError(f"stability needs at least 8 matches, got {usable.sum()}")
    if normalization == "sk":
        normalization = search_sk(b1, b2)[:2]
    N1, N2 = normalizers(b1[usable], b2[usable], normalization)
    q1, q2 = b1 @ N1.T, b2 @ N2.T
    R = np.full((3, 3), np.nan) if cam2_from_cam1 is None else cam2_from_cam1.rotation
    turned = b1 @ R.T
    return Stability(
        nine_singular_values(kronecker_rows(q1[usable], q2[usable])),
        N1,
        N2,
        angles_between(q1, q2),
        angles_between(turned, b2),
        angles_between(turned @ N2.T, q2),
        q1[usable],
        q2[usable],
        np.asarray(usable),
    )


def _mean(angles: Array) -> float:
    present = angles[np.isfinite(angles)]
    return float(present.mean()) if len(present) else float("nan")
