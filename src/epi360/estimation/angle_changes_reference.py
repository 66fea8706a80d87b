# SPDX-License-Identifier: BSD-3-Clause
"""Poses, rotations and changed angles in plain NumPy: the twin of the core's fit.

`estimation.angle_changes` says what is fitted, native/core/angles/angle_fit.cpp is the other half
of the twins.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.changed_angles import PairOfAngles
from epi360.epipolar.essential import skew
from epi360.estimation.angle_changes import LARGEST_CHANGE, REACH, FittedMatches, robust_loss
from epi360.estimation.angle_residuals import linearised, moved
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]

NUM_STEPS, ANNEALED, WIDEST = 9, 6, 4.0  # of a pose: all, and those of a wider loss
NUM_STEPS_OF_TURN, ANNEALED_OF_TURN, WIDEST_OF_TURN = 14, 10, 40.0


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
        return linearised(self._angles, self.changes, self.pose, self._noise)

    def move(self, step: Array) -> None:
        """Move the pose by five numbers and the changes by the others."""
        self.pose = moved(self.pose, step[:5])
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
