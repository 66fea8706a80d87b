# SPDX-License-Identifier: BSD-3-Clause
"""Great circles as curves in an image, and which matches to show them for."""

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.estimation.result import ImagePairResult

Array = NDArray[np.float64]

# A quarter of a degree: 0.7 px of a panorama 1024 px wide.
CURVE_SAMPLES = 1440
SEAM_SAMPLES = 64
# Nearer to an epipole (sine of the angle) a match says nothing about its plane.
MIN_EPIPOLE_SINE = 0.3


def epipolar_curve(camera: Camera, normal: Array, start: Array) -> Array:
    """Great circle with a plane normal as a polyline that passes through ``start``."""
    normal = normal / np.linalg.norm(normal)
    first = start - (start @ normal) * normal
    if np.linalg.norm(first) < 1e-9:  # the start is the pole of the circle: begin anywhere on it
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first = first / np.linalg.norm(first)
    second = np.cross(normal, first)

    def pixels_at(angles: Array) -> Array:
        directions = np.outer(np.cos(angles), first) + np.outer(np.sin(angles), second)
        return camera.pixels_from_bearings(directions)

    angles = np.linspace(0.0, 2.0 * np.pi, CURVE_SAMPLES + 1)
    jumps = _jumps(pixels_at(angles), camera.width)
    # Finer where the curve jumps, so that it reaches the image's border on both sides.
    finer = np.linspace(angles[jumps], angles[jumps + 1], SEAM_SAMPLES + 1)[1:-1]
    pixels = pixels_at(np.sort(np.concatenate([angles, finer.ravel()])))
    return np.insert(pixels, _jumps(pixels, camera.width) + 1, np.nan, axis=0)


def cameras_of_pose(result: ImagePairResult, given: tuple[Camera, Camera]) -> tuple[Camera, Camera]:
    """The cameras that a pose belongs to, or those that were given where there is no such model."""
    first, second = (own or camera for own, camera in zip(result.cameras, given, strict=True))
    return first, second


def shown_residuals_deg(result: ImagePairResult) -> Array:
    """Size of the residual of each match, NaN where no pose is given."""
    if not np.isfinite(result.cam2_from_cam1.rotation).all():
        return np.full(result.num_matches, np.nan)
    return np.degrees(np.abs(result.residuals_rad))


def spread_matches(
    bearings: Array, normals: Array, inlier_mask: NDArray[np.bool_], count: int
) -> NDArray[np.intp]:
    """At most ``count`` inliers that are far apart and whose epipolar planes are far apart."""
    candidates = np.flatnonzero(inlier_mask & np.isfinite(bearings).all(axis=1))
    if not len(candidates):
        return candidates
    lengths = np.nan_to_num(np.linalg.norm(normals[candidates], axis=1))
    if (lengths > MIN_EPIPOLE_SINE).any():
        candidates = candidates[lengths > MIN_EPIPOLE_SINE]
    points, planes = bearings[candidates], np.nan_to_num(normals[candidates])
    planes = planes / np.maximum(np.linalg.norm(planes, axis=1, keepdims=True), 1e-12)
    has_planes = bool(planes.any())
    chosen = [int(np.argmax(points[:, 2]))]  # of all, the match that is most ahead
    apart = np.full(len(points), np.inf)
    while len(chosen) < min(count, len(points)):
        between_points = 1.0 - points @ points[chosen[-1]]
        between_planes = 1.0 - np.abs(planes @ planes[chosen[-1]]) if has_planes else 1.0
        apart = np.minimum(apart, between_points * between_planes)
        chosen.append(int(np.argmax(apart)))
    return candidates[np.unique(chosen)]


def _jumps(pixels: Array, width: int) -> NDArray[np.intp]:
    """Where a polyline jumps: steps longer than half the image's width."""
    return np.flatnonzero(np.linalg.norm(np.diff(pixels, axis=0), axis=1) > width / 2.0)
