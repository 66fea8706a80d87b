# SPDX-License-Identifier: BSD-3-Clause
"""What the pose of a lens beside a panorama hangs on its focal length.

In two images of one lens, much of what a wrong focal length does cancels out. Beside a panorama
nothing cancels: where a photograph shows little more than one wall, any focal length agrees with
some pose, and one that is a percent longer moves the camera's direction by degrees. The matches
agree with that as well, so that neither their number nor their noise tells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.base import FocalCamera
from epi360.estimation.refinement import refine_pose
from epi360.estimation.result import RelativePoseResult
from epi360.poses import vector_from_rotation

Array = NDArray[np.float64]

FOCAL_SIGMA = 0.01  # to which a focal length is thought to be known
_MUCH_DEG = 2.0  # that the pose moves by so much is worth a word
_FEWEST_INLIERS = 5


def with_focal_uncertainty(
    result: RelativePoseResult, bearings: tuple[Array, Array], cameras: tuple[Camera, Camera]
) -> RelativePoseResult:
    """Return the result with what a focal length known to a percent adds to its covariance.

    ``bearings``, (N, 3) each, are those that it was estimated from. Only of a lens beside a
    panorama; a warning says so where the pose depends on the focal length by much.
    """
    view = view_of_lens(cameras)
    if view is None or not result.success or result.num_inliers < _FEWEST_INLIERS:
        return result
    seen = [bearings[0][result.inlier_mask], bearings[1][result.inlier_mask]]
    lens = cameras[view]
    assert isinstance(lens, FocalCamera)
    pixels = lens.pixels_from_bearings(seen[view])
    poses = []
    for factor in (1.0 + FOCAL_SIGMA, 1.0 - FOCAL_SIGMA):
        other = replace(lens, fx=factor * lens.fx, fy=factor * lens.fy)
        seen[view] = other.bearings_from_pixels(pixels)
        poses.append(refine_pose(seen[0], seen[1], result.cam2_from_cam1).pose)
    longer, shorter = poses
    turn = 0.5 * vector_from_rotation(longer.rotation @ shorter.rotation.T)
    shift = 0.5 * result.translation_basis.T @ (longer.translation - shorter.translation)
    moved = np.concatenate([turn, shift])
    told = replace(result, covariance=result.covariance + np.outer(moved, moved))
    turned_deg, moved_deg = np.degrees([np.linalg.norm(turn), np.linalg.norm(shift)])
    if max(turned_deg, moved_deg) < _MUCH_DEG:
        return told
    warning = (
        f"the pose depends on the focal length of image {view + 1}: 1 % more turns it by "
        f"{turned_deg:.1f} degrees and moves its direction by {moved_deg:.1f}"
    )
    return replace(told, warnings=(*told.warnings, warning))


def view_of_lens(cameras: tuple[Camera, Camera]) -> int | None:
    """Which of two images, 0 or 1, is of a lens, if the other is a panorama."""
    for view in (0, 1):
        is_lens = isinstance(cameras[view], FocalCamera)
        if is_lens and isinstance(cameras[1 - view], Equirectangular):
            return view
    return None
