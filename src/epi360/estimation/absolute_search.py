# SPDX-License-Identifier: BSD-3-Clause
"""The search for a pose in a map: samples at several gates, then a refinement of the inliers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.absolute_covariance import Refined, refined_pose
from epi360.estimation.absolute_evidence import best_gate, directions_of
from epi360.estimation.absolute_pose_fit import Gravity, fit_absolute_pose
from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Gates of the search while the noise is unknown; the one with the fewest false alarms is kept.
_GATES_DEG = (0.15, 0.5, 1.5)
_GATE_SIGMAS, _SMALLEST_GATE_DEG = 3.5, 0.01  # one of 460 right matches is farther away
_GATE_ROUNDS = 3
# Points nearer than this share of the median distance have much leverage; of how many they are few.
_NEAR, _FEW = 0.25, 0.2


@dataclass(frozen=True, eq=False)
class FoundPose:
    """A pose, its gate in radians and its inliers."""

    refined: Refined
    gate: float
    inliers: Mask
    residuals: Array

    @property
    def pose(self) -> Pose:
        """The pose itself."""
        return self.refined.pose


@dataclass(frozen=True, eq=False)
class PoseSearch:
    """The usable matches, and how a pose is searched among them."""

    bearings: Array
    points: Array
    covariances: Array | None
    level: Gravity
    threshold: float  # radians, 0 for an estimate
    min_num_inliers: int
    shared_error: float
    seed: int

    def best(self, guess: Pose | None) -> FoundPose | None:
        """Pose with the fewest false alarms over the gates."""
        gates = [self.threshold] if self.threshold else [math.radians(g) for g in _GATES_DEG]
        best, fewest = None, math.inf
        for gate in gates:
            for pose in self._candidates(gate, guess):
                directions = directions_of(pose, self.points)
                radius, alarms = best_gate(self.bearings, directions, gates[-1])
                if alarms < fewest:
                    best, fewest = (pose, self.threshold or max(radius, _smallest_gate())), alarms
        return None if best is None else self._settled(*best)

    def without(self, chosen: Mask) -> PoseSearch:
        """Search among the other matches."""
        covariances = None if self.covariances is None else self.covariances[~chosen]
        return replace(
            self,
            bearings=self.bearings[~chosen],
            points=self.points[~chosen],
            covariances=covariances,
        )

    def _candidates(self, gate: float, guess: Pose | None) -> Iterator[Pose]:
        """Pose of all matches, and the one without the few that are very near it."""
        pose = self.fitted(gate, guess)
        if pose is None:
            return
        yield pose
        # A small step of the camera explains a wrong match of a near point, and no other loss than
        # that of all the far ones holds it back.
        distances = np.linalg.norm(self.points - pose.inverse().translation, axis=1)
        near = distances < _NEAR * float(np.median(distances))
        if 0 < near.sum() < _FEW * len(near):
            other = self.without(near).fitted(gate, None)
            if other is not None:
                yield other

    def fitted(self, gate: float, guess: Pose | None) -> Pose | None:
        """Pose with most matches inside a gate, if it has enough of them."""
        found = fit_absolute_pose(
            self.bearings,
            self.points,
            threshold_rad=gate,
            guess=guess,
            gravity=self.level.in_camera,
            gravity_sigma_rad=self.level.sigma,
            world_gravity=self.level.in_world,
            min_inliers=self.min_num_inliers,
            seed=self.seed,
        )
        return None if found.status == "too_few_inliers" else found.cam_from_world

    def _settled(self, pose: Pose, gate: float) -> FoundPose | None:
        """Refine over the inliers, whose gate follows from their noise if none is given."""
        found = None
        for _ in range(_GATE_ROUNDS):
            inliers = self._residuals(pose) < gate
            if inliers.sum() < self.min_num_inliers:
                return found
            refined = self._refined(pose, inliers)
            pose = refined.pose
            residuals = self._residuals(pose)
            if not self.threshold:
                gate = max(_GATE_SIGMAS * _spread_of(residuals[inliers]), _smallest_gate())
            found = FoundPose(refined, gate, residuals < gate, residuals)
        return found if found is None or found.inliers.sum() >= self.min_num_inliers else None

    def _residuals(self, pose: Pose) -> Array:
        return angles_of_units(self.bearings, directions_of(pose, self.points))

    def _refined(self, pose: Pose, inliers: Mask) -> Refined:
        covariances = None if self.covariances is None else self.covariances[inliers]
        return refined_pose(
            pose,
            self.bearings[inliers],
            self.points[inliers],
            covariances,
            self.level,
            self.shared_error,
        )


def _spread_of(residuals: Array) -> float:
    """Standard deviation per axis of angles to the directions."""
    return float(np.median(residuals)) / math.sqrt(2.0 * math.log(2.0))


def _smallest_gate() -> float:
    return math.radians(_SMALLEST_GATE_DEG)
