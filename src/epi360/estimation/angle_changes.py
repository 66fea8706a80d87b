# SPDX-License-Identifier: BSD-3-Clause
"""Pose and scales of the cameras' angles from the same matches.

A lens whose field of view is not known exactly, a panorama that was cropped or stretched: then all
bearings are wrong together, the pose is biased, and its residuals hardly show it. But beside the
five numbers of a pose matches determine what the angles of the images must be multiplied by.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.changed_angles import PairOfAngles
from epi360.epipolar.essential import essential_from_pose, skew
from epi360.epipolar.residuals import tangent_basis
from epi360.estimation.covariance import shared_error_covariance
from epi360.poses import Pose, rotation_from_vector

Array = NDArray[np.float64]

LARGEST_CHANGE = 0.25  # no lens is so unknown
SMALLEST_NOISE_RAD = 1e-9  # exact matches have none
_MOST_MATCHES = 2000  # more tell nothing beside what they are wrong by together
_NUM_STEPS, _ANNEALED = 9, 6  # all, and those of a wider loss
_REACH, _WIDEST = 3.0, 4.0  # of the last loss, in noise, and how much wider the first one is
_SHARED = 1.0  # least standard deviation of what neighbours share, in noise, as for image pairs
_SMALLEST_NORM = 1e-12
_SINGULAR = 1e12  # condition of normal equations that determine no change


class AngleChange(NamedTuple):
    """What would have to be multiplied by 1 + ``change``, with its standard deviation.

    ``direction`` is "radial", the angle from the optical axis, or "horizontal" or "vertical",
    longitude and latitude of a panorama; ``view`` is 1 or 2, or 0 for one camera in both views.
    """

    view: int
    direction: str
    change: float
    sigma: float


class ChangedAngles(NamedTuple):
    """The changes with which the matches agree best, the pose with these, and what both gain.

    ``gain`` is that of the robust log-likelihood, over the pose and the angles as they were given.
    """

    changes: tuple[AngleChange, ...]
    cam2_from_cam1: Pose
    gain: float


def fit_angle_changes(
    cam2_from_cam1: Pose,
    bearings: tuple[Array, Array],
    cameras: tuple[Camera, Camera],
    noise_deg: float,
) -> ChangedAngles:
    """Refine a pose together with what the cameras' angles are multiplied by.

    Parameters
    ----------
    cam2_from_cam1 : Pose
        With a translation.
    bearings : tuple of ndarray, (N, 3) each
        Where both views look, wrong matches included, by ``cameras``. Equal cameras have one scale.
    noise_deg : float
        Standard deviation of the Sampson residuals of the inliers.

    Notes
    -----
    Gauss-Newton steps under a Geman-McClure loss whose scale falls from 12 to 3 noises. The
    residual is the tangent Sampson error (Terekhov and Larsson, ICCV 2023) in the angles as they
    were measured, so that smaller angles do not make smaller residuals. The standard deviations are
    those of an M-estimator (Huber 1981) and of an error as large as the noise that neighbouring
    matches share, `shared_error_covariance`. They are NaN where the matches determine no change. Of
    many matches about a thousand are looked at, evenly spaced.
    """
    known = np.isfinite(bearings[0]).all(axis=1) & np.isfinite(bearings[1]).all(axis=1)
    some = np.flatnonzero(known)
    some = some[:: 1 + len(some) // _MOST_MATCHES]
    angles = PairOfAngles.of(cameras, (bearings[0][some], bearings[1][some]))
    fit = _Fit(angles, np.zeros(len(angles.names)), _unit_pose(cam2_from_cam1))
    gain = fit.run(max(float(np.radians(noise_deg)), SMALLEST_NOISE_RAD))
    found = zip(angles.names, fit.changes.tolist(), fit.sigmas.tolist(), strict=True)
    changes = tuple(AngleChange(*name, *numbers) for name, *numbers in found)
    return ChangedAngles(changes, fit.pose, gain)


class _Fit:
    """Pose and changes, refined together."""

    def __init__(self, angles: PairOfAngles, changes: Array, pose: Pose) -> None:
        self._angles = angles
        self.changes, self.pose = changes, pose
        self.sigmas = np.full(len(changes), np.nan)

    def run(self, noise: float) -> float:
        """Take all steps, and return what they gain."""
        loss = self._loss(noise)
        for step in range(_NUM_STEPS):
            wider = max(1.0, _WIDEST - (_WIDEST - 1.0) * step / _ANNEALED)
            residuals, J, *_ = self._linearised()
            ratio = 1.0 + (residuals / (_REACH * wider * noise)) ** 2
            weights = 1.0 / ratio**2
            information = (J * weights[:, None]).T @ J
            inverse = np.linalg.pinv(information, hermitian=True)
            self._move(-inverse @ (J * weights[:, None]).T @ residuals)
        if np.linalg.cond(information) < _SINGULAR:
            pulls = (J * (weights * residuals)[:, None]).T
            alone = inverse @ (pulls @ pulls.T) @ inverse
            variances = np.diag(alone + self._shared_error(noise))[5:]
            self.sigmas = np.sqrt(np.where(variances > 0.0, variances, np.nan))
        return loss - self._loss(noise)

    def _loss(self, noise: float) -> float:
        """Geman-McClure loss of all matches in units of the noise."""
        squares = (self._linearised()[0] / (_REACH * noise)) ** 2
        return float(0.5 * _REACH**2 * np.sum(squares / (1.0 + squares)))

    def _shared_error(self, noise: float) -> Array:
        """Covariance of what neighbouring inliers are wrong by together."""
        residuals, J, gradients, bearings = self._linearised()
        agree = np.abs(residuals) < _REACH * noise
        return shared_error_covariance(
            (bearings[0][agree], bearings[1][agree]),
            (gradients[0][agree], gradients[1][agree]),
            residuals[agree],
            J[agree],
            scale=noise,
            least=_SHARED,
        )

    def _linearised(self) -> tuple[Array, Array, tuple[Array, Array], tuple[Array, Array]]:
        """Residuals (N,), derivatives (N, 5 + k) by pose and changes, (N, 3) by bearings; these."""
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
        norm = np.maximum(norm, _SMALLEST_NORM)[:, None]
        gradients = (
            _across(seen1.bearings, normals1) / norm,
            _across(seen2.bearings, normals2) / norm,
        )
        return C / norm[:, 0], J / norm, gradients, (seen1.bearings, seen2.bearings)

    def _move(self, step: Array) -> None:
        rotation = rotation_from_vector(step[:3]) @ self.pose.rotation
        t = self.pose.translation
        self.pose = _unit_pose(Pose(rotation, t + tangent_basis(t) @ step[3:5]))
        self.changes = np.clip(self.changes + step[5:], -LARGEST_CHANGE, LARGEST_CHANGE)


def _across(bearings: Array, vectors: Array) -> Array:
    """The parts of vectors (N, 3) that are tangent to the sphere at bearings (N, 3)."""
    return np.asarray(vectors - np.sum(vectors * bearings, axis=1, keepdims=True) * bearings)


def _unit_pose(pose: Pose) -> Pose:
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))
