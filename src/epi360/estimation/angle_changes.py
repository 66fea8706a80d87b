# SPDX-License-Identifier: BSD-3-Clause
"""Pose, or rotation, and scales of the cameras' angles from the same matches.

A lens whose field of view is not known exactly, a panorama that was cropped or stretched: then all
bearings are wrong together, the pose is biased, and its residuals hardly show it. But beside the
five numbers of a pose matches determine what the angles of the images must be multiplied by.

And if a lens is taken for a narrower or wider one, matches of a camera that has only turned agree
with a translation that it never made: much of what a wrong angle does looks like a step ahead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360 import _core
from epi360.cameras import Camera
from epi360.cameras.changed_angles import changes_of, models_of
from epi360.epipolar.residuals import tangent_basis
from epi360.estimation.covariance import shared_error_covariance
from epi360.poses import Pose

Array = NDArray[np.float64]

LARGEST_CHANGE = 0.35  # no camera is so unknown
SMALLEST_NOISE_RAD = 1e-9  # exact matches have none
_MOST_MATCHES, MOST_OF_TURN = 2000, 300  # more tell nothing beside what they are wrong by together
REACH = 3.0  # of the last loss, in noise
_SHARED = 1.0  # least standard deviation of what neighbours share, in noise, as for image pairs
_SINGULAR = 1e12  # condition of normal equations that determine no change


class AngleChange(NamedTuple):
    """What would have to be multiplied by 1 + ``change``, with its standard deviation.

    ``direction`` is "radial", the angle from the optical axis, or "focal", the tangent of that
    angle, or "curve" or "edge", by which times its square or fourth power in radians that angle is
    larger; or "horizontal" or "vertical", longitude and latitude of a panorama, or "middle", whose
    latitude is lower by ``change`` radians. ``view`` is 1 or 2, or 0 for one camera in both views.
    """

    view: int
    direction: str
    change: float
    sigma: float


@dataclass(frozen=True)
class ChangedAngles:
    """The changes with which the matches agree best, the pose with these, and what both gain.

    ``gain`` is that of the robust log-likelihood of the matches that agreed with the pose and the
    changes at the start: among wrong matches, other angles always find some that agree.
    """

    names: tuple[tuple[int, str], ...]
    sizes: Array
    cam2_from_cam1: Pose
    gain: float
    _fitted: FittedMatches

    @property
    def residuals(self) -> Array:
        """Residuals (N,) of the matches that were fitted, in radians."""
        return self._fitted.residuals

    @cached_property
    def changes(self) -> tuple[AngleChange, ...]:
        """The changes with their standard deviations, NaN where the matches determine none."""
        sigmas = self._fitted.sigmas_of_changes()
        found = zip(self.names, self.sizes.tolist(), sigmas.tolist(), strict=True)
        return tuple(AngleChange(*name, *numbers) for name, *numbers in found)

    def pose_covariance(self, translation_basis: Array) -> Array:
        """Covariance (5, 5) of the pose because the changes are uncertain, in such a basis."""
        covariance = self._fitted.pose_covariance_of_changes()
        other_basis = tangent_basis(self.cam2_from_cam1.translation)
        to_basis = np.eye(5)
        to_basis[3:, 3:] = translation_basis.T @ other_basis
        return np.asarray(to_basis @ covariance @ to_basis.T)


class FittedMatches(NamedTuple):
    """Residuals (N,) at the end of a fit and their derivatives, in radians.

    ``J`` (N, 5 + k) by the pose and the changes, ``gradients`` (N, 3) by the ``bearings`` (N, 3) of
    either view. ``noise`` is the standard deviation of the residuals of inliers.
    """

    residuals: Array
    J: Array
    gradients: tuple[Array, Array]
    bearings: tuple[Array, Array]
    noise: float

    def sigmas_of_changes(self) -> Array:
        """Standard deviations (k,): those of an M-estimator, and what neighbours share."""
        variances = np.diag(self._covariance_of_changes())
        return np.sqrt(np.where(variances > 0.0, variances, np.nan))

    def pose_covariance_of_changes(self) -> Array:
        """Covariance (5, 5) of the pose because the changes are uncertain."""
        information = self._information()
        moved = np.linalg.pinv(information[:5, :5], hermitian=True) @ information[:5, 5:]
        return np.asarray(moved @ self._covariance_of_changes() @ moved.T)

    def _weights(self) -> Array:
        return 1.0 / (1.0 + (self.residuals / (REACH * self.noise)) ** 2) ** 2

    def _information(self) -> Array:
        return np.asarray((self.J.T * self._weights()) @ self.J)

    def _covariance_of_changes(self) -> Array:
        """Covariance (k, k), NaN where the matches determine no change."""
        num_changes = self.J.shape[1] - 5
        information = self._information()
        if not np.linalg.cond(information) < _SINGULAR:
            return np.full((num_changes, num_changes), np.nan)
        inverse = np.linalg.pinv(information, hermitian=True)
        pulls = self.J.T * (self._weights() * self.residuals)
        alone = inverse @ (pulls @ pulls.T) @ inverse
        return np.asarray((alone + self._shared_error())[5:, 5:])

    def _shared_error(self) -> Array:
        """Covariance of what neighbouring inliers are wrong by together."""
        agree = np.abs(self.residuals) < REACH * self.noise
        first, second = self.bearings
        by_first, by_second = self.gradients
        return shared_error_covariance(
            (first[agree], second[agree]),
            (by_first[agree], by_second[agree]),
            self.residuals[agree],
            self.J[agree],
            scale=self.noise,
            least=_SHARED,
        )


def robust_loss(residuals: Array, noise: float) -> Array:
    """Geman-McClure loss of residuals (N,), whose scale is 3 noises; both in radians."""
    squares = (residuals / (REACH * noise)) ** 2
    return np.asarray(0.5 * REACH**2 * squares / (1.0 + squares))


def robust_gain(before: Array, after: Array, noise_deg: float) -> float:
    """Robust log-likelihood that residuals (N,) in radians gain, but for those that are NaN."""
    noise = noise_in_radians(noise_deg)
    return float(np.nansum(robust_loss(before, noise) - robust_loss(after, noise)))


def noise_in_radians(noise_deg: float) -> float:
    """Noise in radians; exact matches have the smallest one."""
    return max(float(np.radians(noise_deg)), SMALLEST_NOISE_RAD)


def fit_angle_changes(
    cam2_from_cam1: Pose,
    bearings: tuple[Array, Array],
    cameras: tuple[Camera, Camera],
    noise_deg: float,
    *,
    only: int = 0,
    is_curved: bool = False,
    start: Array | None = None,
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
    only : int
        1 or 2 if nothing changes in the other view.
    is_curved : bool
        Whether the curves of lenses change too.
    start : ndarray, shape (k,), optional
        Changes that the pose was estimated with; default: none.

    Notes
    -----
    Gauss-Newton steps under a Geman-McClure loss whose scale falls from 12 to 3 noises. The
    residual is the tangent Sampson error (Terekhov and Larsson, ICCV 2023) in the angles as they
    were measured, so that smaller angles do not make smaller residuals. The standard deviations are
    those of an M-estimator (Huber 1981) and of an error as large as the noise that neighbouring
    matches share, `shared_error_covariance`. Of many matches about a thousand are looked at, evenly
    spaced.
    """
    known = np.isfinite(bearings[0]).all(axis=1) & np.isfinite(bearings[1]).all(axis=1)
    some = np.flatnonzero(known)
    some = some[:: 1 + len(some) // _MOST_MATCHES]
    models, is_one = models_of(cameras, is_curved=is_curved, only=only)
    noise = noise_in_radians(noise_deg)
    names, _ = changes_of(models, is_one)
    translation = cam2_from_cam1.translation
    R, t, sizes, gain, residuals, J, gradients, changed = _core.fit_angle_changes(
        bearings[0][some],
        bearings[1][some],
        *models,
        is_one,
        cam2_from_cam1.rotation,
        translation / np.linalg.norm(translation),
        np.zeros(len(names)) if start is None else start,
        noise,
    )
    fitted = FittedMatches(residuals, J, gradients, changed, noise)
    return ChangedAngles(names, sizes, Pose(R, t), gain, fitted)


def changed_by_a_turn(
    rotation: Array,
    bearings: tuple[Array, Array],
    cameras: tuple[Camera, Camera],
    noise_deg: float,
    *,
    only: int = 0,
    is_curved: bool = True,
) -> Array | None:
    """Return the changes of the angles with which the camera has only turned.

    ``rotation`` is near the true one, and ``bearings``, (N, 3) each, are the inliers of a pose with
    residuals of ``noise_deg``. The changes are those of `PairOfAngles`, the curves of lenses
    included unless ``is_curved`` is false, or of one view ``only``; None if no rotation fits, or
    only with a change of ``LARGEST_CHANGE``.

    Notes
    -----
    Gauss-Newton steps on R b1 - b2 under a Geman-McClure loss whose scale falls from 120 to 3
    noises.
    """
    some = slice(None, None, 1 + len(bearings[0]) // MOST_OF_TURN)
    models, is_one = models_of(cameras, is_curved=is_curved, only=only)
    noise = noise_in_radians(noise_deg)
    return _core.changed_by_a_turn(
        np.ascontiguousarray(bearings[0][some]),
        np.ascontiguousarray(bearings[1][some]),
        *models,
        is_one,
        rotation,
        noise,
    )
