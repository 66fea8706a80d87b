# SPDX-License-Identifier: BSD-3-Clause
"""Pose of a camera from bearings and points, anywhere on the sphere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360 import _core
from epi360.epipolar.arguments import bearings_array, direction_array
from epi360.epipolar.essential import skew
from epi360.estimation.absolute_evidence import directions_of
from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]
Status = Literal["ok", "too_few_inliers", "degenerate"]

# Standard deviation of the pose in its worst direction, in radians of rotation and in median
# distances of the points of translation, beyond which it is not determined.
LARGEST_SIGMA = 0.01
SIGMA_OF_MEDIAN = 1.1774100225154747  # median length of a standard normal vector in the plane
LOSS_SCALE = 2.0  # of Cauchy's loss, in units of the noise


@dataclass(frozen=True)
class AbsolutePoseFit:
    """Pose of a camera and the evidence for it.

    Attributes
    ----------
    cam_from_world : Pose
        NaN if there are too few inliers; the best that was found if it is degenerate.
    inlier_mask : ndarray, shape (N,)
        Bearings that are less than the threshold from their point's direction.
    residuals_rad : ndarray, shape (N,)
        Angle between each bearing and the direction to its point, up to pi; NaN where a row is
        missing or there is no pose.
    covariance : ndarray, shape (6, 6)
        Of (w, d), where the true pose is R' = exp([w]x) R, t' = t + d; radians and the unit of the
        points. NaN without a pose; large, not infinite, where the points do not determine it.
    noise_rad : float
        Standard deviation of the inliers' bearings in radians, per axis.
    status : str
        "ok", "too_few_inliers" or "degenerate": the inliers do not determine the pose to 0.01 rad
        and a hundredth of their median distance, for example if all lie in one small patch, or are
        very far away (then the rotation may still be good: see the covariance).
    """

    cam_from_world: Pose
    inlier_mask: NDArray[np.bool_]
    residuals_rad: Array
    covariance: Array
    noise_rad: float
    status: Status

    @property
    def success(self) -> bool:
        """Whether the status is "ok"."""
        return self.status == "ok"


def fit_absolute_pose(
    bearings: ArrayLike,
    points: ArrayLike,
    *,
    threshold_rad: float = 0.01,
    guess: Pose | None = None,
    gravity: ArrayLike | None = None,
    gravity_sigma_rad: float = 0.02,
    world_gravity: ArrayLike = (0.0, 1.0, 0.0),
    min_inliers: int = 10,
    seed: int = 0,
) -> AbsolutePoseFit:
    """Return the pose ``cam_from_world`` of a camera that sees points in known places.

    Parameters
    ----------
    bearings : array_like, shape (N, 3)
        Directions in the camera's frame; rows with NaN are missing.
    points : array_like, shape (N, 3)
        Points of the same rows in the world; rows with NaN are missing.
    threshold_rad : float
        Largest angle of an inlier in radians, below pi / 2.
    guess : Pose, optional
        Where the pose is searched first. Samples of three are drawn without it, or where fewer
        than half of the points agree with what it leads to.
    gravity : array_like, shape (3,), optional
        Direction of ``world_gravity`` in the camera.
    gravity_sigma_rad : float
        Its standard deviation in radians, per axis.
    world_gravity : array_like, shape (3,)
        Direction of gravity in the world.
    min_inliers : int
        Fewest inliers of a pose, at least 4.
    seed : int
        Random seed of the samples.

    Raises
    ------
    ValueError
        If a shape is wrong, a number infinite or an option out of its range.
    """
    b = bearings_array(bearings, "bearings")
    X = np.ascontiguousarray(points, dtype=np.float64)
    if X.shape != b.shape:
        raise ValueError(f"points must have shape {b.shape} like bearings, got {X.shape}")
    if np.isinf(X).any():
        raise ValueError("points must be finite (NaN marks a missing row)")
    if not 0.0 < threshold_rad < np.pi / 2:
        raise ValueError(f"threshold_rad must be between 0 and pi / 2, got {threshold_rad}")
    if min_inliers < 4:
        raise ValueError(f"min_inliers must be at least 4, got {min_inliers}")
    if not gravity_sigma_rad > 0.0:
        raise ValueError(f"gravity_sigma_rad must be positive, got {gravity_sigma_rad}")
    down = None if gravity is None else direction_array(gravity, "gravity")
    level = Gravity(down, direction_array(world_gravity, "world_gravity"), gravity_sigma_rad)
    usable = np.isfinite(b[:, 0]) & np.isfinite(X.sum(axis=1))
    found = _core.absolute_pose(
        b[usable], X[usable], guess=_start(guess), gravity=level.in_camera,
        world_gravity=level.in_world, gravity_sigma=level.sigma, threshold=threshold_rad,
        min_inliers=min_inliers, seed=seed,
    )  # fmt: skip
    pose = None if found is None else Pose(*found)
    return _judged(pose, b, X, threshold_rad, level, min_inliers)


@dataclass(frozen=True)
class Gravity:
    """Direction of gravity in the camera, if known, and in the world."""

    in_camera: Array | None
    in_world: Array
    sigma: float


def _start(guess: Pose | None) -> tuple[Array, Array] | None:
    """Return rotation and translation of a guess that is one."""
    if guess is None or np.isnan(guess.matrix()).any():
        return None
    return guess.rotation, guess.translation


def _judged(
    pose: Pose | None, b: Array, X: Array, threshold: float, level: Gravity, min_inliers: int
) -> AbsolutePoseFit:
    residuals = np.full(len(b), np.nan)
    if pose is not None:
        residuals = angles_of_units(b, directions_of(pose, X))
    inliers = residuals < threshold
    if pose is None or inliers.sum() < min_inliers:
        nothing = np.full((6, 6), np.nan)
        lost = np.full(len(b), np.nan)
        none = np.zeros(len(b), dtype=bool)
        return AbsolutePoseFit(Pose.nan(), none, lost, nothing, np.nan, "too_few_inliers")
    x = X[inliers] @ pose.rotation.T + pose.translation
    noise = float(np.median(residuals[inliers])) / SIGMA_OF_MEDIAN
    noise *= np.sqrt(len(x) / (len(x) - 3.0))  # six parameters were fitted to two numbers a point
    unit = np.repeat([1.0, float(np.median(np.linalg.norm(x, axis=1)))], 3)
    information = _information(pose, x, residuals[inliers], noise, level)
    information *= np.outer(unit, unit)
    values, vectors = np.linalg.eigh(information)
    rounding = 1e-11 * values[-1]
    determined = values[0] > max(rounding, LARGEST_SIGMA**-2)
    values = np.maximum(values, rounding)  # never infinite
    at_camera = (vectors / values) @ vectors.T * np.outer(unit, unit)
    to_world = np.eye(6)
    to_world[3:, :3] = -skew(pose.translation)
    covariance = to_world @ at_camera @ to_world.T
    status: Status = "ok" if determined else "degenerate"
    return AbsolutePoseFit(pose, inliers, residuals, covariance, noise, status)


def _information(pose: Pose, x: Array, angles: Array, noise: float, level: Gravity) -> Array:
    """Return the inverse of the covariance of (w, d) with R' = exp(w) R, t' = exp(w) t + d.

    That of an M-estimator (Huber 1981, 7.6): a Cauchy weight w of a length in the plane has
    psi' = w^2 on average over the directions.
    """
    least, squares = max(noise, 1e-12), angles**2
    weights = 1.0 / (1.0 + squares / (LOSS_SCALE * least) ** 2)
    variance = float(weights**2 @ squares) / (2.0 * len(x) - 6.0) / float(np.mean(weights**2)) ** 2
    # A direction u at distance r moves by w x u + (1 - u u^T) d / r.
    distances = np.linalg.norm(x, axis=1)
    u, near = x / distances[:, None], x / distances[:, None] ** 2
    information = np.empty((6, 6))
    information[:3, :3] = len(x) * np.eye(3) - u.T @ u
    information[3:, 3:] = float(np.sum(distances**-2.0)) * np.eye(3) - near.T @ near
    information[:3, 3:] = skew(near.sum(axis=0))
    information[3:, :3] = information[:3, 3:].T
    information /= max(variance, least**2 * 1e-4)
    if level.in_camera is not None:
        down = pose.rotation @ level.in_world
        information[:3, :3] += (np.eye(3) - np.outer(down, down)) / level.sigma**2
    return information
