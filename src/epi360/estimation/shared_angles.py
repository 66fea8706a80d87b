# SPDX-License-Identifier: BSD-3-Clause
"""Other angles of cameras on which the matches of many pairs agree.

What `angle_search` asks one pair is asked here of all pairs that some cameras took: each has a pose
of its own, the changes of the angles are those of the cameras. Many pairs tell far more than one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.changed_angles import Direction, with_curves
from epi360.estimation.angle_changes import AngleChange
from epi360.estimation.angle_search import least_change, most_change
from epi360.estimation.shared_angles_fit import (
    Estimate,
    PosedMatches,
    SharedFit,
    SharedProblem,
)

Array = NDArray[np.float64]

_SHARE_OF_CURVES = 0.2  # of the least gain
_LEAST_DEVIATIONS = 5.0  # of a change that is clear
_LEAST_SHARE = 0.6  # of the pairs must gain; wrong poses do not
# Many pairs may say more than one does; larger changes are no small errors of a lens.
_MOST_CHANGE_OF_LENS = 0.45
_AT_POLE, _NEAR_POLE = 1e-6, np.radians(1.8)


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
    straight = SharedProblem(matched, cameras, is_bent=False)
    bent = SharedProblem(matched, cameras, is_bent=True)
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
    begun_bent = SharedFit(bent.changes_of(with_curves(sizes)), fit.poses, fit.noises)
    later = bent.refined(begun_bent, estimate)
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

    def told(self, problem: SharedProblem, fit: SharedFit) -> SharedAngles:
        """The changes of the fit, or of one in which the ends stay at their poles."""
        blocks = [
            _free_changes(camera, fit.changes[own])
            for camera, own in zip(self.cameras, problem.columns, strict=True)
        ]
        free = block_diag(*blocks)
        if free.shape[1] < len(fit.changes):
            problem = problem.limited_to(free)
            start = free @ np.linalg.lstsq(free, fit.changes, rcond=None)[0]
            fit = problem.refined(fit._replace(changes=start), self.estimate)
        return _told(problem, fit)


def _told(problem: SharedProblem, fit: SharedFit) -> SharedAngles:
    """The changes of each camera, with their standard deviations."""
    found = zip(problem.directions, fit.changes, problem.sigmas(fit), strict=True)
    changes = [
        AngleChange(camera + 1, direction, float(change), float(sigma))
        for (camera, direction), change, sigma in found
    ]
    own = [changes[columns] for columns in problem.columns]
    return SharedAngles(own, problem.gains(fit), problem.cameras)


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


def _most_change(direction: str) -> float:
    is_of_lens = direction in ("radial", "focal", "curve", "edge")
    return _MOST_CHANGE_OF_LENS if is_of_lens else most_change(direction)
