# SPDX-License-Identifier: BSD-3-Clause
"""How far a match is from the epipolar constraint: every residual and its Jacobian."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair, jacobians_array
from epi360.epipolar.essential import essential_from_pose
from epi360.poses import Pose, checked_pose

Array = NDArray[np.float64]

# Residuals that need one match alone; "solarte2021" divides by norms of all matches.
RESIDUALS = ("paper", "angular", "sampson", "tangent_sampson")


def paper_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Return the signed sine between each bearing of view 2 and its epipolar plane (eq. 13).

    It is the sine of `angular_residuals`, whose arguments and errors are the same; the paper prints
    its absolute value.
    """
    _, normals, _, C = _constraints(E, bearings1, bearings2)
    with np.errstate(invalid="ignore"):
        return np.asarray(C / np.linalg.norm(normals, axis=1))


def angular_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Return the signed angle between each bearing of view 2 and its epipolar plane.

    Parameters
    ----------
    E, bearings1, bearings2 : array_like, shapes (3, 3), (N, 3) and (N, 3)
        Essential matrix, and directions; row i of both is one match.

    Returns
    -------
    residuals_rad : ndarray, shape (N,)
        Angles in [-pi/2, pi/2], zero for a perfect match, NaN where b1 is the epipole.

    Raises
    ------
    ValueError
        If an array has another shape than (N, 3), or the lengths differ.

    Notes
    -----
    The angle is arctan2(b2.n, |b2 x n|) with the normal n = E b1 / |E b1|. It is valid over the
    whole sphere, and it changes if the views are swapped. Pagani & Stricker (OMNIVIS 2011) compare
    error models on the sphere.
    """
    b2, normals, _, _ = _constraints(E, bearings1, bearings2)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    across = np.linalg.norm(np.cross(b2, normals), axis=1)
    return np.asarray(np.arctan2(np.einsum("ij,ij->i", b2, normals), across))


def sampson_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Return the signed angular distance of each match to the constraint, to first order.

    If both views have isotropic noise of s radians per axis (standard deviation), the standard
    deviation of the residuals is s as well. Arguments and errors are those of `angular_residuals`.

    Notes
    -----
    The residual is C / sqrt(|grad1 C|^2 + |grad2 C|^2) with C = b2^T E b1. The gradients lie in the
    tangent planes of the sphere, so that their sum under the root is
    |E^T b2|^2 + |E b1|^2 - 2 C^2.
    """
    _, normals2, normals1, C = _constraints(E, bearings1, bearings2)
    squared = (normals1**2).sum(axis=1) + (normals2**2).sum(axis=1) - 2.0 * C**2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(C / np.sqrt(squared))


def solarte2021_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Return the residuals of eq. 13 as the authors' code computes them, with norms of all matches.

    They are about the sine of eq. 13 divided by N. The thresholds of the paper's Table 4 are
    thresholds of this residual; N times such a threshold is an angle in radians. Arguments and
    errors are those of `angular_residuals`; rows with NaN are left out of the norms.

    Notes
    -----
    The residual is b2^T E b1 / (|B2|_F |B1 E^T|_F) with the Frobenius norms of all bearings and of
    all normals, where eq. 13 has the norms of one match. The authors' code takes the absolute
    value.
    """
    b2, normals, _, C = _constraints(E, bearings1, bearings2)
    usable = np.isfinite(normals).all(axis=1) & np.isfinite(b2).all(axis=1)
    norms = np.linalg.norm(b2[usable]) * np.linalg.norm(normals[usable])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(C / norms)


def tangent_sampson_residuals(
    E: ArrayLike,
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    jacobians1: ArrayLike,
    jacobians2: ArrayLike,
) -> Array:
    """Return the signed distance of each match to the constraint in pixels, to first order.

    ``jacobians1`` and ``jacobians2``, both (N, 3, 2), are the derivatives of the bearings by their
    pixels, as the ``bearing_jacobians`` of any central camera returns them. The other arguments and
    the errors are those of `angular_residuals`.

    Notes
    -----
    Terekhov & Larsson, "Tangent Sampson error", ICCV 2023.
    """
    _, normals2, normals1, C = _constraints(E, bearings1, bearings2)
    J1 = jacobians_array(jacobians1, len(C), "jacobians1")
    J2 = jacobians_array(jacobians2, len(C), "jacobians2")
    assert J1 is not None and J2 is not None  # given above
    gradient1 = np.einsum("nij,ni->nj", J1, normals1)
    gradient2 = np.einsum("nij,ni->nj", J2, normals2)
    squared = (gradient1**2).sum(axis=1) + (gradient2**2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(C / np.sqrt(squared))


def pose_residuals(
    cam2_from_cam1: Pose,
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    residual: str = "sampson",
    jacobians1: ArrayLike | None = None,
    jacobians2: ArrayLike | None = None,
) -> Array:
    """Return the named residual of every match under a pose, shape (N,).

    It is "paper" (sines), "angular" or "sampson" (radians), "tangent_sampson" (pixels), which alone
    needs Jacobians, or "solarte2021". The arguments are those of the function of that name, with a
    pose x2 = R x1 + t in place of E.

    Raises
    ------
    ValueError
        If the name is unknown, Jacobians are missing, or an array has the wrong shape.
    """
    E = essential_from_pose(cam2_from_cam1)
    if residual == "tangent_sampson":
        if jacobians1 is None or jacobians2 is None:
            raise ValueError("residual tangent_sampson needs jacobians1 and jacobians2")
        return tangent_sampson_residuals(E, bearings1, bearings2, jacobians1, jacobians2)
    functions = {
        "paper": paper_residuals,
        "angular": angular_residuals,
        "sampson": sampson_residuals,
        "solarte2021": solarte2021_residuals,
    }
    if residual not in functions:
        names = ", ".join((*RESIDUALS, "solarte2021"))
        raise ValueError(f"residual must be one of {names}, got {residual!r}")
    return functions[residual](E, bearings1, bearings2)


def tangent_basis(translation: ArrayLike) -> Array:
    """Return the matrix B (3, 2) of two unit tangents of the sphere at a unit direction t (3,).

    Its first column is the coordinate axis that is least aligned with t, projected on the tangent
    plane and scaled to unit length; the second is t x first.
    """
    t = np.asarray(translation, dtype=np.float64)
    axis = int(np.argmin(np.abs(t)))
    first = np.eye(3)[axis] - t[axis] * t
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(t, first)], axis=1)


def residual_jacobians(
    cam2_from_cam1: Pose, bearings1: ArrayLike, bearings2: ArrayLike, residual: str = "sampson"
) -> Array:
    """Return the derivatives (N, 5) of the named residual by the five parameters of the pose.

    These are w (three columns) and d (two), where R' = exp([w]x) R and t' = (t + B d) / |t + B d|
    with B from `tangent_basis`. The arguments are those of `pose_residuals`, with |t| = 1; the
    residual is "paper", "angular", "sampson" or "solarte2021".

    Raises
    ------
    ValueError
        If the name is unknown, an array has another shape than (N, 3), or the lengths differ.

    Notes
    -----
    With a = R b1, b = b2 and C = t.(a x b) the residual is C / sqrt(D), where dC/dw = a x (b x t)
    and dC/dt = a x b. D is 1 - (t.a)^2; "sampson" adds 1 - (t.b)^2 - 2 C^2. For "solarte2021" D is
    N times the sum of 1 - (t.a)^2 over all N matches without NaN.
    """
    if residual not in ("paper", "angular", "sampson", "solarte2021"):
        raise ValueError(
            f"residual must be paper, angular, sampson or solarte2021, got {residual!r}"
        )
    b1, b = bearing_pair(bearings1, bearings2)
    t = checked_pose(cam2_from_cam1).translation
    a = b1 @ cam2_from_cam1.rotation.T
    ta, tb = (a @ t)[:, None], (b @ t)[:, None]
    C_by_a, C_by_t = np.cross(b, t), np.cross(a, b)
    C = (C_by_t @ t)[:, None]
    # |t x a|^2 equals 1 - (t.a)^2 and loses no digits near the epipole.
    D, half_by_a, half_by_t = (np.cross(t, a) ** 2).sum(axis=1)[:, None], -ta * t, -ta * a
    if residual == "sampson":
        D = D + 1.0 - tb**2 - 2.0 * C**2
        half_by_a = half_by_a - 2.0 * C * C_by_a
        half_by_t = half_by_t - tb * b - 2.0 * C * C_by_t
    half_by_w = np.cross(a, half_by_a)
    if residual == "solarte2021":
        usable = np.isfinite(C[:, 0])
        num = float(usable.sum())
        D, half_by_w, half_by_t = (
            num * x[usable].sum(axis=0, keepdims=True) for x in (D, half_by_w, half_by_t)
        )
    D = np.maximum(D, 1e-20)  # for a bearing in the epipole, as in the native core
    by_w = np.cross(a, C_by_a) - C / D * half_by_w
    by_d = (C_by_t - C / D * half_by_t) @ tangent_basis(t)
    jacobians = np.hstack([by_w, by_d]) / np.sqrt(D)
    if residual == "angular":
        jacobians = jacobians / np.sqrt(1.0 - C**2 / D)
    return np.asarray(jacobians)


def _constraints(
    E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike
) -> tuple[Array, Array, Array, Array]:
    """Return b2, the normals E b1 and E^T b2, and C = b2^T E b1 of each match."""
    b1, b2 = bearing_pair(bearings1, bearings2)
    E = np.asarray(E, dtype=np.float64)
    normals2 = b1 @ E.T
    return b2, normals2, b2 @ E, np.einsum("ij,ij->i", b2, normals2)
