# SPDX-License-Identifier: BSD-3-Clause
"""Bearings of points in known places to the pose of the camera, with its evidence and verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import bearings_array, direction_array, plain_array
from epi360.estimation.absolute_covariance import at_world
from epi360.estimation.absolute_evidence import Evidence, directions_of, evidence_for
from epi360.estimation.absolute_pose_fit import Gravity
from epi360.estimation.absolute_result import AbsolutePoseResult, no_pose
from epi360.estimation.absolute_search import FoundPose, PoseSearch
from epi360.estimation.absolute_verdict import (
    FEWEST_MATCHES,
    Spread,
    judge,
    probability_of,
    warnings_of,
    warnings_of_rows,
)
from epi360.estimation.copies import distinct_rows
from epi360.estimation.options import Threshold, check_threshold, checked_integer, checked_noise
from epi360.poses import Pose, angles_of_units, checked_pose, rotation_error_deg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

# A second pose is truly different beyond this, in degrees and in median distances of the points.
_RIVAL_DEG, _RIVAL_DISTANCE = 3.0, 0.05
_FEWEST_SWAPPED = 20  # rows that tell whether bearings stand in the place of points
_ROUNDING = 1e-6  # of the entries of a covariance, beside the largest one
_UNIT = 1e-6  # by how much the length of a direction of single precision may differ from 1
_LARGEST = 1e100  # of a coordinate, whatever its unit: its square is a number
_WITH_POSE = ("ok", "ambiguous")


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
        missing. One direction may stand in several rows if it may be of several points. Where
        more than a quarter of the rows repeat others, point and all, these count once.
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
        If a shape is wrong, a number infinite, a bearing zero, or an option out of its range, or if
        bearings stand in the place of points.

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
    if len(b) >= _FEWEST_SWAPPED and _are_unit(X) and not _are_unit(bearings):
        raise ValueError(
            "points must be places in the world, got directions of length 1, and bearings of other "
            "lengths; the bearings come first"
        )
    covariances = _covariances(point_covariances, len(b))
    threshold = check_threshold(inlier_threshold_deg)
    min_num_inliers = checked_integer(min_num_inliers, "min_num_inliers")
    checked_noise(max_noise_deg)
    _check_positive(gravity_sigma_deg, "gravity_sigma_deg")
    if not (shared_error >= 0.0 and math.isfinite(shared_error)):
        raise ValueError(f"shared_error must be 0 or more, got {shared_error}")
    if guess is not None:
        checked_pose(guess, "guess")
    if min_num_inliers < FEWEST_MATCHES:
        raise ValueError(f"min_num_inliers must be at least 4, got {min_num_inliers}")
    level = Gravity(
        None if gravity is None else direction_array(gravity, "gravity"),
        direction_array(world_gravity, "world_gravity"),
        math.radians(gravity_sigma_deg),
    )
    usable = np.flatnonzero(np.isfinite(b[:, 0]) & np.isfinite(X.sum(axis=1)))
    first, own = distinct_rows(b[usable], X[usable])
    rows = _Rows(len(b), usable, usable[first], own)
    search = PoseSearch(
        b[rows.distinct],
        X[rows.distinct],
        None if covariances is None else covariances[rows.distinct],
        level,
        threshold,
        min_num_inliers,
        shared_error,
        checked_integer(seed, "seed") % 2**64,
    )
    found = search.best(guess)
    if found is None:
        few = len(rows.distinct) < max(FEWEST_MATCHES, min_num_inliers)
        nothing = no_pose(len(b), "too_few_matches" if few else "too_few_inliers")
        return replace(nothing, warnings=rows.warnings)
    return _judged(search, found, rows, max_noise_deg)


@dataclass(frozen=True)
class _Rows:
    """Which of the given rows are usable, the first of each match, and the match of each."""

    given: int
    usable: Indices
    distinct: Indices
    match: Indices

    @property
    def warnings(self) -> tuple[str, ...]:
        usable = len(self.usable)
        return warnings_of_rows(self.given, self.given - usable, usable - len(self.distinct))


def _judged(
    search: PoseSearch, found: FoundPose, rows: _Rows, limit: float | None
) -> AbsolutePoseResult:
    evidence = _evidence(search, found)
    at_camera = found.refined.covariance
    distance = _median_distance(search, found)
    spread = _spread(found, distance)
    rival, rival_regions = None, 0.0
    status = judge(evidence, spread, search.min_num_inliers, rival_regions)
    if status == "ok":
        rival, rival_regions = _rival(search, found, distance)
        status = judge(evidence, spread, search.min_num_inliers, rival_regions)
    if status not in _WITH_POSE:
        return replace(
            no_pose(rows.given, status),
            probability=probability_of(evidence),
            alternatives=(found.pose,),
            noise_deg=math.degrees(found.refined.noise_rad),
            inlier_threshold_deg=math.degrees(found.gate),
            warnings=rows.warnings,
        )
    mask, residuals = np.zeros(rows.given, dtype=bool), np.full(rows.given, np.nan)
    mask[rows.usable] = found.inliers[rows.match]
    residuals[rows.usable] = found.residuals[rows.match]
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
        warnings=(*rows.warnings, *warnings_of(evidence, noise_deg, limit)),
    )


def _spread(found: FoundPose, distance: float) -> Spread:
    if not found.refined.determined:
        return Spread(math.inf, math.inf)
    covariance = found.refined.covariance
    return Spread(
        math.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]),
        math.sqrt(np.linalg.eigvalsh(covariance[3:, 3:])[-1]) / distance,
    )


def _evidence(search: PoseSearch, found: FoundPose) -> Evidence:
    directions = directions_of(found.pose, search.points)
    return evidence_for(search.bearings, directions, found.inliers, found.gate)


def _rival(search: PoseSearch, found: FoundPose, distance: float) -> tuple[Pose | None, float]:
    """Pose that explains most of the other matches, and how many regions of them."""
    rest = search.without(found.residuals < 3.0 * found.gate)
    if len(rest.bearings) < search.min_num_inliers:
        return None, 0.0
    pose = rest.fitted(found.gate, None)
    if pose is None or not _differ(pose, found.pose, distance):
        return None, 0.0
    directions = directions_of(pose, rest.points)
    inliers = angles_of_units(rest.bearings, directions) < found.gate
    return pose, evidence_for(rest.bearings, directions, inliers, found.gate).num_regions


def _differ(pose: Pose, other: Pose, distance: float) -> bool:
    apart = np.linalg.norm(pose.inverse().translation - other.inverse().translation)
    return bool(rotation_error_deg(pose, other) > _RIVAL_DEG or apart > _RIVAL_DISTANCE * distance)


def _median_distance(search: PoseSearch, found: FoundPose) -> float:
    seen = search.points[found.inliers] - found.pose.inverse().translation
    return max(float(np.median(np.linalg.norm(seen, axis=1))), 1e-300)


def _are_unit(rows: ArrayLike) -> bool:
    """Whether the rows, those with NaN apart, all have length 1."""
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(np.asarray(rows, dtype=np.float64), axis=1)
    known = lengths[np.isfinite(lengths)]
    return len(known) > 0 and bool((np.abs(known - 1.0) < _UNIT).all())


def _points(points: ArrayLike, shape: tuple[int, ...]) -> Array:
    X = np.ascontiguousarray(plain_array(points, "points"))
    if X.shape != shape:
        raise ValueError(f"points must have shape {shape} like bearings, got {X.shape}")
    if np.isinf(X).any():
        raise ValueError("points must be finite (NaN marks a missing row)")
    if (np.abs(X) > _LARGEST).any():
        raise ValueError(f"points must be at most {_LARGEST:g} from zero along each axis")
    return X


def _covariances(covariances: ArrayLike | None, count: int) -> Array | None:
    if covariances is None:
        return None
    array = np.ascontiguousarray(covariances, dtype=np.float64)
    if array.shape != (count, 3, 3):
        raise ValueError(f"point_covariances must have shape ({count}, 3, 3), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("point_covariances must be finite")
    allowed = _ROUNDING * np.abs(array).max(axis=(1, 2), initial=0.0)
    skew = np.abs(array - np.swapaxes(array, 1, 2)).max(axis=(1, 2), initial=0.0)
    if (skew > allowed).any() or (np.linalg.eigvalsh(array)[:, 0] < -allowed).any():
        raise ValueError("point_covariances must be symmetric and positive semidefinite")
    return array


def _check_positive(value: float, name: str) -> None:
    if not (value > 0.0 and math.isfinite(value)):
        raise ValueError(f"{name} must be positive, got {value}")
