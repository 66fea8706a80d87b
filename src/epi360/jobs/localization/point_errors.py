# SPDX-License-Identifier: BSD-3-Clause
"""How uncertain the points of a model are, from the rays that see them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.interop.reconstruction import Reconstruction
from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]

_RELATIVE_FLOOR = 1e-12  # of the largest value of the information, where rays are parallel


def point_covariances(model: Reconstruction) -> Array:
    """Covariance (P, 3, 3) of each point, in the unit of the model squared.

    The poses are taken for true, and the noise of the bearings is that of the residuals; a point
    that nothing sees has none to speak of.
    """
    seen = model.observations
    count = len(model.points)
    if seen is None or not len(seen.points):
        return np.zeros((count, 3, 3))
    centers = np.array([image.cam_from_world.inverse().translation for image in model.images])
    away = model.points[seen.points] - centers[seen.images]
    distances = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    rays = away / distances[:, None]
    residuals = angles_of_units(_observed_rays(model), rays)
    residuals = residuals[np.isfinite(residuals)]
    # Each point took three of the numbers of its observations.
    spare = max(1.0 - 1.5 * len(np.unique(seen.points)) / len(seen.points), 0.2)
    noise = float(np.median(residuals)) / np.sqrt(2.0 * np.log(2.0) * spare)
    information = np.zeros((count, 3, 3))
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    np.add.at(information, seen.points, across / (distances * max(noise, 1e-9))[:, None, None] ** 2)
    values, vectors = np.linalg.eigh(information)
    largest = values[:, -1:]
    least = np.maximum(values, _RELATIVE_FLOOR * largest)  # rounding may leave less than nothing
    inverse = np.divide(1.0, least, out=np.zeros_like(values), where=largest > 0.0)
    return np.asarray((vectors * inverse[:, None, :]) @ np.swapaxes(vectors, 1, 2))


def _observed_rays(model: Reconstruction) -> Array:
    """Directions in the world (K, 3) in which the images see their points."""
    seen = model.observations
    assert seen is not None
    rays = np.full((len(seen.points), 3), np.nan)
    order = np.argsort(seen.images, kind="stable")
    starts = np.searchsorted(seen.images[order], np.arange(len(model.images) + 1))
    for number, image in enumerate(model.images):
        rows = order[starts[number] : starts[number + 1]]
        if len(rows):
            camera = model.cameras[str(image.camera)]
            rays[rows] = world_rays(camera, image.cam_from_world, seen.pixels[rows])
    return rays


def world_rays(camera: Camera, cam_from_world: Pose, pixels: Array) -> Array:
    """Directions (N, 3) in the world of pixels of a posed image."""
    return np.asarray(camera.bearings_from_pixels(pixels) @ cam_from_world.rotation)
