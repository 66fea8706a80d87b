# SPDX-License-Identifier: BSD-3-Clause
"""Fit of the poses of many pairs together with the changes of the angles that they share."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.changed_angles import FIXED, AngleModel, Direction, PairOfAngles
from epi360.estimation.angle_changes import REACH, noise_in_radians, robust_loss
from epi360.estimation.angle_residuals import linearised, moved
from epi360.estimation.result import RelativePoseResult
from epi360.poses import Pose

Array = NDArray[np.float64]
Bearings = tuple[Array, Array]
Estimate = Callable[..., RelativePoseResult]

_NUM_STEPS, _ANNEALED, _WIDEST = 9, 6, 4.0  # all steps of a fit, and those of a wider loss
_MOST_MATCHES = 500  # of a pair
_MOST_ROUNDS = 10
_SETTLED = 3e-4  # largest change of a round that ends the search
_LARGEST_CHANGE = 0.5


@dataclass(frozen=True, eq=False)
class PosedMatches:
    """Matches of two images: their cameras by number, bearings (N, 3) each, and what they say.

    The bearings, by the cameras as they are given, are those of all matches, wrong ones included;
    ``noise_deg`` is that of the inliers, as of `RelativePoseResult`, and ``max_noise_deg`` the
    largest one of a pose that is accepted.
    """

    cameras: tuple[int, int]
    bearings: Bearings
    cam2_from_cam1: Pose
    noise_deg: float
    max_noise_deg: float


class SharedFit(NamedTuple):
    """Changes of all cameras, with the pose and the noise (radians) of each pair."""

    changes: Array
    poses: list[Pose]
    noises: list[float]


class _Pair:
    """Matches of a pair as angles, and their residuals from its pose with the angles as given."""

    def __init__(
        self, given: PosedMatches, models: Sequence[AngleModel], columns: Sequence[slice]
    ) -> None:
        known = np.isfinite(given.bearings[0]).all(axis=1)
        rows = np.flatnonzero(known & np.isfinite(given.bearings[1]).all(axis=1))
        some = rows[:: 1 + len(rows) // _MOST_MATCHES]
        self.cameras, self.max_noise_deg = given.cameras, given.max_noise_deg
        own = [models[camera] for camera in given.cameras]
        own_columns = [columns[camera] for camera in given.cameras]
        first, second = given.bearings
        self.every = PairOfAngles.shared(own, own_columns, given.bearings)
        self.some = PairOfAngles.shared(own, own_columns, (first[some], second[some]))
        self.pose, self.noise = given.cam2_from_cam1, noise_in_radians(given.noise_deg)
        unchanged = np.zeros(max(each.stop for each in columns))
        self._residuals = linearised(self.some, unchanged, self.pose, self.noise).residuals
        self._num_inliers = max(int(np.sum(np.abs(self._residuals) < REACH * self.noise)), 1)

    def gain(self, residuals: Array, noise: float) -> float:
        """Robust log-likelihood that residuals gain, for each inlier."""
        noise = min(noise, self.noise)
        gained = robust_loss(self._residuals, noise) - robust_loss(residuals, noise)
        return float(gained.sum()) / self._num_inliers


class SharedProblem:
    """All pairs, and the changes that they share.

    ``directions`` says what they are, and ``columns`` which of them are those of each camera.
    """

    def __init__(
        self, matched: Sequence[PosedMatches], cameras: Sequence[Camera | None], *, is_bent: bool
    ) -> None:
        models = [
            FIXED if camera is None else AngleModel.of(camera, is_bent=is_bent)
            for camera in cameras
        ]
        ends = np.cumsum([len(model.directions) for model in models]).tolist()
        self.columns = [slice(*each) for each in zip([0, *ends], ends, strict=False)]
        self.directions: list[Direction] = [
            (camera, name) for camera, model in enumerate(models) for name in model.directions
        ]
        self._pairs = [_Pair(each, models, self.columns) for each in matched]
        self._free = np.eye(len(self.directions))  # combinations of the changes that may change

    def begun(self, sizes: Mapping[Direction, float], estimate: Estimate) -> SharedFit:
        """Poses as they were given, or with some changes of the angles."""
        poses, noises = [pair.pose for pair in self._pairs], [pair.noise for pair in self._pairs]
        fit = SharedFit(self.changes_of(sizes), poses, noises)
        return self._estimated(fit, estimate) if sizes else fit

    def changes_of(self, sizes: Mapping[Direction, float]) -> Array:
        """Changes of all cameras; those that are not given are none."""
        return np.array([sizes.get(each, 0.0) for each in self.directions])

    def refined(self, start: SharedFit, estimate: Estimate) -> SharedFit:
        """Changes and poses in turn, as long as the pairs gain."""
        fit = self._together(start)
        for _ in range(_MOST_ROUNDS):
            later = self._together(self._estimated(fit, estimate))
            if self.gain(later) < self.gain(fit):
                break
            change = np.abs(later.changes - fit.changes).max()
            fit = later
            if change < _SETTLED:
                break
        return fit

    def gain(self, fit: SharedFit) -> float:
        """What the median pair gains."""
        return float(np.median(self.gains(fit)))

    def limited_to(self, free: Array) -> SharedProblem:
        """The same, where only such combinations (k, q) of the changes may change."""
        limited = copy.copy(self)
        limited._free = free
        return limited

    @property
    def cameras(self) -> list[tuple[int, int]]:
        """Numbers of the cameras of each pair."""
        return [pair.cameras for pair in self._pairs]

    def _estimated(self, fit: SharedFit, estimate: Estimate) -> SharedFit:
        """The same with poses that are estimated anew; they stay where none is accepted."""
        poses, noises = list(fit.poses), list(fit.noises)
        for index, pair in enumerate(self._pairs):
            views = pair.every.changed(fit.changes)
            result = estimate(*(view.bearings for view in views), max_noise_deg=pair.max_noise_deg)
            if result.success:
                poses[index], noises[index] = (
                    result.cam2_from_cam1,
                    noise_in_radians(result.noise_deg),
                )
        return SharedFit(fit.changes, poses, noises)

    def _together(self, fit: SharedFit) -> SharedFit:
        """Refine poses and changes together."""
        for step in range(_NUM_STEPS):
            wider = max(1.0, _WIDEST - (_WIDEST - 1.0) * step / _ANNEALED)
            parts = self._eliminated(fit, wider)
            information = self._free.T @ sum(part.information for part in parts) @ self._free
            pull = self._free.T @ sum(part.pull for part in parts)
            move = -self._free @ (np.linalg.pinv(information, hermitian=True) @ pull)
            changes = np.clip(fit.changes + move, -_LARGEST_CHANGE, _LARGEST_CHANGE)
            poses = [
                moved(pose, part.step(move)) for pose, part in zip(fit.poses, parts, strict=True)
            ]
            fit = SharedFit(changes, poses, fit.noises)
        return fit

    def gains(self, fit: SharedFit) -> Array:
        """What each pair gains, for each of its inliers."""
        return np.array(
            [
                pair.gain(linearised(pair.some, fit.changes, pose, noise).residuals, noise)
                for pair, pose, noise in zip(self._pairs, fit.poses, fit.noises, strict=True)
            ]
        )

    def sigmas(self, fit: SharedFit) -> Array:
        """Standard deviations of the changes, NaN where nothing determines them."""
        parts = self._eliminated(fit, 1.0)
        free = self._free
        information = np.sum([part.information for part in parts], axis=0)
        without = [
            free
            @ np.linalg.pinv(free.T @ (information - part.information) @ free, hermitian=True)
            @ (free.T @ part.pull)
            for part in parts
        ]
        variances = np.sum(np.square(without), axis=0) * (len(parts) - 1) / len(parts)
        return np.sqrt(np.where(variances > 0.0, variances, np.nan))

    def _eliminated(self, fit: SharedFit, wider: float) -> list[_Eliminated]:
        """Normal equations of each pair, under a wider loss than that of the noise."""
        parts = []
        for pair, pose, noise in zip(self._pairs, fit.poses, fit.noises, strict=True):
            at = linearised(pair.some, fit.changes, pose, noise)
            scaled = at.residuals / (REACH * wider * noise)
            weighted = at.J.T / (noise * (1.0 + scaled**2)) ** 2
            parts.append(_Eliminated.of(weighted @ at.J, weighted @ at.residuals))
        return parts


class _Eliminated(NamedTuple):
    """Normal equations of the changes without a pose, and how this moves along."""

    information: Array
    pull: Array
    pose_step: Array
    pose_by_changes: Array

    @classmethod
    def of(cls, information: Array, pull: Array) -> _Eliminated:
        """The equations of pose (5) and changes."""
        inverse = np.linalg.pinv(information[:5, :5], hermitian=True)
        by_changes = inverse @ information[:5, 5:]
        pose_step = inverse @ pull[:5]
        return cls(
            information[5:, 5:] - information[5:, :5] @ by_changes,
            pull[5:] - information[5:, :5] @ pose_step,
            pose_step,
            by_changes,
        )

    def step(self, change: Array) -> Array:
        """What the pose moves by while the changes do so."""
        return -self.pose_step - self.pose_by_changes @ change
