# SPDX-License-Identifier: BSD-3-Clause
"""What the points of a map say of the angles of the camera that sees them.

A pair of views hardly tells a wrong focal length from a step. Points in known places do: with one
that is a percent too long, the camera seems to be a hundredth of their distance nearer, and all of
them agree with that, so that neither noise nor covariance tells. But the focal length with which
they agree best is known to a fraction of a percent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, KannalaBrandt
from epi360.cameras.base import FocalCamera
from epi360.cameras.changed_angles import AngleModel, Angles, angles_of
from epi360.cameras.changed_camera import changed_lens
from epi360.estimation.absolute_covariance import Refined, at_world, refined_pose
from epi360.estimation.absolute_pose_fit import Gravity
from epi360.estimation.absolute_result import AbsolutePoseResult
from epi360.estimation.angle_changes import AngleChange, robust_gain
from epi360.estimation.angle_search import (
    MOST_BEYOND,
    STARTS_OF_LENS,
    is_clear,
    most_change,
)
from epi360.estimation.lens_beside_panorama import FOCAL_SIGMA
from epi360.poses import Pose

Array = NDArray[np.float64]
Estimate = Callable[[Array, Pose | None], AbsolutePoseResult]

_FEWEST_INLIERS = 20
_MOST_ROUNDS, _SETTLED = 6, 5e-4
_SURE = 5.0  # standard deviations
# Of the robust log-likelihood, and of panoramas for each inlier, as in pairs of them.
_CLEAR_GAIN, _GAIN_OF_PANORAMA = 8.0, 0.35
_NEAR = 3.0  # gates, within which matches are refined with the angles
_SAME = 3.0  # standard deviations, up to which changes are the same
_NO_GRAVITY = Gravity(None, np.array([0.0, 1.0, 0.0]), 1.0)


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Bearings (N, 3) by a camera of points (N, 3), and the covariances (N, 3, 3) of these."""

    camera: Camera
    bearings: Array
    points: Array
    covariances: Array

    @property
    def model(self) -> AngleModel:
        """Which angles may change."""
        return AngleModel.of(self.camera)

    @cached_property
    def angles(self) -> Angles:
        """All bearings by the angles that may change."""
        return angles_of(self.model, self.bearings)

    def refined(self, result: AbsolutePoseResult, changes: Array) -> Refined:
        """Pose of the inliers together with the camera's angles, from some changes on."""
        # Those that tell wrong angles are the first to be no inliers.
        near = result.residuals_rad < _NEAR * np.radians(result.inlier_threshold_deg)
        return refined_pose(
            result.cam_from_world,
            self.bearings[near],
            self.points[near],
            self.covariances[near],
            _NO_GRAVITY,
            1.0,
            angles_of(self.model, self.bearings[near]),
            changes,
        )


class AnglesByPoints(NamedTuple):
    """Changes of a camera's angles, the pose with them, and the lens that has them, if any.

    There is none of a panorama, for COLMAP has no camera for a part of one. The changes are
    ``is_certain`` if nothing else explains the points nearly as well.
    """

    changes: tuple[AngleChange, ...]
    answer: AbsolutePoseResult
    camera: Camera | None = None
    is_certain: bool = False

    @property
    def sizes(self) -> Array:
        """The changes (k,)."""
        return np.array([each.change for each in self.changes])

    @property
    def clear(self) -> tuple[AngleChange, ...]:
        """Those of the changes that are worth a word."""
        return tuple(filter(is_clear, self.changes))

    @property
    def is_possible(self) -> bool:
        """Whether some change is worth a word, and none is larger than that of any camera."""
        are_possible = all(abs(each.change) < most_change(each.direction) for each in self.changes)
        return are_possible and len(self.clear) > 0

    def gain_over(self, other: AbsolutePoseResult) -> float:
        """Robust log-likelihood that all matches gain, by the smaller noise of both."""
        after = self.answer.residuals_rad
        if not other.num_inliers:
            before, noise_deg = np.full(len(after), np.pi), self.answer.noise_deg
        else:
            before, noise_deg = other.residuals_rad, min(self.answer.noise_deg, other.noise_deg)
        return robust_gain(before, after, noise_deg)

    def explains_more_than(self, given: AbsolutePoseResult, camera: Camera) -> bool:
        """Whether points agree better than with a pose by the camera as it is.

        Of a lens a sure change must gain something, and another one must be known to a percent and
        gain clearly.
        """
        if not self.is_possible:
            return False
        is_sure = any(is_clear(each, _SURE) for each in self.changes)
        gain = self.gain_over(given)
        if isinstance(camera, FocalCamera):
            is_known = max(each.sigma for each in self.changes) < FOCAL_SIGMA
            return gain > 0.0 if is_sure else is_known and gain > _CLEAR_GAIN
        return is_sure and gain > max(_CLEAR_GAIN, _GAIN_OF_PANORAMA * given.num_inliers)

    def is_near(self, changes: Array) -> bool:
        """Whether other changes (k,) are the same, but for what these are uncertain by."""
        most = [_SAME * each.sigma for each in self.changes]
        return bool((np.abs(changes - self.sizes) <= most).all())


def angles_by_points(
    given: AbsolutePoseResult, seen: SeenPoints, estimate: Estimate
) -> AnglesByPoints | None:
    """Return the angles with which points agree better; None if there are none.

    ``given`` is what ``estimate`` finds of the bearings as they are. Pose and angles are estimated
    in turn, the pose from all matches, the angles from its inliers. If that says other angles of a
    lens, or there is no pose, it is also tried with angles that are 8 % and 16 % larger and smaller
    still. Where it sees little but a wall, there are several poses, of which each leaves out the
    points that would tell.
    """
    none = np.zeros(len(seen.model.directions))
    first = _in_turn(given, none, seen, estimate)
    if first is not None and not first.is_possible:
        return None
    tried = [] if first is None else [first]
    if isinstance(seen.camera, FocalCamera):
        middle = none if first is None else first.sizes
        for start in STARTS_OF_LENS:
            changes = middle + start
            answer = estimate(seen.angles.changed(changes).bearings, None)
            found = _in_turn(answer, changes, seen, estimate, tried)
            if found is not None:
                tried.append(found)
    if not tried:
        return None
    best = max(tried, key=lambda each: each.gain_over(tried[0].answer))
    if not best.explains_more_than(given, seen.camera):
        return None
    others = [each for each in tried if not best.is_near(each.sizes)]
    is_certain = all(best.gain_over(each.answer) > _CLEAR_GAIN for each in others)
    # One factor of angles is the focal length of these lenses alone.
    is_one_factor = seen.model.angles == "focal" or isinstance(seen.camera, KannalaBrandt)
    camera = changed_lens(seen.camera, best.sizes) if is_one_factor else None
    return best._replace(camera=camera, is_certain=is_certain)


def _in_turn(
    answer: AbsolutePoseResult,
    changes: Array,
    seen: SeenPoints,
    estimate: Estimate,
    known: Sequence[AnglesByPoints] = (),
) -> AnglesByPoints | None:
    """Pose and changes of the angles, from an answer with some changes; None where they are known.

    That is, if no pose has enough inliers, or the changes come near to known ones.
    """
    refined = None
    for _ in range(_MOST_ROUNDS):
        if answer.num_inliers < _FEWEST_INLIERS:
            return None
        refined = seen.refined(answer, changes)
        if any(each.is_near(refined.changes) for each in known):
            return None
        answer = estimate(seen.angles.changed(refined.changes).bearings, refined.pose)
        moved = float(np.abs(refined.changes - changes).max())
        changes = refined.changes
        if moved < _SETTLED:
            break
    is_beyond = float(np.mean(seen.angles.beyond(changes))) > MOST_BEYOND
    if refined is None or not answer.success or is_beyond:
        return None
    sigmas, directions = np.sqrt(np.diag(refined.covariance)[6:]), seen.model.directions
    found = tuple(
        AngleChange(1, name, float(change), float(sigma))
        for name, change, sigma in zip(directions, changes, sigmas, strict=True)
    )
    return AnglesByPoints(found, answer)


def with_focal_uncertainty_by_points(
    result: AbsolutePoseResult, seen: SeenPoints
) -> AbsolutePoseResult:
    """Return the pose of a lens with what is left open of its focal length in the covariance.

    It counts as known to `FOCAL_SIGMA`, and the better the more the points say of it: what is added
    is the second moment of the pose over the focal lengths that both leave.
    """
    if not isinstance(seen.camera, FocalCamera) or result.num_inliers < _FEWEST_INLIERS:
        return result
    refined = seen.refined(result, np.zeros(1))
    variance = float(refined.covariance[6, 6])
    share = FOCAL_SIGMA**2 / (FOCAL_SIGMA**2 + variance)  # of what the points say
    second_moment = (share * float(refined.changes[0])) ** 2 + share * variance
    moved = refined.covariance[:6, 6] / variance
    open_still = at_world(refined.pose, second_moment * np.outer(moved, moved))
    return replace(result, covariance=result.covariance + open_still)
