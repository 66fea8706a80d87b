# SPDX-License-Identifier: BSD-3-Clause
"""How far a match is from the epipolar constraint: every residual and its Jacobian."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair, jacobians_array
from epi360.epipolar.essential import essential_from_pose
from epi360.poses import Pose

Array = NDArray[np.float64]

RESIDUALS = ("paper", "angular", "sampson", "tangent_sampson")  # those of one match alone


def paper_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Signed sine of the angle between each bearing of view 2 and its epipolar plane (eq. 13).

    Parameters
    ----------
    E : array_like, shape (3, 3)
        Essential matrix.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.

    Returns
    -------
    residuals : ndarray, shape (N,)
        In [-1, 1]; the paper prints the absolute value.

    Raises
    ------
    ValueError
        If the bearings are no valid pair.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    normals = b1 @ np.asarray(E, dtype=np.float64).T
    with np.errstate(invalid="ignore"):
        return np.asarray(np.einsum("ij,ij->i", b2, normals) / np.linalg.norm(normals, axis=1))


def angular_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Signed angle between each bearing of view 2 and its epipolar plane.

    Parameters
    ----------
    E : array_like, shape (3, 3)
        Essential matrix.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.

    Returns
    -------
    residuals_rad : ndarray, shape (N,)
        In [-pi/2, pi/2]; zero for a perfect match; NaN where b1 is the epipole.

    Raises
    ------
    ValueError
        If the bearings are no valid pair.

    Notes
    -----
    arctan2(b2.n, |b2 x n|) with the normal n = E b1 / |E b1|: valid over the whole sphere, not
    symmetric in the views. Pagani & Stricker (OMNIVIS 2011) compare error models on the sphere.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    normals = b1 @ np.asarray(E, dtype=np.float64).T
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    across = np.linalg.norm(np.cross(b2, normals), axis=1)
    return np.asarray(np.arctan2(np.einsum("ij,ij->i", b2, normals), across))


def sampson_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Signed first-order angular distance of each match to the epipolar constraint.

    Parameters
    ----------
    E : array_like, shape (3, 3)
        Essential matrix.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.

    Returns
    -------
    residuals_rad : ndarray, shape (N,)
        With isotropic noise of standard deviation s (radians, per axis) in both views their
        standard deviation is s.

    Raises
    ------
    ValueError
        If the bearings are no valid pair.

    Notes
    -----
    C / sqrt(|grad1 C|^2 + |grad2 C|^2) with C = b2^T E b1 and gradients in the tangent planes of
    the sphere: |E^T b2|^2 + |E b1|^2 - 2 C^2 under the root.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    E = np.asarray(E, dtype=np.float64)
    normals2, normals1 = b1 @ E.T, b2 @ E
    C = np.einsum("ij,ij->i", b2, normals2)
    squared = (normals1**2).sum(axis=1) + (normals2**2).sum(axis=1) - 2.0 * C**2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(C / np.sqrt(squared))


def solarte2021_residuals(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Array:
    """Signed algebraic errors over norms of the whole arrays: eq. 13 as the authors' code has it.

    Parameters
    ----------
    E : array_like, shape (3, 3)
        Essential matrix.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match. Rows with NaN do not count in the norms.

    Returns
    -------
    residuals : ndarray, shape (N,)
        About the sine of eq. 13 divided by N: the thresholds of the paper's Table 4 belong to it,
        and N times a threshold is an angle in radians.

    Raises
    ------
    ValueError
        If the bearings are no valid pair.

    Notes
    -----
    b2^T E b1 / (|B2|_F |B1 E^T|_F) with the Frobenius norms of all bearings and of all normals,
    where eq. 13 has those of one match. The authors' code takes the absolute value.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    normals = b1 @ np.asarray(E, dtype=np.float64).T
    usable = np.isfinite(normals).all(axis=1) & np.isfinite(b2).all(axis=1)
    norms = np.linalg.norm(b2[usable]) * np.linalg.norm(normals[usable])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.einsum("ij,ij->i", b2, normals) / norms)


def tangent_sampson_residuals(
    E: ArrayLike,
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    jacobians1: ArrayLike,
    jacobians2: ArrayLike,
) -> Array:
    """Signed first-order distance of each match to the constraint, in pixels of any camera.

    Parameters
    ----------
    E : array_like, shape (3, 3)
        Essential matrix.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.
    jacobians1, jacobians2 : array_like, shape (N, 3, 2)
        Derivative of each bearing by its pixel (``camera.bearing_jacobians``).

    Returns
    -------
    residuals_px : ndarray, shape (N,)
        Pixels where the Jacobians are per pixel.

    Raises
    ------
    ValueError
        If an array has the wrong shape.

    Notes
    -----
    Terekhov & Larsson, "Tangent Sampson error", ICCV 2023.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    J1 = jacobians_array(jacobians1, len(b1), "jacobians1")
    J2 = jacobians_array(jacobians2, len(b1), "jacobians2")
    E = np.asarray(E, dtype=np.float64)
    normals2, normals1 = b1 @ E.T, b2 @ E
    assert J1 is not None and J2 is not None  # given above
    gradient1 = np.einsum("nij,ni->nj", J1, normals1)
    gradient2 = np.einsum("nij,ni->nj", J2, normals2)
    squared = (gradient1**2).sum(axis=1) + (gradient2**2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.einsum("ij,ij->i", b2, normals2) / np.sqrt(squared))


def pose_residuals(
    cam2_from_cam1: Pose,
    bearings1: ArrayLike,
    bearings2: ArrayLike,
    residual: str = "sampson",
    jacobians1: ArrayLike | None = None,
    jacobians2: ArrayLike | None = None,
) -> Array:
    """Return one residual of every match under a pose, by name.

    Parameters
    ----------
    cam2_from_cam1 : Pose
        x2 = R x1 + t.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.
    residual : str
        "paper", "angular", "sampson", "tangent_sampson" or "solarte2021".
    jacobians1, jacobians2 : array_like, shape (N, 3, 2), optional
        For "tangent_sampson".

    Raises
    ------
    ValueError
        If the name is unknown, or Jacobians are missing.
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
    """Return B: two unit tangents of the sphere at a direction, which complete it to a basis.

    Parameters
    ----------
    translation : array_like, shape (3,)
        Unit direction t.

    Returns
    -------
    basis : ndarray, shape (3, 2)
        First column: the coordinate axis least aligned with t, projected; second: t x first.
    """
    t = np.asarray(translation, dtype=np.float64)
    axis = int(np.argmin(np.abs(t)))
    first = np.eye(3)[axis] - t[axis] * t
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(t, first)], axis=1)


def residual_jacobians(
    cam2_from_cam1: Pose, bearings1: ArrayLike, bearings2: ArrayLike, residual: str = "sampson"
) -> Array:
    """Return the derivatives of a residual by the pose's five parameters.

    Parameters
    ----------
    cam2_from_cam1 : Pose
        With unit translation.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.
    residual : str
        "paper", "angular", "sampson" or "solarte2021".

    Returns
    -------
    jacobians : ndarray, shape (N, 5)
        By w and d, where R' = exp([w]x) R and t' = (t + B d) / |.|, B from ``tangent_basis``.

    Raises
    ------
    ValueError
        If the name is unknown.

    Notes
    -----
    With a = R b1, b = b2, C = t.(a x b) and residual C / sqrt(D): dC/dw = a x (b x t),
    dC/dt = a x b, and D = 1 - (t.a)^2, for Sampson also + 1 - (t.b)^2 - 2 C^2. For "solarte2021"
    D is N times the sum of 1 - (t.a)^2 over all N matches (those without NaN).
    """
    if residual not in ("paper", "angular", "sampson", "solarte2021"):
        raise ValueError(
            f"residual must be paper, angular, sampson or solarte2021, got {residual!r}"
        )
    b1, b = bearing_pair(bearings1, bearings2)
    t = cam2_from_cam1.translation
    a = b1 @ cam2_from_cam1.rotation.T
    ta, tb = (a @ t)[:, None], (b @ t)[:, None]
    C_by_a, C_by_t = np.cross(b, t), np.cross(a, b)
    C = (C_by_t @ t)[:, None]
    # |t x a|^2 is 1 - (t.a)^2 with all of its digits near the epipole.
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
    D = np.maximum(D, 1e-20)  # a bearing in the epipole, as in native/core/residuals/
    by_w = np.cross(a, C_by_a) - C / D * half_by_w
    by_d = (C_by_t - C / D * half_by_t) @ tangent_basis(t)
    jacobians = np.hstack([by_w, by_d]) / np.sqrt(D)
    if residual == "angular":
        jacobians = jacobians / np.sqrt(1.0 - C**2 / D)
    return np.asarray(jacobians)
