# SPDX-License-Identifier: BSD-3-Clause
"""Every estimator that the paper names, in plain NumPy: the twin of `epi360.paper_pose`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair
from epi360.epipolar.essential import essential_from_pose, pose_from_essential
from epi360.epipolar.linear import eight_point
from epi360.epipolar.residuals import paper_residuals
from epi360.epipolar.sk_search import check_sk_search
from epi360.estimation.refinement_reference import check_parameterization, refine_pose_reference
from epi360.estimation.weights import residual_weights
from epi360.poses import Pose

Array = NDArray[np.float64]

# Table 1: the eight-point solution in a normalised domain.
_LINEAR = {
    "8pa": "none",
    "8pa_isotropic": "isotropic",
    "8pa_non_isotropic": "non_isotropic",
    "8pa_isotropic_non_isotropic": "isotropic+non_isotropic",
    "opt_sk": "sk",
}
# Table 2: the gold standard method, plain or weighted. The residuals that weights come from: "xi"
# of the 8-PA's pose, "sk" of the matrix E(S*, K*).
_WEIGHTED = ("gsm_w_xi", "gsm_w_sk", "gsm_irls_xi", "gsm_irls_sk")

PAPER_METHODS = (*_LINEAR, "gsm", *_WEIGHTED, *(f"{name}_t" for name in _WEIGHTED))


def paper_pose_reference(
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
        One of `PAPER_METHODS`. "8pa" and its normalisations and "opt_sk" of Table 1; of Table 2
        "gsm", "gsm_w_*" with constant weights and "gsm_irls_*" with weights that follow the
        residuals; "_t" for Student's t in place of the Gaussian.
    sk_search : str
        "line" or "lm", for the methods that search (S, K).
    parameterization : str
        "manifold" or "se3", for the "gsm" methods.

    Returns
    -------
    cam2_from_cam1 : Pose
        With unit translation.

    Raises
    ------
    ValueError
        If the bearings are no valid pair, fewer than eight are usable or a name is unknown.
    """
    if method not in PAPER_METHODS:
        raise ValueError(f"method must be one of {', '.join(PAPER_METHODS)}, got {method!r}")
    check_sk_search(sk_search)
    check_parameterization(parameterization)
    b1, b2 = bearing_pair(bearings1, bearings2)
    usable = np.isfinite(b1).all(axis=1) & np.isfinite(b2).all(axis=1)
    b1, b2 = b1[usable], b2[usable]
    if method in _LINEAR:
        E = eight_point(b1, b2, _LINEAR[method], sk_search=sk_search).E
        return pose_from_essential(E, b1, b2)
    return _gold_standard(b1, b2, method, sk_search, parameterization)


def _gold_standard(
    b1: Array, b2: Array, method: str, sk_search: str, parameterization: str
) -> Pose:
    # Eq. 14 or the plain 8-PA: the start, and what the constant weights are judged by.
    E = eight_point(b1, b2, "sk" if "_sk" in method else "none", sk_search=sk_search).E
    start = pose_from_essential(E, b1, b2)
    kind = "student_t" if method.endswith("_t") else "gaussian"
    weights = None
    if "_w_" in method:  # omega of eq. 15
        judge = E if "_sk" in method else essential_from_pose(start)
        weights = residual_weights(paper_residuals(judge, b1, b2), kind)
    pose, _ = refine_pose_reference(
        b1,
        b2,
        start,
        "paper",  # eq. 13
        weights=weights,
        reweight=kind if "_irls_" in method else None,
        parameterization=parameterization,
    )
    return pose
