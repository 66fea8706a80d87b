# SPDX-License-Identifier: BSD-3-Clause
"""Poses, rotations and changed angles in plain NumPy: the twin of the core's fit.

`estimation.angle_changes` says what is fitted, native/core/angles/angle_fit.cpp is the other half
of the twins.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.changed_angles import PairOfAngles
from epi360.epipolar.essential import essential_from_pose, skew
from epi360.epipolar.residuals import tangent_basis
from epi360.estimation.angle_changes import LARGEST_CHANGE, REACH, FittedMatches, robust_loss
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]

NUM_STEPS, ANNEALED, WIDEST = 9, 6, 4.0  # of a pose: all, and those of a wider loss
NUM_STEPS_OF_TURN, ANNEALED_OF_TURN, WIDEST_OF_TURN = 14, 10, 40.0
SMALLEST_NORM = 1e-12


class AngleFit:
    """Pose and changes, refined together under a Geman-McClure loss; ``noise`` is in radians."""

    def __init__(self, angles: PairOfAngles, changes: Array, pose: Pose, noise: float) -> None:
        self._angles, self._noise = angles, noise
        self.changes, self.pose = changes, pose

    def run(self) -> float:
        """Take all steps, and return what the matches gain that agreed before."""
        before = self.linearised().residuals
        for step in range(NUM_STEPS):
            wider = max(1.0, WIDEST - (WIDEST - 1.0) * step / ANNEALED)
            at = self.linearised()
            weights = 1.0 / (1.0 + (at.residuals / (REACH * wider * self._noise)) ** 2) ** 2
            information = (at.J.T * weights) @ at.J
            pull = (at.J.T * weights) @ at.residuals
            self.move(-np.linalg.pinv(information, hermitian=True) @ pull)
        after = self.linearised().residuals
        gained = robust_loss(before, self._noise) - robust_loss(after, self._noise)
        return float(np.sum(gained[np.abs(before) < REACH * self._noise]))

    def linearised(self) -> FittedMatches:
        """Residuals and derivatives at the pose and the changes as they are."""
        seen1, seen2 = self._angles.changed(self.changes)
        E = essential_from_pose(self.pose)
        t, turned = self.pose.translation, seen1.bearings @ self.pose.rotation.T
        normals1, normals2 = seen2.bearings @ E, seen1.bearings @ E.T
        C = np.sum(seen2.bearings * normals2, axis=1)
        measured1 = np.einsum("nij,ni->nj", seen1.by_measured, normals1)
        measured2 = np.einsum("nij,ni->nj", seen2.by_measured, normals2)
        norm = np.sqrt((measured1**2).sum(axis=1) + (measured2**2).sum(axis=1))
        J = np.zeros((len(C), 5 + len(self.changes)))
        # a x (b x t) and, along each tangent of t, (tangent x a) . b.
        J[:, :3] = (turned @ t)[:, None] * seen2.bearings
        J[:, :3] -= np.sum(turned * seen2.bearings, axis=1)[:, None] * t
        for k, tangent in enumerate(tangent_basis(t).T):
            J[:, 3 + k] = np.sum((turned @ skew(tangent).T) * seen2.bearings, axis=1)
        own1, own2 = self._angles.columns
        J[:, 5:][:, own1] += np.einsum("nik,ni->nk", seen1.by_changes, normals1)
        J[:, 5:][:, own2] += np.einsum("nik,ni->nk", seen2.by_changes, normals2)
        norm = np.maximum(norm, SMALLEST_NORM)[:, None]
        gradients = (
            _across(seen1.bearings, normals1) / norm,
            _across(seen2.bearings, normals2) / norm,
        )
        bearings = seen1.bearings, seen2.bearings
        return FittedMatches(C / norm[:, 0], J / norm, gradients, bearings, self._noise)

    def move(self, step: Array) -> None:
        """Move the pose by five numbers and the changes by the others."""
        rotation = rotation_from_vector(step[:3]) @ self.pose.rotation
        t = self.pose.translation + tangent_basis(self.pose.translation) @ step[3:5]
        self.pose = Pose(rotation, t / np.linalg.norm(t))
        self.changes = _limited(self.changes + step[5:])


def changed_by_a_turn_reference(
    rotation: Array, angles: PairOfAngles, noise: float
) -> Array | None:
    """Return the changes with which a rotation explains the matches; ``noise`` is in radians."""
    changes, (own1, own2) = np.zeros(len(angles.names)), angles.columns
    for step in range(NUM_STEPS_OF_TURN):
        seen1, seen2 = angles.changed(changes)
        turned = seen1.bearings @ rotation.T
        apart = turned - seen2.bearings
        reach = REACH * noise * max(1.0, WIDEST_OF_TURN ** (1.0 - step / ANNEALED_OF_TURN))
        weights = 1.0 / (1.0 + 0.5 * np.sum(apart**2, axis=1) / reach**2) ** 2
        J = np.zeros((len(apart), 3, 3 + len(changes)))
        J[:, :, :3] = [-skew(each) for each in turned]
        J[:, :, 3:][:, :, own1] += np.einsum("ij,njk->nik", rotation, seen1.by_changes)
        J[:, :, 3:][:, :, own2] -= seen2.by_changes
        information = np.einsum("n,nij,nik->jk", weights, J, J)
        pull = np.einsum("n,nij,ni->j", weights, J, apart)
        move = -np.linalg.pinv(information, hermitian=True) @ pull
        rotation = rotation_from_vector(move[:3]) @ rotation
        changes = _limited(changes + move[3:])
    fits = np.median(np.sum(apart**2, axis=1)) < 2.0 * reach**2
    return changes if fits and (np.abs(changes) < LARGEST_CHANGE).all() else None


def _limited(changes: Array) -> Array:
    return np.clip(changes, -LARGEST_CHANGE, LARGEST_CHANGE)


def _across(bearings: Array, vectors: Array) -> Array:
    """The parts of vectors (N, 3) that are tangent to the sphere at bearings (N, 3)."""
    return np.asarray(vectors - np.sum(vectors * bearings, axis=1, keepdims=True) * bearings)
