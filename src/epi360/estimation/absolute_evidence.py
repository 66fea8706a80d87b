# SPDX-License-Identifier: BSD-3-Clause
"""What speaks for a pose in a map: how many matches agree, and how many would by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import gammaln

from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Matches nearer than this in both the image and the map are one witness, as with pairs of views.
_REGION_RAD = np.radians(3.0)
_SAMPLE_SIZE, _MAX_SOLUTIONS = 3, 4  # of the three-point problem
_EXCHANGED = 600  # matches that exchange partners: 360,000 pairs, of which a few fall into a degree
# Rows of a product at a time: a larger one would wake the threads of BLAS, which then wait for more
# for some milliseconds and take the time of others.
_BLOCK = 50
_RADII_RAD = np.radians([1.0, 2.0, 5.0, 10.0, 20.0])
_BANDS, _SECTORS = 4, 12


@dataclass(frozen=True)
class Evidence:
    """What the matches say of a pose.

    ``log10_false_alarms`` is the expected number of poses that chance would make as good
    (a contrario, Moisan & Stival, IJCV 2004), if every region of 3 degrees is one witness.
    """

    num_usable: int
    num_inliers: int
    num_regions: float  # of the inliers
    inlier_share: float  # of the regions of all matches
    log10_false_alarms: float
    cells: int  # of 48 equal ones of the sphere of view with an inlier
    cells_of_matches: int


def directions_of(pose: Pose, points: Array) -> Array:
    """Unit vectors (N, 3) to points in the frame of a camera."""
    x = points @ pose.rotation.T + pose.translation
    return np.asarray(x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300))


def evidence_for(bearings: Array, directions: Array, inliers: Mask, gate_rad: float) -> Evidence:
    """Evidence of usable matches, bearings (N, 3) and the directions where the pose has points."""
    votes = _votes(bearings, directions)
    total, agreeing = float(votes.sum()), float(votes[inliers].sum())
    chance = chance_of_agreement(bearings, directions, gate_rad)
    return Evidence(
        num_usable=len(bearings),
        num_inliers=int(inliers.sum()),
        num_regions=agreeing,
        inlier_share=agreeing / max(total, 1e-9),
        log10_false_alarms=float(log10_false_alarms(total, np.array([agreeing]), chance)[0]),
        cells=num_cells(bearings[inliers]),
        cells_of_matches=num_cells(bearings),
    )


def chance_of_agreement(bearings: Array, directions: Array, gate_rad: float) -> float:
    """Probability that a wrong match lies inside the gate, from partners that are exchanged.

    That keeps where the matches lie and breaks what they say. Few fall into the gate itself, so
    that those in wider circles are counted, and scaled by the area.
    """
    step = max(1, len(bearings) // _EXCHANGED)
    b, u = bearings[::step], directions[::step]
    if len(b) < 2:
        return 1.0
    limits = np.cos([gate_rad, *_RADII_RAD[_RADII_RAD > gate_rad]])
    within = np.zeros(len(limits))
    for start in range(0, len(b), _BLOCK):
        cosines = b[start : start + _BLOCK] @ u.T
        np.fill_diagonal(cosines[:, start:], -2.0)  # no partner of their own
        within += [np.count_nonzero(cosines > limit) for limit in limits]
    areas = 1.0 - limits  # of the circles, the gate first
    # Of wrong matches all over the sphere, and of those in each circle.
    densities = [0.5, *(within / (len(b) * (len(b) - 1)) / areas)]
    return float(min(1.0, max(densities) * areas[0]))


def log10_false_alarms(total: float, agreeing: Array, chance: float | Array) -> Array:
    """log10 of the expected number of poses that so many of all agree with by chance."""

    def log_binomial(n: float | Array, k: float | Array) -> Array:
        return np.asarray(gammaln(n + 1.0) - gammaln(k + 1.0) - gammaln(n - k + 1.0))

    tests = np.log(_MAX_SOLUTIONS * max(total - _SAMPLE_SIZE, 1.0))
    more = np.maximum(agreeing - _SAMPLE_SIZE, 0.0)
    samples = log_binomial(np.maximum(agreeing, _SAMPLE_SIZE), float(_SAMPLE_SIZE))
    log = tests + log_binomial(total, agreeing) + samples
    log = log + more * np.log(np.maximum(chance, 1e-300))
    return np.asarray(np.where(agreeing > _SAMPLE_SIZE, log / np.log(10.0), np.inf))


def best_gate(bearings: Array, directions: Array, largest_rad: float) -> tuple[float, float]:
    """Gate with the fewest false alarms, in radians, and log10 of their number."""
    residuals = np.sort(angles_of_units(bearings, directions))
    residuals = residuals[residuals < largest_rad]
    if len(residuals) <= _SAMPLE_SIZE:
        return largest_rad, np.inf
    per_area = chance_of_agreement(bearings, directions, largest_rad) / (1 - np.cos(largest_rad))
    chance = np.minimum(per_area * (1.0 - np.cos(np.maximum(residuals, 1e-6))), 1.0)
    counts = np.arange(1.0, len(residuals) + 1.0)
    found = log10_false_alarms(float(len(bearings)), counts, chance)
    best = int(np.argmin(found))
    return float(residuals[best]), float(found[best])


def num_cells(bearings: Array) -> int:
    """Number of the 48 equal cells of the sphere that hold a bearing."""
    band = np.clip(((bearings[:, 1] + 1.0) / 2.0 * _BANDS).astype(int), 0, _BANDS - 1)
    longitude = np.arctan2(bearings[:, 0], bearings[:, 2])
    sector = ((longitude / (2.0 * np.pi) + 0.5) * _SECTORS).astype(int) % _SECTORS
    return len(np.unique(band * _SECTORS + sector))


def _votes(bearings: Array, directions: Array) -> Array:
    """What each match says: those near one another in the image and in the map share one vote."""
    both = np.hstack([bearings, directions])
    near = cKDTree(both).query_ball_point(
        both, np.sqrt(2.0) * 2.0 * np.sin(0.5 * _REGION_RAD), return_length=True
    )
    return np.asarray(1.0 / np.maximum(near, 1))
