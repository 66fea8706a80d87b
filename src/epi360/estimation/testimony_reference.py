# SPDX-License-Identifier: BSD-3-Clause
"""What regions and exchanged neighbours say for a pose, in plain NumPy: the twin of the core's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar.residuals import pose_residuals, residual_jacobians
from epi360.poses import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Gravity = tuple[Array, Array]

LARGEST_GROUP = 5  # matches that all exchange partners
NEIGHBOURHOOD = 4.0  # side of one, in gates: nearer partners agree with whatever theirs agree with
REGION_RAD = np.radians(3.0)  # matches nearer in both views share one vote
STILL_RAD = np.radians(1.0)
UNDERFOOT_COSINE = 0.866  # of 30 degrees
LARGEST_WRONG_PARALLAX = 0.07  # radians, of a match that counts as in front
FREE_INFORMATION = 1.0  # per radian^2


class Testimony(NamedTuple):
    """Log-likelihood ratio, standard deviation of the direction (radians), regions that agree."""

    log_ratio: float
    direction_sigma: float
    num_regions: float


def reference_testimony(
    bearings1: Array,
    bearings2: Array,
    cam2_from_cam1: Pose,
    *,
    scale: float,
    gate: float,
    density: float,
    gravity: Gravity | None = None,
) -> Testimony:
    """Return what at most 512 matches (N, 3) of unit bearings say for a pose.

    ``scale`` and ``gate`` are those of the inliers' Sampson residuals and ``density`` is that of
    wrong matches' residuals, per radian.
    """
    front_rad = min(gate, LARGEST_WRONG_PARALLAX)

    def agrees(b1: Array, b2: Array) -> Mask:
        residuals = pose_residuals(cam2_from_cam1, b1, b2)
        return in_front(cam2_from_cam1, b1, b2, front_rad) & (np.abs(residuals) < gate)

    residuals = pose_residuals(cam2_from_cam1, bearings1, bearings2)
    votes = votes_of(bearings1, bearings2, gravity)
    inliers = agrees(bearings1, bearings2)
    still = inliers & (np.linalg.norm(bearings1 - bearings2, axis=1) < max(gate, STILL_RAD))
    if 2 * still.sum() < inliers.sum():
        votes[still] = 0.0
    right = np.exp(-0.5 * (residuals / scale) ** 2) / (np.sqrt(2.0 * np.pi) * scale)
    right *= in_front(cam2_from_cam1, bearings1, bearings2, front_rad)
    exchanged = agreement_by_exchange(bearings1, bearings2, gate, agrees)
    odds = right / np.maximum(density, exchanged / (2.0 * gate))
    share = share_of_right(votes, odds)
    both = share * odds + 1.0 - share
    agreeing = votes * share * odds / both
    trust = epipole_trust(cam2_from_cam1, bearings1, bearings2, scale**2)
    J = residual_jacobians(cam2_from_cam1, bearings1, bearings2)
    information = (J * (trust**2 * agreeing)[:, None]).T @ J / scale**2
    covariance = np.linalg.inv(FREE_INFORMATION * np.eye(5) + information)
    return Testimony(
        float(votes @ np.log(both)), float(np.sqrt(covariance[3:, 3:].trace())), agreeing.sum()
    )


def rotation_log_ratio_reference(
    bearings1: Array,
    bearings2: Array,
    rotation: Array,
    *,
    scale: float,
    gate: float,
    wrong_share: float,
) -> float:
    """Return the log-likelihood ratio of a rotation alone; ``wrong_share`` pass its gate."""

    def agrees(b1: Array, b2: Array) -> Mask:
        return rotation_residuals(b1, b2, rotation) < gate

    residuals = rotation_residuals(bearings1, bearings2, rotation)
    within = np.maximum(wrong_share, agreement_by_exchange(bearings1, bearings2, gate, agrees))
    # Right ones scatter as two Gaussian components do; wrong ones fill the disc of the gate evenly.
    odds = 0.5 * (gate / scale) ** 2 / within * np.exp(-0.5 * (residuals / scale) ** 2)
    votes = region_votes(bearings1, bearings2)
    share = share_of_right(votes, odds)
    return float(votes @ np.log(share * odds + 1.0 - share))


def rotation_residuals(bearings1: Array, bearings2: Array, rotation: Array) -> Array:
    """Angles (N,) between R b1 and b2 over the root of two."""
    a = bearings1 @ rotation.T
    difference, total = (np.linalg.norm(x, axis=1) for x in (a - bearings2, a + bearings2))
    return np.asarray(2.0 * np.arctan2(difference, total) / np.sqrt(2.0))


def in_front(cam2_from_cam1: Pose, bearings1: Array, bearings2: Array, tolerance: float) -> Mask:
    """Whether both depths are positive up to so much parallax of the wrong sign, in radians."""
    t = cam2_from_cam1.translation
    a = bearings1 @ cam2_from_cam1.rotation.T
    cosine, ta, tb = np.sum(a * bearings2, axis=1), a @ t, bearings2 @ t
    return np.asarray(np.minimum(cosine * tb - ta, tb - cosine * ta) > -tolerance)


def epipole_trust(
    cam2_from_cam1: Pose, bearings1: Array, bearings2: Array, variance: float
) -> Array:
    """How far the first-order residuals (N,) of noisy bearings can be trusted, in [0, 1]."""
    t = cam2_from_cam1.translation
    a = bearings1 @ cam2_from_cam1.rotation.T
    squared = (np.cross(a, t) ** 2).sum(axis=1) + (np.cross(bearings2, t) ** 2).sum(axis=1)
    return np.asarray(squared / (squared + 8.0 * variance))


def region_votes(bearings1: Array, bearings2: Array) -> Array:
    """Votes (N,) of matches of which each region has one."""
    return np.asarray(1.0 / _in_one_region(bearings1, bearings2).sum(axis=1))


def one_of_each_region(bearings1: Array, bearings2: Array) -> list[int]:
    """Rows of the first matches of which no two are one region."""
    near = _in_one_region(bearings1, bearings2)
    chosen: list[int] = []
    for row in range(len(near)):
        if not near[row, chosen].any():
            chosen.append(row)
    return chosen


def _in_one_region(bearings1: Array, bearings2: Array) -> Mask:
    """Which matches (N, N) lie near each other in both views."""
    chord = 2.0 * np.sin(0.5 * REGION_RAD)

    def near(b: Array) -> Mask:
        return np.asarray(np.linalg.norm(b[:, None] - b[None], axis=2) <= chord)

    return near(bearings1) & near(bearings2)


def votes_of(bearings1: Array, bearings2: Array, gravity: Gravity | None) -> Array:
    """Votes of regions; what both views see underfoot has none, unless it is most."""
    votes = region_votes(bearings1, bearings2)
    if gravity is not None:
        down = np.minimum(bearings1 @ gravity[0], bearings2 @ gravity[1])
        underfoot = down > UNDERFOOT_COSINE
        if 2 * underfoot.sum() < len(votes):
            votes[underfoot] = 0.0
    return votes


def agreement_by_exchange(
    bearings1: Array, bearings2: Array, gate: float, agrees: Callable[[Array, Array], Mask]
) -> Array:
    """Share (N,) of its neighbours' partners with which each match would be an inlier too."""
    agreeing, tried = np.zeros(len(bearings1)), np.zeros(len(bearings1))
    for view in (bearings1, bearings2):
        for group in neighbour_groups(view, NEIGHBOURHOOD * gate):
            num_others = min(len(group), LARGEST_GROUP)
            shifts = np.arange(1, num_others) * len(group) // num_others
            own, other = np.repeat(group, len(shifts)), _shifted(group, shifts)
            rows1, rows2 = (own, other) if view is bearings1 else (other, own)
            np.add.at(agreeing, own, agrees(bearings1[rows1], bearings2[rows2]))
            np.add.at(tried, own, 1.0)
    return agreeing / np.maximum(tried, 1.0)


def _shifted(group: NDArray[np.intp], shifts: NDArray[np.intp]) -> NDArray[np.intp]:
    places = (np.arange(len(group))[:, None] + shifts) % len(group)
    return np.asarray(group[places].ravel())


def neighbour_groups(bearings: Array, reach: float) -> Iterator[NDArray[np.intp]]:
    """Rows of neighbours along x.

    The longest side of a set is halved until three to five are left, or it is shorter than
    ``reach`` (radians).
    """
    shortest = 2.0 * np.sin(0.5 * min(reach, np.pi))
    for rows in _halves(bearings, np.arange(len(bearings)), shortest):
        yield rows[np.argsort(bearings[rows, 0], kind="stable")]


def _halves(bearings: Array, rows: NDArray[np.intp], shortest: float) -> Iterator[NDArray[np.intp]]:
    if len(rows) <= LARGEST_GROUP:
        yield rows
        return
    sides = np.ptp(bearings[rows], axis=0)
    if sides.max() < shortest:
        yield rows
        return
    axis = int(np.argmax(sides))
    order = rows[np.argsort(bearings[rows, axis], kind="stable")]
    middle = len(rows) // 2
    for half in (order[:middle], order[middle:]):
        yield from _halves(bearings, np.sort(half), shortest)


def share_of_right(votes: Array, odds: Array) -> float:
    """The likeliest share of right matches, by expectation maximisation."""
    total = votes.sum()
    if not total > 0.0:
        return 0.0
    share = 0.3
    for _ in range(30):
        posterior = share * odds / (share * odds + 1.0 - share)
        following = float(np.clip(votes @ posterior / total, 1e-6, 0.98))
        settled = abs(following - share) < 1e-3 * share
        share = following
        if settled:
            break
    return share
