# SPDX-License-Identifier: BSD-3-Clause
"""Other angles of cameras on which the matches of many pairs agree.

What `angle_search` asks one pair is asked here of all pairs that some cameras took: each has a pose
of its own, the changes of the angles are those of the cameras. Many pairs tell far more than one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.changed_angles import FIXED, AngleModel, PairOfAngles
from epi360.estimation.angle_changes import (
    REACH,
    SMALLEST_NOISE_RAD,
    AngleChange,
    robust_loss,
)
from epi360.estimation.angle_residuals import linearised, moved
from epi360.estimation.angle_search import least_change, most_change
from epi360.estimation.result import RelativePoseResult
from epi360.poses import Pose

Array = NDArray[np.float64]
Bearings = tuple[Array, Array]
Estimate = Callable[..., RelativePoseResult]
Direction = tuple[int, str]  # number of a camera, and what changes

_NUM_STEPS, _ANNEALED, _WIDEST = 9, 6, 4.0  # all steps of a fit, and those of a wider loss
_MOST_MATCHES = 500  # of a pair
_MOST_ROUNDS = 10
_SETTLED = 3e-4  # largest change of a round that ends the search
_SHARE_OF_CURVES = 0.2  # of the least gain
_LEAST_DEVIATIONS = 5.0  # of a change that is clear
_LEAST_SHARE = 0.6  # of the pairs must gain; wrong poses do not
# Many pairs may say more than one does; larger changes are no small errors of a lens.
_LARGEST_CHANGE, _MOST_CHANGE_OF_LENS = 0.5, 0.45
_AT_POLE, _NEAR_POLE = 1e-6, np.radians(1.8)


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


class Limits(NamedTuple):
    """Which changes are made: how large, as a share of those worth a word, by how large a gain."""

    share_of_large: float
    gain: float  # of half of the pairs, for each inlier

    def is_clear(self, each: AngleChange) -> bool:
        """Whether a change is large enough, and pairs agree that there is one."""
        size = abs(each.change)
        is_large = size > self.share_of_large * least_change(each.direction)
        return is_large and size > _LEAST_DEVIATIONS * each.sigma


# With right cameras half of the pairs of real folders gain up to 0.03, with angles that are wrong
# by one or two percent 0.16 and more.
OF_GIVEN = Limits(share_of_large=1.0, gain=0.1)
# Of cameras that were changed already.
OF_CHANGED = Limits(share_of_large=0.2, gain=0.005)


class SharedAngles(NamedTuple):
    """What must be changed in the angles of each camera, and what the matches gain by that.

    ``changes`` has one list for each camera, in the order of `AngleModel.directions`; their
    ``view`` is the number of the camera, from 1, and their standard deviations are those by which
    pairs differ. ``gains`` (P,) are those of the robust log-likelihood of each pair, for each of
    its inliers, and ``cameras`` the numbers of the cameras of each pair, from 0.
    """

    changes: list[list[AngleChange]]
    gains: Array
    cameras: list[tuple[int, int]]

    @property
    def sizes(self) -> dict[Direction, float]:
        """The changes by the number of the camera, from 0, and their direction."""
        return {
            (camera, each.direction): each.change
            for camera, changes in enumerate(self.changes)
            for each in changes
        }

    def gain_of(self, camera: int) -> float:
        """What the median pair of a camera gains; NaN where it took none."""
        gains = self._gains_of(camera)
        return float(np.median(gains)) if len(gains) else np.nan

    def is_clear(self, camera: int, limits: Limits) -> bool:
        """Whether the pairs of a camera gain clearly by changes that are large and possible."""
        changes = self.changes[camera]
        return bool(
            any(map(limits.is_clear, changes))
            and all(abs(each.change) < _most_change(each.direction) for each in changes)
            and np.mean(self._gains_of(camera) > 0.0) >= _LEAST_SHARE
            and self.gain_of(camera) > limits.gain
        )

    def _gains_of(self, camera: int) -> Array:
        return self.gains[[camera in pair for pair in self.cameras]]


def fit_shared_angles(
    matched: Sequence[PosedMatches],
    cameras: Sequence[Camera | None],
    estimate: Estimate,
    limits: Limits = OF_GIVEN,
    start: Mapping[Direction, float] | None = None,
) -> SharedAngles:
    """Find the changes of the cameras' angles, and poses of all pairs, that suit all matches best.

    Parameters
    ----------
    matched : sequence of PosedMatches
        Pairs with a pose that is accepted, at least one.
    cameras : sequence of Camera or None
        Those that took their images; None for one that does not change. The curves of lenses change
        too, if that gains clearly.
    estimate : callable
        Robust estimator of the pose of bearings (N, 3) each; it also takes ``max_noise_deg``.
    limits : Limits
        What the changes are worth.
    start : mapping, optional
        Changes to begin with, as `SharedAngles.sizes` has them.

    Raises
    ------
    ValueError
        If no camera may change.

    Notes
    -----
    Gauss-Newton steps on all poses and changes under a Geman-McClure loss whose scale falls from 12
    to 3 noises; the poses are eliminated from the normal equations. Then each pose is estimated
    anew with the angles as they are by then, and so on while the matches gain. The standard
    deviations of the changes are those of a jackknife over pairs, by what each pair pulls at them
    (Efron, The Jackknife, SIAM 1982): what the matches of a pair are wrong by together counts once.
    """
    straight = _Problem(matched, cameras, is_bent=False)
    bent = _Problem(matched, cameras, is_bent=True)
    if not straight.directions:
        raise ValueError("cameras must have one that may change, got None for each")
    begun = {} if start is None else start
    tied = _Tied(cameras, estimate)
    if not begun.keys() <= set(straight.directions):
        return tied.told(bent, bent.refined(bent.begun(begun, estimate), estimate))
    fit = straight.refined(straight.begun(begun, estimate), estimate)
    if bent.directions == straight.directions:
        return tied.told(straight, fit)
    sizes = dict(zip(straight.directions, fit.changes.tolist(), strict=True))
    later = bent.refined(_Fit(bent.changes_of(sizes), fit.poses, fit.noises), estimate)
    if bent.gain(later) > straight.gain(fit) + _SHARE_OF_CURVES * limits.gain:
        return tied.told(bent, later)
    return tied.told(straight, fit)


class _Tied(NamedTuple):
    """What is known of panoramas that end at a pole: they do not go beyond it.

    Where the changes leave an end of a panorama at its pole, or nearly so, the middle moves with
    the height.
    """

    cameras: Sequence[Camera | None]
    estimate: Estimate

    def told(self, problem: _Problem, fit: _Fit) -> SharedAngles:
        """The changes of the fit, or of one in which the ends stay at their poles."""
        blocks = [
            _free_changes(camera, fit.changes[own])
            for camera, own in zip(self.cameras, problem.columns, strict=True)
        ]
        problem.free = block_diag(*blocks)
        if problem.free.shape[1] < len(fit.changes):
            start = problem.free @ np.linalg.lstsq(problem.free, fit.changes, rcond=None)[0]
            fit = problem.refined(fit._replace(changes=start), self.estimate)
        return problem.told(fit)


def _free_changes(camera: Camera | None, changes: Array) -> Array:
    """The combinations (k, q) of the changes (k,) of a camera that may change."""
    if not isinstance(camera, Equirectangular):
        return np.eye(len(changes))
    half, middle = np.radians([camera.vertical_fov_deg / 2.0, -camera.center_latitude_deg])
    ends = np.array([-1.0, 1.0])  # the highest latitude and the lowest one
    room = np.pi / 2.0 - ends * (middle + ends * half)
    left = np.pi / 2.0 - ends * (middle + ends * half * (1.0 + changes[1]) + changes[2])
    stay = (room < _AT_POLE) & (left < _NEAR_POLE)
    free = [[1.0, 0.0, 0.0]]
    if not stay.any():
        free += [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    elif not stay.all():
        free += [[0.0, 1.0, half if stay[0] else -half]]
    return np.transpose(free)


class _Fit(NamedTuple):
    """Changes of all cameras, with the pose and the noise (radians) of each pair."""

    changes: Array
    poses: list[Pose]
    noises: list[float]


class _Pair:
    """Matches of a pair as angles, and what they said with the angles as given."""

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
        self.pose, self.noise = given.cam2_from_cam1, _in_radians(given.noise_deg)
        unchanged = np.zeros(max(each.stop for each in columns))
        self._residuals = linearised(self.some, unchanged, self.pose, self.noise).residuals
        self._num_inliers = max(int(np.sum(np.abs(self._residuals) < REACH * self.noise)), 1)

    def gain(self, residuals: Array, noise: float) -> float:
        """Robust log-likelihood that residuals gain, for each inlier."""
        noise = min(noise, self.noise)
        gained = robust_loss(self._residuals, noise) - robust_loss(residuals, noise)
        return float(gained.sum()) / self._num_inliers


class _Problem:
    """All pairs, and the changes that they share."""

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
        self.free = np.eye(len(self.directions))  # combinations of the changes that may change

    def begun(self, sizes: Mapping[Direction, float], estimate: Estimate) -> _Fit:
        """Poses as they were given, or with some changes of the angles."""
        poses, noises = [pair.pose for pair in self._pairs], [pair.noise for pair in self._pairs]
        fit = _Fit(self.changes_of(sizes), poses, noises)
        return self._estimated(fit, estimate) if sizes else fit

    def changes_of(self, sizes: Mapping[Direction, float]) -> Array:
        """Changes of all cameras; those that are not given are none."""
        return np.array([sizes.get(each, 0.0) for each in self.directions])

    def refined(self, start: _Fit, estimate: Estimate) -> _Fit:
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

    def gain(self, fit: _Fit) -> float:
        """What the median pair gains."""
        return float(np.median(self._gains(fit)))

    def told(self, fit: _Fit) -> SharedAngles:
        """The changes of each camera, with their standard deviations."""
        sigmas = self._sigmas(fit)
        changes = [
            AngleChange(camera + 1, direction, float(change), float(sigma))
            for (camera, direction), change, sigma in zip(
                self.directions, fit.changes, sigmas, strict=True
            )
        ]
        cameras = [pair.cameras for pair in self._pairs]
        return SharedAngles([changes[own] for own in self.columns], self._gains(fit), cameras)

    def _estimated(self, fit: _Fit, estimate: Estimate) -> _Fit:
        """The same with poses that are estimated anew; they stay where none is accepted."""
        poses, noises = list(fit.poses), list(fit.noises)
        for index, pair in enumerate(self._pairs):
            views = pair.every.changed(fit.changes)
            result = estimate(*(view.bearings for view in views), max_noise_deg=pair.max_noise_deg)
            if result.success:
                poses[index], noises[index] = result.cam2_from_cam1, _in_radians(result.noise_deg)
        return _Fit(fit.changes, poses, noises)

    def _together(self, fit: _Fit) -> _Fit:
        """Refine poses and changes together."""
        for step in range(_NUM_STEPS):
            wider = max(1.0, _WIDEST - (_WIDEST - 1.0) * step / _ANNEALED)
            parts = self._eliminated(fit, wider)
            information = self.free.T @ sum(part.information for part in parts) @ self.free
            pull = self.free.T @ sum(part.pull for part in parts)
            move = -self.free @ (np.linalg.pinv(information, hermitian=True) @ pull)
            changes = np.clip(fit.changes + move, -_LARGEST_CHANGE, _LARGEST_CHANGE)
            poses = [
                moved(pose, part.step(move)) for pose, part in zip(fit.poses, parts, strict=True)
            ]
            fit = _Fit(changes, poses, fit.noises)
        return fit

    def _gains(self, fit: _Fit) -> Array:
        return np.array(
            [
                pair.gain(linearised(pair.some, fit.changes, pose, noise).residuals, noise)
                for pair, pose, noise in zip(self._pairs, fit.poses, fit.noises, strict=True)
            ]
        )

    def _sigmas(self, fit: _Fit) -> Array:
        """Standard deviations of the changes, NaN where nothing determines them."""
        parts = self._eliminated(fit, 1.0)
        free = self.free
        information = np.sum([part.information for part in parts], axis=0)
        without = [
            free
            @ np.linalg.pinv(free.T @ (information - part.information) @ free, hermitian=True)
            @ (free.T @ part.pull)
            for part in parts
        ]
        variances = np.sum(np.square(without), axis=0) * (len(parts) - 1) / len(parts)
        return np.sqrt(np.where(variances > 0.0, variances, np.nan))

    def _eliminated(self, fit: _Fit, wider: float) -> list[_Eliminated]:
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


def _most_change(direction: str) -> float:
    is_of_lens = direction in ("radial", "curve", "edge")
    return _MOST_CHANGE_OF_LENS if is_of_lens else most_change(direction)


def _in_radians(noise_deg: float) -> float:
    return max(float(np.radians(noise_deg)), SMALLEST_NOISE_RAD)
