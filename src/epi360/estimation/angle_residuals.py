# SPDX-License-Identifier: BSD-3-Clause
"""Residuals of matches, and their derivatives by the pose and by what changes in the angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.changed_angles import PairOfAngles
from epi360.epipolar.essential import essential_from_pose, skew
from epi360.epipolar.residuals import tangent_basis
from epi360.estimation.angle_changes import FittedMatches
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]

_SMALLEST_NORM = 1e-12


def linearised(angles: PairOfAngles, changes: Array, pose: Pose, noise: float) -> FittedMatches:
    """Tangent Sampson errors in the angles as they were measured, and their derivatives.

    ``pose`` has a translation of unit length; ``noise``, of the residuals, is in radians.
    """
    seen1, seen2 = angles.changed(changes)
    E = essential_from_pose(pose)
    t, turned = pose.translation, seen1.bearings @ pose.rotation.T
    normals1, normals2 = seen2.bearings @ E, seen1.bearings @ E.T
    C = np.sum(seen2.bearings * normals2, axis=1)
    measured1 = np.einsum("nij,ni->nj", seen1.by_measured, normals1)
    measured2 = np.einsum("nij,ni->nj", seen2.by_measured, normals2)
    norm = np.sqrt((measured1**2).sum(axis=1) + (measured2**2).sum(axis=1))
    J = np.zeros((len(C), 5 + len(changes)))
    # a x (b x t) and, along each tangent of t, (tangent x a) . b.
    J[:, :3] = (turned @ t)[:, None] * seen2.bearings
    J[:, :3] -= np.sum(turned * seen2.bearings, axis=1)[:, None] * t
    for k, tangent in enumerate(tangent_basis(t).T):
        J[:, 3 + k] = np.sum((turned @ skew(tangent).T) * seen2.bearings, axis=1)
    own1, own2 = angles.columns
    J[:, 5:][:, own1] += np.einsum("nik,ni->nk", seen1.by_changes, normals1)
    J[:, 5:][:, own2] += np.einsum("nik,ni->nk", seen2.by_changes, normals2)
    norm = np.maximum(norm, _SMALLEST_NORM)[:, None]
    gradients = (
        _across(seen1.bearings, normals1) / norm,
        _across(seen2.bearings, normals2) / norm,
    )
    bearings = seen1.bearings, seen2.bearings
    return FittedMatches(C / norm[:, 0], J / norm, gradients, bearings, noise)


def moved(pose: Pose, step: Array) -> Pose:
    """The pose after a step of five numbers: a rotation, and along the tangents of t."""
    rotation = rotation_from_vector(step[:3]) @ pose.rotation
    t = pose.translation + tangent_basis(pose.translation) @ step[3:]
    return Pose(rotation, t / np.linalg.norm(t))


def _across(bearings: Array, vectors: Array) -> Array:
    """The parts of vectors (N, 3) that are tangent to the sphere at bearings (N, 3)."""
    return np.asarray(vectors - np.sum(vectors * bearings, axis=1, keepdims=True) * bearings)
