# SPDX-License-Identifier: BSD-3-Clause
"""Points that accepted pairs triangulate, and how large one pair's units are in another's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360.epipolar.essential import triangulate
from epi360.poses import Pose

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LEAST_NOISE_DEG = 0.05
# Two pairs share the scale by so many key points, or by so many points in about one direction.
_FEWEST_SHARED, _FEWEST_NEAR, _NEAR_DEG = 4, 8, 3.0
_FEWEST_POINTS = 6
_LARGEST_SCALE_SIGMA, _LEAST_SCALE_SIGMA = 0.15, 0.005
MOST_WITNESSES = 12  # pairs that are asked at either end
# Of the inliers, in both images; a pair of which so many lie below the horizon is on the floor.
FLOOR_SHARE = 0.97
_BELOW_HORIZON = np.sin(np.radians(5.0))  # y of what a level camera sees five degrees below it
PLACE_SIGMA_DEG = 0.5  # what is looked for in another view has a place that is known to this


@dataclass(frozen=True, eq=False)
class PosedPair:
    """A pair that is accepted, or whose doubted pose is looked at.

    ``images`` are numbers, ``keypoints`` the key points of the inliers in both, ``bearings`` where
    these look. Units are the translation's length.
    """

    images: tuple[int, int]
    cam2_from_cam1: Pose
    keypoints: tuple[Indices, Indices]
    bearings: tuple[Array, Array]
    noise_deg: float
    rotation_sigma_deg: float
    translation_sigma_deg: float

    @classmethod
    def of(
        cls,
        images: tuple[int, int],
        pose: Pose,
        inliers: Indices,
        bearings: Sequence[Array],
        *,
        noise_deg: float = 0.0,
        rotation_sigma_deg: float = 0.0,
        translation_sigma_deg: float = 0.0,
    ) -> PosedPair:
        """A pair whose inliers (N, 2) are rows of all key points of both images.

        ``bearings`` are where the key points of both look.
        """
        first, second = inliers.T
        return cls(
            images,
            pose,
            (first, second),
            (bearings[0][first], bearings[1][second]),
            noise_deg,
            rotation_sigma_deg,
            translation_sigma_deg,
        )

    def other_from(self, side: int) -> Pose:
        """Pose of the other camera in the frame of the camera of a side."""
        return self.cam2_from_cam1.inverse() if side else self.cam2_from_cam1


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points (N, 3) in the frame of a camera.

    ``keypoints`` are the camera's, ``log_sigmas`` the standard deviations of the logarithms of
    distances.
    """

    points: Array
    keypoints: Indices
    log_sigmas: Array

    @property
    def distances(self) -> Array:
        """Distance of each point from the camera, shape (N,)."""
        return np.asarray(np.linalg.norm(self.points, axis=1))

    def scaled(self, scale: float, log_sigma: float) -> Cloud:
        """Return this cloud in other units, which are known as well as that."""
        return Cloud(scale * self.points, self.keypoints, np.hypot(self.log_sigmas, log_sigma))


def cloud_of(pair: PosedPair, side: int, least_parallax_deg: float) -> Cloud:
    """Points of a pair in the frame of the camera of one side."""
    here, there = pair.bearings[side], pair.bearings[1 - side]
    points, depths, _ = triangulate(here, there, pair.other_from(side))
    turned = here @ pair.other_from(side).rotation.T
    sines = np.linalg.norm(np.cross(turned, there), axis=1)
    parallaxes = np.arctan2(sines, np.sum(turned * there, axis=1))
    kept = (np.degrees(parallaxes) > least_parallax_deg) & (depths > 0)
    noise_rad = np.radians(max(pair.noise_deg, _LEAST_NOISE_DEG)) * 2.0**0.5
    log_sigmas = noise_rad / np.maximum(sines, 1e-3)
    return Cloud(points[kept], pair.keypoints[side][kept], log_sigmas[kept])


def scale_between(own: Cloud, other: Cloud) -> tuple[float, float] | None:
    """Factor from the units of another cloud of the same camera to ours, and its log's sigma.

    None where too little says it.
    """
    if min(len(own.points), len(other.points)) < _FEWEST_POINTS:
        return None
    log_own, log_other = np.log(own.distances), np.log(other.distances)
    _, rows, others = np.intersect1d(own.keypoints, other.keypoints, return_indices=True)
    num_witnesses = len(rows)
    if num_witnesses < _FEWEST_SHARED:
        tree = cKDTree(own.points / own.distances[:, None])
        gaps, nearest = tree.query(other.points / other.distances[:, None])
        others = np.flatnonzero(gaps < np.radians(_NEAR_DEG))
        if len(others) < _FEWEST_NEAR:
            return None
        rows = nearest[others]
        num_witnesses = len(np.unique(rows))
    found = scale_of(log_own[rows] - log_other[others], num_witnesses)
    return None if found is None else (float(np.exp(found[0])), found[1])


def scale_of(log_ratios: Array, num_witnesses: float) -> tuple[float, float] | None:
    """Median of the logarithms of ratios of distances, and its standard deviation.

    As many of them are independent as ``num_witnesses`` says. None where it is not known well.
    """
    middle = float(np.median(log_ratios))
    scatter = 1.4826 * float(np.median(np.abs(log_ratios - middle)))
    sigma = max(1.2533 * scatter / num_witnesses**0.5, _LEAST_SCALE_SIGMA)
    return (middle, sigma) if sigma < _LARGEST_SCALE_SIGMA else None


def place_sigmas_deg(pair: PosedPair, side: int, seen: Array, log_sigmas: Array) -> Array:
    """How well the places of points in the view of the other camera than that of a side are known.

    ``seen`` (N, 3) are the points in the frame of that other camera, ``log_sigmas`` the standard
    deviations of the logarithms of their distances from the camera of the side.
    """
    ranges = np.maximum(np.linalg.norm(seen, axis=1), 1e-9)
    baseline = pair.other_from(side).translation
    across = np.linalg.norm(np.cross(seen, baseline), axis=1) / ranges**2
    sigmas = np.hypot(np.degrees(across * log_sigmas), pair.rotation_sigma_deg)
    return np.asarray(np.hypot(sigmas, pair.translation_sigma_deg / ranges))


def floor_share(bearings1: Array, bearings2: Array) -> float:
    """Share of some matches that both images see well below the horizon; NaN without any."""
    if len(bearings1) == 0:
        return np.nan
    heights = np.minimum(bearings1[:, 1], bearings2[:, 1])
    return float(np.mean(heights > _BELOW_HORIZON))


def some_of(rows: Indices, most: int) -> Indices:
    """As many rows, spread over all."""
    some: Indices = rows[np.linspace(0, len(rows) - 1, min(len(rows), most)).astype(int)]
    return some
