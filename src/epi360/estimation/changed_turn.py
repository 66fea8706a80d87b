# SPDX-License-Identifier: BSD-3-Clause
"""A rotation and scales of the cameras' angles from the same matches.

If a lens is taken for a narrower or wider one, then matches of a camera that has only turned agree
with a translation that it never made: much of what a wrong angle does looks like a step ahead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.changed_angles import PairOfAngles
from epi360.epipolar.essential import skew
from epi360.estimation.angle_changes import LARGEST_CHANGE, SMALLEST_NOISE_RAD
from epi360.poses import rotation_from_vector

Array = NDArray[np.float64]

_NUM_STEPS, _ANNEALED = 14, 10  # all, and those of a wider loss
_REACH, _WIDEST = 3.0, 40.0  # of the last loss, in noise, and how much wider the first one is
_MOST_MATCHES = 300


def changed_by_a_turn(
    rotation: Array, bearings: tuple[Array, Array], cameras: tuple[Camera, Camera], noise_deg: float
) -> Array | None:
    """Return the changes of the angles with which the camera has only turned.

    ``rotation`` is near the true one, and ``bearings``, (N, 3) each, are the inliers of a pose with
    residuals of ``noise_deg``. The changes are those of `PairOfAngles`, the curves of lenses
    included; None if no rotation fits, or only with a change of ``LARGEST_CHANGE``.

    Notes
    -----
    Gauss-Newton steps on R b1 - b2 under a Geman-McClure loss whose scale falls from 120 to 3
    noises.
    """
    some = slice(None, None, 1 + len(bearings[0]) // _MOST_MATCHES)
    angles = PairOfAngles.of(cameras, (bearings[0][some], bearings[1][some]), is_curved=True)
    changes, noise = np.zeros(len(angles.names)), max(np.radians(noise_deg), SMALLEST_NOISE_RAD)
    own1, own2 = angles.columns
    for step in range(_NUM_STEPS):
        seen1, seen2 = angles.changed(changes)
        turned = seen1.bearings @ rotation.T
        apart = turned - seen2.bearings
        reach = _REACH * noise * max(1.0, _WIDEST ** (1.0 - step / _ANNEALED))
        weights = 1.0 / (1.0 + 0.5 * np.sum(apart**2, axis=1) / reach**2) ** 2
        J = np.zeros((len(apart), 3, 3 + len(changes)))
        J[:, :, :3] = [-skew(each) for each in turned]
        J[:, :, 3:][:, :, own1] += np.einsum("ij,njk->nik", rotation, seen1.by_changes)
        J[:, :, 3:][:, :, own2] -= seen2.by_changes
        information = np.einsum("n,nij,nik->jk", weights, J, J)
        pull = np.einsum("n,nij,ni->j", weights, J, apart)
        move = -np.linalg.pinv(information, hermitian=True) @ pull
        rotation = rotation_from_vector(move[:3]) @ rotation
        changes = np.clip(changes + move[3:], -LARGEST_CHANGE, LARGEST_CHANGE)
    fits = np.median(np.sum(apart**2, axis=1)) < 2.0 * reach**2
    return changes if fits and (np.abs(changes) < LARGEST_CHANGE).all() else None
