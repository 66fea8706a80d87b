# SPDX-License-Identifier: BSD-3-Clause
"""Search for other angles of the cameras with which more matches agree, and more closely.

With wrong angles the pose is biased, and so are its inliers. So pose and angles are estimated in
turn: the pose by the robust estimator from all matches, with the angles as they are by then, and
both together by a fit from there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.changed_angles import PairOfAngles, changes_of, models_of, with_curves
from epi360.estimation.angle_changes import (
    LARGEST_CHANGE,
    SMALLEST_NOISE_RAD,
    AngleChange,
    ChangedAngles,
    changed_by_a_turn,
    fit_angle_changes,
    robust_gain,
)
from epi360.estimation.copies import Indices
from epi360.estimation.lens_beside_panorama import view_of_lens
from epi360.estimation.result import RelativePoseResult

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Bearings = tuple[Array, Array]
Names = tuple[tuple[int, str], ...]  # view and direction of each change
Estimate = Callable[[Array, Array], RelativePoseResult]

# A change that is worth a word is so large, and so many of its standard deviations; if a factor is
# larger than that of any camera, the search went astray.
LEAST_CHANGE, _MOST_CHANGE, _LEAST_DEVIATIONS = 0.01, 0.3, 3.0
LEAST_MIDDLE_RAD = 0.02  # of the latitude of the middle row
# Gains are of the robust log-likelihood; these are the least ones of former inliers and of all.
_LEAST_GAIN, _LEAST_GAIN_OF_ALL = 8.0, 20.0
# Panoramas, of which more may change, must gain more for each inlier.
_GAIN_OF_PANORAMAS, _GAIN_OF_CURVES = 0.35, 0.1
_GAIN_OF_LENS = 2.0  # for each inlier and a change by one, of a lens beside a panorama
# What a fit from the pose must gain for each inlier to be worth a search; right cameras seldom do.
_GAIN_NEAR, _GAIN_NEAR_OF_PANORAMAS = 0.05, 0.2
# Where that fit goes astray, the panoramas may have lost such a share of their height at one end.
_CUT, _GAIN_OF_CUT = 0.15, 0.1
# No panorama is wider or higher than a sphere, so that few of its key points are beyond one.
MOST_BEYOND = 0.02
_MOST_ROUNDS = 20
# The pose by a wrong focal length is often in a valley of its own.
STARTS_OF_LENS = (0.08, -0.08, 0.16, -0.16)
_GAIN_OF_ROUND = 2.0  # less ends the search
_MOST_LOSS_AT_START = 1.5  # for each inlier
_MOST_MATCHES = 800
# Where there is little parallax, a turn with other angles may explain most of the matches, to such
# a share of the parallax.
_MOST_PARALLAX_DEG, _LEFT_OF_PARALLAX = 25.0, 0.25


class _Better(NamedTuple):
    """What is clearly better than the pose with the angles as given.

    Gains of the former inliers and of all matches, for each inlier; which share of the inliers'
    number is left at least, and of their noise at most.
    """

    former: float
    every: float
    left: float
    noise: float

    def holds(self, former: float, every: float, count: int, left: float, noise: float) -> bool:
        """Whether both gains, of ``count`` inliers, are large enough, and what is left."""
        least_former = max(self.former * count, _LEAST_GAIN if self.former > 0.0 else -np.inf)
        least_of_all = max(self.every * count, _LEAST_GAIN_OF_ALL if self.every > 0.0 else -np.inf)
        return bool(
            former > least_former
            and every > least_of_all
            and left > self.left
            and noise < self.noise
        )


# Of 98 real pairs with good cameras none is better by changes that also move the pose.
_BETTER = (
    _Better(former=0.04, every=0.0, left=0.8, noise=1.0),  # those that agreed agree better
    _Better(former=0.1, every=0.0, left=0.5, noise=1.0),  # clearly so
    _Better(former=-0.1, every=0.25, left=0.9, noise=1.1),  # many more agree
    _Better(former=-np.inf, every=0.1, left=0.9, noise=0.8),  # they agree much more closely
)
# Of one number of a lens that is right within a percent, matches gain up to 0.3 in rendered rooms.
_BETTER_LENS = _Better(former=-np.inf, every=0.5, left=0.7, noise=1.3)


class OtherAngles(NamedTuple):
    """The pose with changed angles, the changes, and the log-likelihood that both gain.

    ``only`` is 1 or 2 if nothing changes in the other view; ``is_curved`` if curves of lenses do.
    """

    answer: RelativePoseResult
    found: ChangedAngles
    gain: float
    only: int
    is_curved: bool

    @property
    def is_possible(self) -> bool:
        """Whether no change is larger than that of any camera."""
        return _are_possible(self.found.names, self.found.sizes)

    def sizes_of(self, view: int) -> Array:
        """All changes (k,) of a view, 1 or 2; none if it stays as it was given."""
        own = [each in (0, view) for each, _ in self.found.names]
        return self.found.sizes[own]

    def clear_changes(self) -> list[AngleChange]:
        """Those of the changes that are worth a word."""
        return [each for each in self.found.changes if is_clear(each)]


def views_that_may_change(cameras: tuple[Camera, Camera]) -> tuple[int, ...]:
    """Both (0), or one alone: of two panoramas either may be cut or stretched.

    Of a lens beside a panorama the lens is seldom known as well.
    """
    if are_panoramas(cameras):
        return (0, 2, 1)
    lens = view_of_lens(cameras)
    return (0,) if lens is None else (lens + 1, 0)


def are_panoramas(cameras: tuple[Camera, Camera]) -> bool:
    """Whether both cameras take panoramas, whole or in part."""
    return all(isinstance(camera, Equirectangular) for camera in cameras)


def find_other_angles(
    given: RelativePoseResult,
    bearings: Bearings,
    distinct: Indices,
    cameras: tuple[Camera, Camera],
    estimate: Estimate,
) -> OtherAngles | None:
    """Return what explains the matches clearly better than a pose with the angles as given.

    ``distinct`` are the rows of ``bearings``, (N, 3) each, that are no copies. Those changes of one
    view must gain clearly more than those of both. Of many matches some hundreds are searched,
    evenly spaced, and what is found in them is tried on all.
    """
    known = distinct[np.isfinite(given.residuals_rad[distinct])]
    some = known[:: 1 + len(known) // _MOST_MATCHES]
    best = _Search(given, bearings, some, cameras, estimate).best()
    if best is None:
        return None
    every = _Search(given, bearings, np.arange(len(bearings[0])), cameras, estimate)
    other = every.from_start(best.found.sizes, best.only, is_curved=best.is_curved)
    return other if other is not None and every.is_better(other) else None


class _Search:
    """Matches of a pair, and the pose that they say with the angles as they were given."""

    def __init__(
        self,
        given: RelativePoseResult,
        bearings: Bearings,
        rows: Indices,
        cameras: tuple[Camera, Camera],
        estimate: Estimate,
    ) -> None:
        self._given, self._cameras, self._estimate = given, cameras, estimate
        self._bearings = bearings[0][rows], bearings[1][rows]
        self._residuals, self._agree = given.residuals_rad[rows], given.inlier_mask[rows]
        self._noise_deg = max(given.noise_deg, float(np.degrees(SMALLEST_NOISE_RAD)))
        self._count = max(int(self._agree.sum()), 1)
        self._are_panoramas = are_panoramas(cameras)
        self._least_gain_near = _GAIN_NEAR_OF_PANORAMAS if self._are_panoramas else _GAIN_NEAR

    def best(self) -> OtherAngles | None:
        """The first that is better from the starts of each view, and of these what gains most."""
        best: OtherAngles | None = None
        for only in views_that_may_change(self._cameras):
            for start in self._starts(only):
                other = self.from_start(start, only)
                if other is None or not self.is_better(other):
                    continue
                if best is None or other.gain > best.gain + _LEAST_GAIN:
                    best = other
                break
        if best is None or self._are_panoramas:
            return best
        return self._with_curves(best)

    def from_start(
        self, changes: Array, only: int, *, is_curved: bool = False
    ) -> OtherAngles | None:
        """Pose and changes in turn, as long as both gain."""
        angles = PairOfAngles.of(self._cameras, self._bearings, is_curved=is_curved, only=only)
        best: OtherAngles | None = None
        for _ in range(_MOST_ROUNDS):
            first, second = angles.changed(changes)
            answer = self._estimate(first.bearings, second.bearings)
            if not answer.success:
                break
            noise_deg = min(self._noise_deg, answer.noise_deg)
            gain = self._gain(answer.residuals_rad, noise_deg)
            least = -_MOST_LOSS_AT_START * self._count if best is None else best.gain
            if gain < least + _GAIN_OF_ROUND:
                break
            found = fit_angle_changes(
                answer.cam2_from_cam1,
                self._bearings,
                self._cameras,
                answer.noise_deg,
                only=only,
                is_curved=is_curved,
                start=changes,
            )
            best = OtherAngles(answer, found, gain, only, is_curved)
            changes = found.sizes
        return best

    def is_better(self, other: OtherAngles) -> bool:
        """Whether former inliers agree better, or many more do, or all do much more closely."""
        count = self._count
        if other.gain < self._least_gain(other) or not (
            other.is_possible and other.clear_changes()
        ):
            return False
        angles = PairOfAngles.of(
            self._cameras, self._bearings, is_curved=other.is_curved, only=other.only
        )
        if angles.share_beyond(other.found.sizes) > MOST_BEYOND:
            return False
        former = self._gain(other.answer.residuals_rad, self._noise_deg, self._agree)
        left = other.answer.num_inliers / count
        noise = other.answer.noise_deg / self._noise_deg
        enough = (*_BETTER, _BETTER_LENS) if self._is_of_lens(other.only) else _BETTER
        return any(each.holds(former, other.gain, count, left, noise) for each in enough)

    def _least_gain(self, other: OtherAngles) -> float:
        """What changes must gain at least, panoramas and lenses beside them more than lenses."""
        lens = view_of_lens(self._cameras)
        if lens is not None:
            largest = np.abs(other.sizes_of(lens + 1)).max(initial=0.0)
            return _GAIN_OF_LENS * float(largest) * self._count
        return _GAIN_OF_PANORAMAS * self._count if self._are_panoramas else 0.0

    def _starts(self, only: int) -> Iterator[Array]:
        """Changes that may be near the true ones, if these are not small."""
        given = self._given
        if self._is_of_lens(only):
            yield from (np.array([change]) for change in STARTS_OF_LENS)
        near = fit_angle_changes(
            given.cam2_from_cam1, self._bearings, self._cameras, given.noise_deg, only=only
        )
        if not _is_large(near.names, near.sizes):
            return
        gain = self._gain(near.residuals, self._noise_deg) / self._count
        if gain > self._least_gain_near:
            yield near.sizes
        if (
            self._are_panoramas
            and gain > _GAIN_OF_CUT
            and not _are_possible(near.names, near.sizes)
        ):
            yield from _cuts(near.names)
        if given.parallax_deg > _MOST_PARALLAX_DEG:
            return
        turned = changed_by_a_turn(
            given.cam2_from_cam1.rotation,
            (self._bearings[0][self._agree], self._bearings[1][self._agree]),
            self._cameras,
            max(given.noise_deg, _LEFT_OF_PARALLAX * given.parallax_deg),
            only=only,
            is_curved=False,
        )
        if turned is not None and _is_large(near.names, turned):
            yield turned

    def _is_of_lens(self, only: int) -> bool:
        """Whether what changes is one lens beside a panorama."""
        return view_of_lens(self._cameras) == only - 1

    def _with_curves(self, straight: OtherAngles) -> OtherAngles:
        """The same, or what is found if the curves of lenses change too, if that gains clearly."""
        models, is_one = models_of(self._cameras, is_curved=True, only=straight.only)
        names, _ = changes_of(models, is_one)
        found = zip(straight.found.names, straight.found.sizes.tolist(), strict=True)
        sizes = with_curves(dict(found))
        start = np.array([sizes.get(name, 0.0) for name in names])
        bent = self.from_start(start, straight.only, is_curved=True)
        least = straight.gain + max(_LEAST_GAIN, _GAIN_OF_CURVES * self._count)
        return bent if bent and bent.gain > least and self.is_better(bent) else straight

    def _gain(self, residuals: Array, noise_deg: float, some: Mask | None = None) -> float:
        """Robust log-likelihood that all matches gain, or some, by such a noise."""
        rows = slice(None) if some is None else some
        return robust_gain(self._residuals[rows], residuals[rows], noise_deg)


def _is_large(names: Names, changes: Array) -> bool:
    """Whether one of the changes would be worth a word."""
    pairs = zip(names, changes.tolist(), strict=True)
    return any(abs(change) > least_change(direction) for (_, direction), change in pairs)


def _are_possible(names: Names, changes: Array) -> bool:
    """Whether no change is larger than that of any camera."""
    pairs = zip(names, changes.tolist(), strict=True)
    return all(abs(change) < most_change(direction) for (_, direction), change in pairs)


def _cuts(names: Names) -> Iterator[Array]:
    """Changes of panoramas of which the lowest or the highest part is missing."""
    for middle in (-np.pi / 2.0, np.pi / 2.0):
        parts = {"horizontal": 0.0, "vertical": -1.0, "middle": middle}
        yield _CUT * np.array([parts[direction] for _, direction in names])


def is_clear(each: AngleChange, deviations: float = _LEAST_DEVIATIONS) -> bool:
    """Whether a change is worth a word, and so many of its standard deviations."""
    size = abs(each.change)
    return size > least_change(each.direction) and size > deviations * each.sigma


def most_change(direction: str) -> float:
    """The largest change of any camera."""
    return LARGEST_CHANGE if direction == "middle" else _MOST_CHANGE


def least_change(direction: str) -> float:
    """The smallest change that is worth a word."""
    return LEAST_MIDDLE_RAD if direction == "middle" else LEAST_CHANGE
