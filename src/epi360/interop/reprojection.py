# SPDX-License-Identifier: BSD-3-Clause
"""How far the points of a reconstruction are seen from where its poses put them, in pixels."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.base import FocalCamera
from epi360.interop.reconstruction import Reconstruction


def point_errors_px(reconstruction: Reconstruction) -> NDArray[np.float64]:
    """Mean reprojection error (P,) of each point in pixels, as COLMAP's ERROR; -1 if unknown.

    Observations of which the camera model knows no pixel do not count.
    """
    seen = reconstruction.observations
    count = len(reconstruction.points)
    if seen is None or not len(seen.points):
        return np.full(count, -1.0)
    errors = np.full(len(seen.points), np.nan)
    by_image = np.argsort(seen.images, kind="stable")
    starts = np.searchsorted(seen.images[by_image], np.arange(len(reconstruction.images) + 1))
    for index, image in enumerate(reconstruction.images):
        rows = by_image[starts[index] : starts[index + 1]]
        if not len(rows) or image.camera is None:
            continue
        pose = image.cam_from_world
        in_camera = reconstruction.points[seen.points[rows]] @ pose.rotation.T + pose.translation
        camera = reconstruction.cameras[image.camera]
        errors[rows] = _distances_px(camera, _projected(camera, in_camera), seen.pixels[rows])
    known = np.isfinite(errors)
    counts = np.bincount(seen.points[known], minlength=count)
    sums = np.bincount(seen.points[known], errors[known], minlength=count)
    return np.where(counts > 0, sums / np.maximum(counts, 1), -1.0)


def _projected(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels (N, 2) of points, also beyond the border of the image by up to its size."""
    if not isinstance(camera, FocalCamera):
        return camera.pixels_from_bearings(points)
    width, height = camera.width, camera.height
    center = {"cx": camera.cx + width, "cy": camera.cy + height}
    wider = replace(camera, width=3 * width, height=3 * height, **center)
    return wider.pixels_from_bearings(points) - (width, height)


def _distances_px(
    camera: Camera, found: NDArray[np.float64], seen: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances (N,) of pixels (N, 2), across the seam of a panorama where that is shorter."""
    across, down = (found - seen).T
    if camera.wraps:
        across = np.mod(across + camera.width / 2, camera.width) - camera.width / 2
    return np.asarray(np.hypot(across, down))
