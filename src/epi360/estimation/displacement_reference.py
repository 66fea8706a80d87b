# SPDX-License-Identifier: BSD-3-Clause
"""What a residual is worth by how far its partner lies off, in NumPy: the twin of the core's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from epi360.epipolar.residuals import pose_residuals
from epi360.estimation.testimony_reference import in_front
from epi360.poses import Pose

Array = NDArray[np.float64]

NEAREST_RAD = np.radians(1.0)  # no wrong partner is expected nearer
_MOST_ALIGNED = 128  # matches that tell the rotation
_FROM_SCALE, _TO_SCALE, _NARROWING = np.radians(60.0), np.radians(3.0), 0.6
_SHARE_ROUNDS = 3  # of expectation maximisation
_TAIL, _NEAR_MISSES = 0.5, 1.0  # most matches of the second and third part, over the first's


def displacements(bearings1: Array, bearings2: Array) -> Array:
    """Sines of the displacements (N,): how far partners lie from where they would without a step.

    ``bearings1`` and ``bearings2`` (N, 3) are unit vectors. A displacement is the angle between
    R b1 and b2 under the rotation that most matches are near, or between b1 and b2 if that is less,
    as for what the camera carries. The rotation is found by graduated non-convexity
    (Geman-McClure).
    """
    step = max(1, len(bearings1) // _MOST_ALIGNED)
    b1, b2 = bearings1[::step], bearings2[::step]
    turn, _ = Rotation.align_vectors(b2, b1)
    scale = _FROM_SCALE
    while scale > _TO_SCALE:
        squares = np.sum((turn.apply(b1) - b2) ** 2, axis=1) / scale**2
        turn, _ = Rotation.align_vectors(b2, b1, weights=(1.0 + squares) ** -2)
        scale *= _NARROWING
    turned, carried = (np.cross(each, bearings2) for each in (turn.apply(bearings1), bearings1))
    lengths = np.linalg.norm(turned, axis=1), np.linalg.norm(carried, axis=1)
    return np.asarray(np.minimum(*lengths))


def log_odds_over_chance(
    cam2_from_cam1: Pose,
    bearings1: Array,
    bearings2: Array,
    *,
    scale: float,
    shares: Array,
    outlier_density: float,
    depth_tolerance: float,
) -> float:
    """Log-odds of matches (N, 3) under a mixture at a pose, over wrong matches alone.

    The mixture has Gaussians of ``scale`` (radians) and 4, 16 and 64 times that, which hold
    ``shares`` (4,) of the matches at first; the rest are wrong. Partners displaced in a random
    direction by an angle l have Sampson residuals in front of both cameras with a density of
    1 / (sqrt(2) pi sin l) per radian near zero: chance, where l counts as a degree at least. It is
    no less than ``outlier_density``, that of partners from anywhere, and no more than the peak of
    the narrowest Gaussian.
    """
    sines = np.maximum(displacements(bearings1, bearings2), NEAREST_RAD)
    reach = np.sqrt(2.0) * np.pi * sines
    reach = np.clip(reach, np.sqrt(2.0 * np.pi) * scale, 1.0 / outlier_density)
    residuals = pose_residuals(cam2_from_cam1, bearings1, bearings2)
    front = in_front(cam2_from_cam1, bearings1, bearings2, depth_tolerance)
    scales = scale * 4.0 ** np.arange(4)
    z = residuals[:, None] / scales
    odds = np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * scales) * (reach * front)[:, None]
    for _ in range(_SHARE_ROUNDS):
        parts = shares * odds
        total = parts.sum(axis=1) + 1.0 - shares.sum()
        shares = _limited((parts / total[:, None]).mean(axis=0))
    return float(np.log(total).sum())


def _limited(shares: Array) -> Array:
    """Shares that keep the inliers the main body of the mixture: wider parts hold only so many."""
    shares = shares.copy()
    shares[0] = max(shares[0], 1e-3)
    for part, most in ((1, _TAIL), (2, _NEAR_MISSES)):
        if shares[part] > most * shares[0]:
            both = shares[0] + shares[part]
            shares[0] = both / (1.0 + most)
            shares[part] = both - shares[0]
    return np.asarray(shares * min(1.0, 0.999 / shares.sum()))
