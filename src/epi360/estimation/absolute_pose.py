# SPDX-License-Identifier: BSD-3-Clause
"""Bearings of points in known places to the pose of the camera, with its evidence and verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearings_array, direction_array
from epi360.epipolar.essential import skew
from epi360.estimation.absolute_covariance import Gravity, Refined, at_world, refined_pose
from epi360.estimation.absolute_evidence import (
    Evidence,
    angles_between,
    best_gate,
    directions_of,
    evidence_for,
)
from epi360.estimation.absolute_pose_fit import fit_absolute_pose
from epi360.estimation.absolute_verdict import (
    FEWEST_MATCHES,
    AbsoluteStatus,
    Spread,
    judge,
    probability_of,
    warnings_of,
)
from epi360.estimation.options import Threshold, check_threshold, checked_integer, checked_noise
from epi360.poses import Pose, rotation_error_deg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Gates of the search while the noise is unknown; the one with the fewest false alarms is kept.
_GATES_DEG = (0.15, 0.5, 1.5)
_GATE_SIGMAS, _SMALLEST_GATE_DEG = 3.5, 0.01  # one of 460 right matches is farther away
_GATE_ROUNDS = 3
# A second pose is truly different beyond this, in degrees and in median distances of the points.
_RIVAL_DEG, _RIVAL_DISTANCE = 3.0, 0.05
# Points nearer than this share of the median distance have much leverage; of how many they are few.
_NEAR, _FEW = 0.25, 0.2
_WITH_POSE = ("ok", "ambiguous")


@dataclass(frozen=True)
class AbsolutePoseResult:
    """Pose of a camera in a map and the evidence for it.

    Attributes
    ----------
    cam_from_world : Pose
        x_cam = R x_world + t; NaN unless the status is "ok" or "ambiguous".
    inlier_mask : ndarray, shape (N,), bool
        Matches whose bearing is less than the gate from the direction to their point, in the order
        of the input.
    residuals_rad : ndarray, shape (N,)
        That angle, up to pi; NaN for missing rows and where there is no pose.
    covariance : ndarray, shape (6, 6)
        Of (w, d), where the true pose is R_true = exp([w]x) R, t_true = t + d; radians and the unit
        of the points. The map is taken for true but for the errors of its points that are given.
    noise_deg : float
        Standard deviation of the bearings per axis, over the inliers.
    inlier_threshold_deg : float
        The gate that was used, given or estimated.
    sphere_coverage : float
        Share of 48 equal-area cells of the sphere of view that hold an inlier.
    status : str
        "ok" or the reason why the pose must not be used as it is: "too_few_matches",
        "too_few_inliers", "concentrated_inliers" (the inliers are one patch, or do not determine
        the pose to 5 degrees and a tenth of their distance) or "ambiguous" (another pose explains
        at least half as much of the view).
    probability : float
        Probability in [0, 1] that the pose that was found is right, whatever the status says of it;
        0 where none was found.
    alternatives : tuple of Pose
        After "ambiguous" the other pose; after "too_few_inliers" and "concentrated_inliers" the
        pose that was found and refused.
    warnings : tuple of str
        Sentences for a person; empty when there is nothing to say.
    """

    cam_from_world: Pose
    inlier_mask: Mask
    residuals_rad: Array
    covariance: Array
    noise_deg: float
    inlier_threshold_deg: float
    sphere_coverage: float
    status: AbsoluteStatus
    probability: float
    alternatives: tuple[Pose, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def success(self) -> bool:
        """Whether the pose may be used as it is."""
        return self.status == "ok"

    @property
    def num_inliers(self) -> int:
        """Number of matches that support the pose."""
        return int(np.count_nonzero(self.inlier_mask))

    @property
    def rotation_sigma_deg(self) -> float:
        """Standard deviation of the rotation over all axes, in degrees."""
        return math.degrees(math.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def center_covariance(self) -> Array:
        """Covariance (3, 3) of the camera's centre -R't in the world, in the points' unit."""
        R, t = self.cam_from_world.rotation, self.cam_from_world.translation
        # c' = -R' (exp(-w) (t + d)) with R' = R transposed: c' = c - R' (d + t x w).
        moves = -R.T @ np.hstack([skew(t), np.eye(3)])
        return np.asarray(moves @ self.covariance @ moves.T)

    @property
    def position_sigma(self) -> float:
        """Standard deviation of the camera's centre over all axes, in the points' unit."""
        return math.sqrt(np.trace(self.center_covariance))


def estimate_absolute_pose(
    bearings: ArrayLike,
    points: ArrayLike,
    *,
    inlier_threshold_deg: Threshold = "auto",
    point_covariances: ArrayLike | None = None,
    guess: Pose | None = None,
    gravity: ArrayLike | None = None,
    gravity_sigma_deg: float = 1.0,
    world_gravity: ArrayLike = (0.0, 1.0, 0.0),
    max_noise_deg: float | None = None,
    min_num_inliers: int = 6,
    shared_error: float = 0.0,
    seed: int = 0,
) -> AbsolutePoseResult:
    """Pose of a camera that sees points in known places, from matches of which many may be wrong.

    Parameters
    ----------
    bearings : array_like, shape (N, 3)
        Directions of any length in the camera's frame, anywhere on the sphere; a row with NaN is
        missing. One direction may stand in several rows if it may be of several points.
    points : array_like, shape (N, 3)
        Points of the same rows in the world, in any unit; a row with NaN is missing.
    inlier_threshold_deg : float or "auto"
        Largest angle between a bearing and the direction to its point, in degrees; "auto" estimates
        the noise.
    point_covariances : array_like, shape (N, 3, 3), optional
        How uncertain each point is, in its unit squared; the noise of the bearings comes on top.
    guess : Pose, optional
        A ``cam_from_world`` where the search begins.
    gravity : array_like, shape (3,), optional
        Direction of gravity (down) in the camera.
    gravity_sigma_deg : float
        Standard deviation of that direction, per axis, in degrees.
    world_gravity : array_like, shape (3,)
        Direction of gravity in the world.
    max_noise_deg : float, optional
        Noise of the bearings (one sigma) from which on the result carries a warning.
    min_num_inliers : int
        Support under which a pose is not believed, at least 4.
    shared_error : float
        Standard deviation of the error that neighbouring bearings have in common (stitching,
        calibration), in units of the noise of one bearing, as in `RansacOptions`. Images use 1.
    seed : int
        Random seed of the sampling; the same input and seed give the same result.

    Returns
    -------
    result : AbsolutePoseResult
        With ``status`` other than "ok" where the matches do not support one pose.

    Raises
    ------
    ValueError
        If a shape is wrong, a number infinite, a bearing zero, or an option out of its range.

    Notes
    -----
    Samples of three matches (Grunert's problem) with local optimisation at several gates; the pose
    with the fewest false alarms (Moisan & Stival 2004) is refined to the most likely one under
    Cauchy's loss, the bearings' noise and the covariances of the points. The verdict asks whether
    chance would explain the matches, each region of 3 degrees counted once, whether the inliers
    determine the pose, and whether another pose explains the others.
    """
    b = bearings_array(bearings, "bearings")
    X = _points(points, b.shape)
    covariances = _covariances(point_covariances, len(b))
    threshold = check_threshold(inlier_threshold_deg)
    min_num_inliers = checked_integer(min_num_inliers, "min_num_inliers")
    checked_noise(max_noise_deg)
    _check_positive(gravity_sigma_deg, "gravity_sigma_deg")
    if not (shared_error >= 0.0 and math.isfinite(shared_error)):
        raise ValueError(f"shared_error must be 0 or more, got {shared_error}")
    if min_num_inliers < FEWEST_MATCHES:
        raise ValueError(f"min_num_inliers must be at least 4, got {min_num_inliers}")
    level = Gravity(
        None if gravity is None else direction_array(gravity, "gravity"),
        direction_array(world_gravity, "world_gravity"),
        math.radians(gravity_sigma_deg),
    )
    rows = np.flatnonzero(np.isfinite(b[:, 0]) & np.isfinite(X.sum(axis=1)))
    search = _Search(
        b[rows],
        X[rows],
        None if covariances is None else covariances[rows],
        level,
        threshold,
        min_num_inliers,
        shared_error,
        seed,
    )
    found = search.best(guess)
    if found is None:
        few = len(rows) < max(FEWEST_MATCHES, min_num_inliers)
        return _nothing(len(b), "too_few_matches" if few else "too_few_inliers")
    return _judged(search, found, rows, len(b), max_noise_deg)


@dataclass(frozen=True, eq=False)
class _Found:
    """A pose, its gate in radians and its inliers."""

    refined: Refined
    gate: float
    inliers: Mask
    residuals: Array

    @property
    def pose(self) -> Pose:
        return self.refined.pose


@dataclass(frozen=True, eq=False)
class _Search:
    """The usable matches, and how a pose is searched among them."""

    bearings: Array
    points: Array
    covariances: Array | None
    level: Gravity
    threshold: float  # radians, 0 for an estimate
    min_num_inliers: int
    shared_error: float
    seed: int

    def best(self, guess: Pose | None) -> _Found | None:
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

    def without(self, chosen: Mask) -> _Search:
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
        pose = self._fitted(gate, guess)
        if pose is None:
            return
        yield pose
        # A small step of the camera explains a wrong match of a near point, and no other loss than
        # that of all the far ones holds it back.
        distances = np.linalg.norm(self.points - pose.inverse().translation, axis=1)
        near = distances < _NEAR * float(np.median(distances))
        if 0 < near.sum() < _FEW * len(near):
            other = self.without(near)._fitted(gate, None)
            if other is not None:
                yield other

    def _fitted(self, gate: float, guess: Pose | None) -> Pose | None:
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

    def _settled(self, pose: Pose, gate: float) -> _Found | None:
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
            found = _Found(refined, gate, residuals < gate, residuals)
        return found if found is None or found.inliers.sum() >= self.min_num_inliers else None

    def _residuals(self, pose: Pose) -> Array:
        return angles_between(self.bearings, directions_of(pose, self.points))

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


def _judged(
    search: _Search, found: _Found, rows: NDArray[np.intp], count: int, limit: float | None
) -> AbsolutePoseResult:
    evidence = _evidence(search, found)
    at_camera = found.refined.covariance
    distance = _median_distance(search, found)
    spread = Spread(
        math.sqrt(np.linalg.eigvalsh(at_camera[:3, :3])[-1]),
        math.sqrt(np.linalg.eigvalsh(at_camera[3:, 3:])[-1]) / distance,
    )
    rival, rival_regions = None, 0.0
    status = judge(evidence, spread, search.min_num_inliers, rival_regions)
    if status == "ok":
        rival, rival_regions = _rival(search, found, distance)
        status = judge(evidence, spread, search.min_num_inliers, rival_regions)
    if status not in _WITH_POSE:
        return replace(
            _nothing(count, status),
            probability=probability_of(evidence),
            alternatives=(found.pose,),
            noise_deg=math.degrees(found.refined.noise_rad),
            inlier_threshold_deg=math.degrees(found.gate),
        )
    mask, residuals = np.zeros(count, dtype=bool), np.full(count, np.nan)
    mask[rows], residuals[rows] = found.inliers, found.residuals
    noise_deg = math.degrees(found.refined.noise_rad)
    return AbsolutePoseResult(
        cam_from_world=found.pose,
        inlier_mask=mask,
        residuals_rad=residuals,
        covariance=at_world(found.pose, at_camera),
        noise_deg=noise_deg,
        inlier_threshold_deg=math.degrees(found.gate),
        sphere_coverage=evidence.cells / 48.0,
        status=status,
        probability=probability_of(evidence),
        alternatives=() if rival is None or status != "ambiguous" else (rival,),
        warnings=warnings_of(evidence, count - len(rows), noise_deg, limit),
    )


def _evidence(search: _Search, found: _Found) -> Evidence:
    directions = directions_of(found.pose, search.points)
    return evidence_for(search.bearings, directions, found.inliers, found.gate)


def _rival(search: _Search, found: _Found, distance: float) -> tuple[Pose | None, float]:
    """Pose that explains most of the other matches, and how many regions of them."""
    rest = search.without(found.residuals < 3.0 * found.gate)
    if len(rest.bearings) < search.min_num_inliers:
        return None, 0.0
    pose = rest._fitted(found.gate, None)
    if pose is None or not _differ(pose, found.pose, distance):
        return None, 0.0
    directions = directions_of(pose, rest.points)
    inliers = angles_between(rest.bearings, directions) < found.gate
    return pose, evidence_for(rest.bearings, directions, inliers, found.gate).num_regions


def _differ(pose: Pose, other: Pose, distance: float) -> bool:
    apart = np.linalg.norm(pose.inverse().translation - other.inverse().translation)
    return bool(rotation_error_deg(pose, other) > _RIVAL_DEG or apart > _RIVAL_DISTANCE * distance)


def _median_distance(search: _Search, found: _Found) -> float:
    seen = search.points[found.inliers] - found.pose.inverse().translation
    return max(float(np.median(np.linalg.norm(seen, axis=1))), 1e-300)


def _spread_of(residuals: Array) -> float:
    """Standard deviation per axis of angles to the directions."""
    return float(np.median(residuals)) / math.sqrt(2.0 * math.log(2.0))


def _smallest_gate() -> float:
    return math.radians(_SMALLEST_GATE_DEG)


def _nothing(count: int, status: AbsoluteStatus) -> AbsolutePoseResult:
    return AbsolutePoseResult(
        cam_from_world=Pose.nan(),
        inlier_mask=np.zeros(count, dtype=bool),
        residuals_rad=np.full(count, np.nan),
        covariance=np.full((6, 6), np.nan),
        noise_deg=math.nan,
        inlier_threshold_deg=math.nan,
        sphere_coverage=0.0,
        status=status,
        probability=0.0,
    )


def _points(points: ArrayLike, shape: tuple[int, ...]) -> Array:
    X = np.ascontiguousarray(points, dtype=np.float64)
    if X.shape != shape:
        raise ValueError(f"points must have shape {shape} like bearings, got {X.shape}")
    if np.isinf(X).any():
        raise ValueError("points must be finite (NaN marks a missing row)")
    return X


def _covariances(covariances: ArrayLike | None, count: int) -> Array | None:
    if covariances is None:
        return None
    array = np.ascontiguousarray(covariances, dtype=np.float64)
    if array.shape != (count, 3, 3):
        raise ValueError(f"point_covariances must have shape ({count}, 3, 3), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("point_covariances must be finite")
    return array


def _check_positive(value: float, name: str) -> None:
    if not (value > 0.0 and math.isfinite(value)):
        raise ValueError(f"{name} must be positive, got {value}")
