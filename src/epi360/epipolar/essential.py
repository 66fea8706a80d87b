# SPDX-License-Identifier: BSD-3-Clause
"""The essential matrix, the four poses in it, and the depths of matches along their rays."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearing_pair
from epi360.poses import Pose, checked_pose

Array = NDArray[np.float64]

_LEAST_SINGULAR = 1e-12  # of a rank, beside the largest singular value


def skew(vector: ArrayLike) -> Array:
    """Return [v]x, so that ``skew(v) @ w == np.cross(v, w)``."""
    x, y, z = np.asarray(vector, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def essential_from_pose(cam2_from_cam1: Pose) -> Array:
    """Return E = [t]x R with t scaled to unit length (paper eq. 3); NaN if t is zero."""
    t = checked_pose(cam2_from_cam1).translation
    largest = max(map(abs, t.tolist()))
    if not largest > 0.0:
        return np.full((3, 3), np.nan)
    t = t / largest  # so that squares neither overflow nor vanish
    return skew(t / math.hypot(*t.tolist())) @ cam2_from_cam1.rotation


def project_to_essential(E: ArrayLike) -> Array:
    """Return the matrix with singular values (1, 1, 0) nearest to E in the Frobenius norm.

    Raises
    ------
    ValueError
        If E is not a finite (3, 3) matrix of rank 2 or more.
    """
    U, (largest, second, _), Vt = np.linalg.svd(_matrix(E))
    if not second > _LEAST_SINGULAR * largest:
        raise ValueError("E must have rank 2 or more; [t]x R has rank 2")
    return np.asarray(U @ np.diag([1.0, 1.0, 0.0]) @ Vt)


def decompose_essential(E: ArrayLike) -> tuple[Pose, Pose, Pose, Pose]:
    """Return the four poses (R, t), (R, -t), (R', t), (R', -t) of an essential matrix.

    They have |t| = 1. The matrix may have any scale; `project_to_essential` is applied to it first.

    Raises
    ------
    ValueError
        If E is not a finite (3, 3) matrix of rank 2 or more.

    Notes
    -----
    Horn, "Recovering baseline and orientation from essential matrix", 1990, in the form
    R = cof(E) - [t]x E for a unit t with t^T E = 0. R' is R followed by half a turn about t.
    """
    E = project_to_essential(E)
    columns = [np.cross(E[:, k], E[:, (k + 1) % 3]) for k in range(3)]
    t = max(columns, key=lambda column: float(column @ column))
    t = t / np.linalg.norm(t)
    cofactors = np.stack([np.cross(E[(k + 1) % 3], E[(k + 2) % 3]) for k in range(3)])
    tE = skew(t) @ E
    R1, R2 = _orthonormalised(cofactors - tE), _orthonormalised(cofactors + tE)
    return Pose(R1, t), Pose(R1, -t), Pose(R2, t), Pose(R2, -t)


def kronecker_rows(q1: Array, q2: Array) -> Array:
    """Return A (N, 9) with A vec(E) = 0 for rows of any length: row i is q2 (x) q1."""
    return np.asarray(np.einsum("ni,nj->nij", q2, q1).reshape(-1, 9))


def rank_two(e: Array) -> Array:
    """Return the nearest matrix of rank 2 to the nine numbers of vec(E)."""
    U, s, Vt = np.linalg.svd(e.reshape(3, 3))
    return np.asarray(U @ np.diag([s[0], s[1], 0.0]) @ Vt)


def triangulate(
    bearings1: ArrayLike, bearings2: ArrayLike, cam2_from_cam1: Pose
) -> tuple[Array, Array, Array]:
    """Return the points of matches in the frame of camera 1, and their depths along both rays.

    Parameters
    ----------
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match. A row with NaN gives NaN.
    cam2_from_cam1 : Pose
        Pose with x2 = R x1 + t; points and depths have the unit of t.

    Returns
    -------
    points : ndarray, shape (N, 3)
        Middle of the shortest segment between the two rays, in the frame of camera 1.
    depths1, depths2 : ndarray, shape (N,)
        Distances along the rays. They are negative if the point lies behind the camera, and
        infinite if the rays are parallel.

    Raises
    ------
    ValueError
        If an array has another shape than (N, 3), the lengths differ, or the pose is none.

    Notes
    -----
    The depths are the least-squares solution of depth2 b2 = depth1 R b1 + t. With a = R b1 and
    c = a.b2 they are (c t.b2 - t.a) / (1 - c^2) and (t.b2 - c t.a) / (1 - c^2).
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    pose = checked_pose(cam2_from_cam1)
    R, t = pose.rotation, pose.translation
    a = b1 @ R.T
    sign1, sign2, squared_sine = _depth_terms(a, b2, t)
    with np.errstate(divide="ignore", invalid="ignore"):
        parallel = squared_sine == 0.0
        depths1 = np.where(parallel, np.inf, sign1 / squared_sine)
        depths2 = np.where(parallel, np.inf, sign2 / squared_sine)
        in_camera2 = 0.5 * (depths1[:, None] * a + t + depths2[:, None] * b2)
        points = (in_camera2 - t) @ R
    return points, depths1, depths2


def cheirality_mask(
    bearings1: ArrayLike, bearings2: ArrayLike, cam2_from_cam1: Pose
) -> NDArray[np.bool_]:
    """Return which matches have a positive depth along both rays, shape (N,).

    Arguments and errors are those of `triangulate`; a row with NaN gives False. The sign of z is
    not used, because half of a panorama's scene has z < 0.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    a = b1 @ checked_pose(cam2_from_cam1).rotation.T
    sign1, sign2, _ = _depth_terms(a, b2, cam2_from_cam1.translation)
    return np.asarray((sign1 > 0.0) & (sign2 > 0.0))


def pose_from_essential(E: ArrayLike, bearings1: ArrayLike, bearings2: ArrayLike) -> Pose:
    """Return the one of E's four poses that gives most matches a positive depth in both views.

    Parameters
    ----------
    E : array_like, shape (3, 3)
        Essential matrix in any scale; the pose has |t| = 1.
    bearings1, bearings2 : array_like, shape (N, 3)
        Directions; row i of both is one match.

    Raises
    ------
    ValueError
        If E is not a finite (3, 3) matrix of rank 2 or more, an array of bearings has another shape
        than (N, 3), or the lengths differ.
    """
    b1, b2 = bearing_pair(bearings1, bearings2)
    poses = decompose_essential(E)
    return max(poses, key=lambda pose: int(cheirality_mask(b1, b2, pose).sum()))


def _depth_terms(a: Array, b2: Array, t: Array) -> tuple[Array, Array, Array]:
    cosine = np.einsum("ij,ij->i", a, b2)
    ta, tb = a @ t, b2 @ t
    cross = np.cross(a, b2)
    return cosine * tb - ta, tb - cosine * ta, np.einsum("ij,ij->i", cross, cross)


def _orthonormalised(R: Array) -> Array:
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)


def _matrix(E: ArrayLike) -> Array:
    array = np.asarray(E, dtype=np.float64)
    if array.shape != (3, 3) or not np.isfinite(array).all():
        raise ValueError(f"E must be a finite (3, 3) matrix, got shape {array.shape}")
    return array
