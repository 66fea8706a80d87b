# SPDX-License-Identifier: BSD-3-Clause
"""The last refinement of a pose in a map, which knows how uncertain each point is, and its sigma.

The parameters are (w, d): R' = exp([w]x) R, t' = exp([w]x) t + d, at the camera; and changes of the
camera's angles, if these are refined, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.changed_angles import Angles
from epi360.epipolar.essential import skew
from epi360.estimation.absolute_pose_fit import Gravity
from epi360.estimation.angle_changes import LARGEST_CHANGE
from epi360.poses import Pose, angles_of_units, rotation_from_vector

Array = NDArray[np.float64]

_STEPS, _NOISE_STEPS = 8, 12
_LOSS_SCALE = 2.0  # of Cauchy's loss, in standard deviations
_MEDIAN_OF_SQUARE = 2.0 * np.log(2.0)  # of the squared length of a standard normal vector
_SMALLEST_NOISE = 1e-9  # radians
# Eigenvalues of the information, scaled to a unit diagonal, below this share of the largest are
# rounding. Coordinates that are large beside the distances have a coarser one of their own.
_SINGULAR, _ROUNDING_STEPS = 1e-11, 10.0
# Of the error that neighbouring bearings share, as with pairs of views: it falls to 1 / e.
_REACH = np.radians(45.0)
_SHARED_SAMPLE, _SIGNIFICANT = 400, 4.0
_NO_CHANGES = np.zeros(0)
_FEWEST_SHARED = 20  # bearings that it is estimated from; of fewer, the least is assumed


@dataclass(frozen=True)
class Refined:
    """A pose, the noise of the bearings per axis and the covariance (6, 6) at the camera.

    With ``changes`` (k,) of the camera's angles the covariance is that of both, (6 + k, 6 + k). The
    pose is not ``determined`` if only rounding speaks for it in some direction, as where all points
    lie on a line. The covariance is then large, not infinite, and too small.
    """

    pose: Pose
    noise_rad: float
    covariance: Array
    determined: bool
    changes: Array


@dataclass(frozen=True)
class _Linearised:
    residuals: Array  # (N, 2) in the tangent plane of each direction
    jacobian: Array  # (N, 2, 6), or (N, 2, 6 + k) with changes of the angles
    basis: Array  # (N, 3, 2)
    per_point: Array  # (N, 2, 3): derivative by the point


def refined_pose(
    pose: Pose,
    bearings: Array,
    points: Array,
    point_covariances: Array | None,
    level: Gravity,
    shared_error: float,
    angles: Angles | None = None,
    changes: Array = _NO_CHANGES,
) -> Refined:
    """Most likely pose of inliers under their own noise, that of the points and Cauchy's loss.

    With ``angles`` of the bearings these are refined together with the pose, from ``changes`` on.
    """
    noise = _SMALLEST_NOISE
    for _ in range(_STEPS):
        at = _linearised(pose, bearings, points, angles, changes)
        spread = _point_spread(at, point_covariances)
        noise = _noise(at.residuals, spread)
        weights = _weights(noise, spread)
        information, gradient = _normal_equations(at, weights, _robust(at.residuals, weights))
        prior, prior_gradient = _prior(pose, level, len(changes))
        step = -_solved(information + prior, gradient + prior_gradient)
        turn = rotation_from_vector(step[:3])
        pose = Pose(turn @ pose.rotation, turn @ pose.translation + step[3:6])
        changes = np.clip(changes + step[6:], -LARGEST_CHANGE, LARGEST_CHANGE)
        if np.abs(step[:3]).max() < 1e-10:
            break
    at = _linearised(pose, bearings, points, angles, changes)
    weights = _weights(noise, spread)
    information = _information(pose, at, weights, level)
    own = bounded_inverse(information)
    if shared_error > 0.0:
        own = own + _shared(bearings, at, weights, own, noise, shared_error)
    determined = _is_determined(information, _rounding(pose, points))
    return Refined(pose, noise, own, determined, changes)


def at_world(pose: Pose, at_camera: Array) -> Array:
    """Covariance of (w, d) with t' = t + d in place of t' = exp([w]x) t + d."""
    to_world = np.eye(6)
    to_world[3:, :3] = -skew(pose.translation)
    return np.asarray(to_world @ at_camera @ to_world.T)


def _linearised(
    pose: Pose, bearings: Array, points: Array, angles: Angles | None, changes: Array
) -> _Linearised:
    changed = None if angles is None else angles.changed(changes)
    bearings = bearings if changed is None else changed.bearings
    x = points @ pose.rotation.T + pose.translation
    distances = np.maximum(np.linalg.norm(x, axis=1), 1e-300)
    u = x / distances[:, None]
    basis = _tangent_bases(u)
    away = bearings - u
    # The length of the residual is the angle, not the chord.
    chords = np.maximum(np.linalg.norm(away, axis=1), 1e-300)
    away = away * (angles_of_units(bearings, u) / chords)[:, None]
    residuals = np.einsum("nij,ni->nj", basis, away)
    # A direction u at distance r moves by w x u + (1 - u u^T) d / r.
    turned = np.cross(u[:, None, :], np.swapaxes(basis, 1, 2))  # (w x u) . e = w . (u x e)
    moved = np.swapaxes(basis, 1, 2) / distances[:, None, None]
    jacobian = -np.concatenate([turned, moved], axis=2)
    if changed is not None:
        by_changes = np.swapaxes(basis, 1, 2) @ changed.by_changes
        jacobian = np.concatenate([jacobian, by_changes], axis=2)
    return _Linearised(residuals, jacobian, basis, moved @ pose.rotation)


def _tangent_bases(u: Array) -> Array:
    helper = np.where(np.abs(u[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(u, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(u, first)], axis=2)


def _point_spread(at: _Linearised, covariances: Array | None) -> Array:
    """Covariance (N, 2, 2) of each direction by its point's."""
    if covariances is None:
        return np.zeros((len(at.residuals), 2, 2))
    return np.asarray(at.per_point @ covariances @ np.swapaxes(at.per_point, 1, 2))


def _weights(noise: float, spread: Array) -> Array:
    total = spread + noise**2 * np.eye(2)
    a, b, d = total[:, 0, 0], total[:, 0, 1], total[:, 1, 1]
    inverse = np.stack([d, -b, -b, a], axis=1) / (a * d - b * b)[:, None]
    return np.asarray(inverse.reshape(-1, 2, 2))


def _noise(residuals: Array, spread: Array) -> float:
    """Noise per axis beside the points', by the median of the squared residuals it explains."""
    lengths = float(np.sqrt(np.median(np.sum(residuals**2, axis=1)) / _MEDIAN_OF_SQUARE))
    # Six parameters were fitted to two numbers a point.
    lengths *= np.sqrt(len(residuals) / max(len(residuals) - 3.0, 1.0))
    high, low = max(lengths, _SMALLEST_NOISE), max(0.1 * lengths, _SMALLEST_NOISE)
    if not spread.any():
        return float(high)
    variances, axes = np.linalg.eigh(spread)
    along = np.einsum("nij,ni->nj", axes, residuals) ** 2
    for _ in range(_NOISE_STEPS):
        middle = float(np.sqrt(low * high))
        if np.median(np.sum(along / (variances + middle**2), axis=1)) > _MEDIAN_OF_SQUARE:
            low = middle
        else:
            high = middle
    return float(high)


def _squares(residuals: Array, weights: Array) -> Array:
    return np.asarray(np.einsum("ni,nij,nj->n", residuals, weights, residuals))


def _robust(residuals: Array, weights: Array) -> Array:
    return np.asarray(1.0 / (1.0 + _squares(residuals, weights) / _LOSS_SCALE**2))


def _normal_equations(at: _Linearised, weights: Array, robust: Array) -> tuple[Array, Array]:
    weighted = np.einsum("nij,njk->nik", weights * robust[:, None, None], at.jacobian)
    information = np.einsum("nij,nik->jk", at.jacobian, weighted)
    return information, np.einsum("nij,ni->j", weighted, at.residuals)


def _prior(pose: Pose, level: Gravity, num_changes: int) -> tuple[Array, Array]:
    """Information and gradient of what is known of gravity."""
    count = 6 + num_changes
    information, gradient = np.zeros((count, count)), np.zeros(count)
    if level.in_camera is not None:
        down = pose.rotation @ level.in_world
        information[:3, :3] = (np.eye(3) - np.outer(down, down)) / level.sigma**2
        gradient[:3] = -np.cross(down, level.in_camera) / level.sigma**2
    return information, gradient


def _solved(information: Array, gradient: Array) -> Array:
    return np.asarray(bounded_inverse(information) @ gradient)


def bounded_inverse(information: Array) -> Array:
    """Inverse whose values are large, not infinite, where nothing is determined."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    values = np.maximum(values, _SINGULAR * max(values[-1], 1e-300))
    return np.asarray((vectors / values) @ vectors.T * np.outer(scale, scale))


def _is_determined(information: Array, rounding: float) -> bool:
    """Whether more than rounding speaks for the pose in every direction, in any unit."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    values = np.linalg.eigvalsh(information * np.outer(scale, scale))
    return bool(values[0] > max(_SINGULAR, rounding**2) * values[-1])


def _rounding(pose: Pose, points: Array) -> float:
    """Error of the directions, in radians, by the digits that the points' coordinates have."""
    distances = np.linalg.norm(points @ pose.rotation.T + pose.translation, axis=1)
    step = np.finfo(float).eps * float(np.abs(points).max())
    return _ROUNDING_STEPS * step / max(float(np.median(distances)), 1e-300)


def _information(pose: Pose, at: _Linearised, weights: Array, level: Gravity) -> Array:
    """Inverse of the covariance of an M-estimator (Huber 1981, 7.6), with what gravity adds."""
    squares = _squares(at.residuals, weights)
    robust = 1.0 / (1.0 + squares / _LOSS_SCALE**2)
    # A Cauchy weight w of a length in the plane has psi' = w^2 on average over the directions.
    count = at.jacobian.shape[2]
    spare = max(2.0 * len(squares) - count, 1.0)
    factor = float(robust**2 @ squares) / spare / float(np.mean(robust**2)) ** 2
    factor *= 1.0 + count / len(squares)  # the noise comes from the same few residuals
    full, _ = _normal_equations(at, weights, np.ones(len(squares)))
    return np.asarray(full / max(factor, 1e-4) + _prior(pose, level, count - 6)[0])


def _shared(
    bearings: Array, at: _Linearised, weights: Array, H: Array, noise: float, least: float
) -> Array:
    """Covariance by errors that fall off with the angle between bearings: stitching, calibration.

    The model and its estimate by the method of moments are those of two views, see
    native/core/robust/shared_error.h; here every residual has two components.
    """
    step = -(-len(bearings) // _SHARED_SAMPLE)
    b, basis = bearings[::step], at.basis[::step]
    count = len(b)
    cosines = np.clip(b @ b.T, -1.0, 1.0)
    K = np.exp(-np.sqrt(np.maximum(2.0 - 2.0 * cosines, 0.0)) / _REACH)
    np.fill_diagonal(K, 0.0)
    residuals = np.einsum("nij,nj->ni", basis, at.residuals[::step])
    J = np.einsum("nij,njk->nik", basis, at.jacobian[::step])  # (M, 3, 6 + k)
    KJ = np.einsum("mn,nik->mik", K, J)
    A = np.einsum("mik,mil->kl", J, KJ)
    G = bounded_inverse(np.einsum("mik,mil->kl", J, J))
    variance = float(np.sum(residuals**2)) / max(2.0 * count - J.shape[2], 1.0)
    observed = float(np.einsum("mi,mn,ni->", residuals, K, residuals))
    expected = -variance * float(np.trace(G @ A))
    # The tangent planes at two bearings share 1 + cos^2 of their two dimensions.
    squares = float(np.sum(K**2 * (1.0 + cosines**2)))
    slope = squares - 2.0 * float(np.trace(G @ np.einsum("mik,mil->kl", KJ, KJ)))
    slope += float(np.trace(A @ G @ A @ G))
    excess = observed - expected
    enough = count >= _FEWEST_SHARED and slope > 0.0
    shows = enough and excess > _SIGNIFICANT * variance * np.sqrt(2.0 * slope)
    tau2 = max(excess / slope if shows else 0.0, (least * noise) ** 2)
    # How the pose moves with the errors: H J^T W, here with the weights.
    JW = np.einsum("nik,nij,njl->nlk", at.jacobian, weights, np.swapaxes(at.basis, 1, 2))[::step]
    KJW = np.einsum("mn,nik->mik", K, JW)
    total = np.einsum("mik,mil->kl", JW, KJW) * (len(bearings) / count) ** 2
    alone = np.einsum("mik,mil->kl", JW, JW) * (len(bearings) / count)
    return np.asarray(tau2 * H @ (total + alone) @ H)
