# SPDX-License-Identifier: BSD-3-Clause
"""Every estimator that the paper names, by name, on the native core."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from epi360 import _core
from epi360.epipolar.arguments import bearing_pair
from epi360.epipolar.sk_search import check_sk_search
from epi360.estimation.paper_reference import PAPER_METHODS
from epi360.estimation.refinement_reference import check_parameterization
from epi360.poses import Pose


def paper_pose(
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    method: str = "opt_sk",
    sk_search: str = "line",
    parameterization: str = "manifold",
) -> Pose:
    """Return the relative pose by one of the paper's estimators, without outlier rejection.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        At least eight matches; rows with NaN are left out.
    method : str
        Linear, with the pose of E by cheirality (eq. 3 to 9, Table 1):

        - "8pa": the eight-point algorithm on unit bearings (eq. 4);
        - "8pa_isotropic", "8pa_non_isotropic", "8pa_isotropic_non_isotropic": Hartley's
          normalisations (a), (b) and (a) + (b), see `epi360.epipolar.normalizers` (eq. 6 to 9);
        - "opt_sk": N = diag(S, S, K) of least sum of absolute residuals (eq. 5 and 14).

        Gold standard: Levenberg-Marquardt on the signed sines of eq. 13 over the pose (eq. 15,
        Table 2):

        - "gsm": all weights one, from the pose of "8pa";
        - "gsm_w_xi": constant Gaussian weights of the residuals of that pose;
        - "gsm_w_sk": constant Gaussian weights of the residuals of E(S*, K*), from "opt_sk";
        - "gsm_irls_xi", "gsm_irls_sk": from "8pa" or "opt_sk", the weights anew in every step;
        - "gsm_w_xi_t", "gsm_w_sk_t", "gsm_irls_xi_t", "gsm_irls_sk_t": the same with Student's t
          (five degrees of freedom, scale estimated).
    sk_search : str
        How the methods with "sk" search: "line" (over ln(K / S), all that E depends on) or "lm"
        (Levenberg-Marquardt over S and K from (1, 1), as printed).
    parameterization : str
        Parameters of the gold standard: "manifold" (SO(3) x S^2) or "se3" (the paper's xi).

    Returns
    -------
    cam2_from_cam1 : Pose
        With unit translation.

    Raises
    ------
    ValueError
        If the bearings are no valid pair, fewer than eight are usable, a name is unknown, or the
        bearings do not allow the normalisation.

    Notes
    -----
    With outliers use `epi360.estimate_relative_pose`; this is for experiments and comparisons.
    """
    if method not in PAPER_METHODS:
        raise ValueError(f"method must be one of {', '.join(PAPER_METHODS)}, got {method!r}")
    check_sk_search(sk_search)
    check_parameterization(parameterization)
    b1, b2 = bearing_pair(bearings1, bearings2)
    usable = np.isfinite(b1[:, 0]) & np.isfinite(b2[:, 0])  # a row is NaN as a whole
    if not usable.all():
        b1, b2 = b1[usable], b2[usable]
    if len(b1) < 8:
        raise ValueError(f"the paper's estimators need at least 8 matches, got {len(b1)}")
    R, t, *_ = _core.paper_pose(b1, b2, method, sk_search, parameterization)
    return Pose(R, t)
