# SPDX-License-Identifier: BSD-3-Clause
"""Cameras to pycolmap's and back. Which model is which: `epi360.cameras.calibration.colmap`."""

from __future__ import annotations

from typing import Any

from epi360.cameras import Camera
from epi360.cameras.calibration.colmap import camera_of_model, model_of_camera
from epi360.extras import extra_library


def colmap_camera(camera: Camera) -> Any:
    """`pycolmap.Camera` with the same rays: the simplest of COLMAP's models that is exactly equal.

    Parameters
    ----------
    camera : Camera
        ``max_angle_deg`` of a fisheye is left out: COLMAP has no place for it.

    Returns
    -------
    camera : pycolmap.Camera
        Without an id; its focal length counts as known.

    Raises
    ------
    ValueError
        If COLMAP has no such model: part of a panorama, `DoubleSphere`, `UnifiedCamera` with xi.
    ImportError
        If pycolmap is missing.

    Notes
    -----
    Within COLMAP 4.2 only panoramas have rays behind the camera: pixels of a fisheye that look 90
    degrees or more from the axis have none, or wrong ones.
    """
    pycolmap = extra_library("pycolmap", extra="colmap", purpose="COLMAP cameras")
    model, parameters = model_of_camera(camera)
    return pycolmap.Camera(
        model=model,
        width=camera.width,
        height=camera.height,
        params=parameters,
        has_prior_focal_length=True,
    )


def camera_from_colmap(camera: Any) -> Camera:
    """Camera with the same rays as one of pycolmap.

    Parameters
    ----------
    camera : pycolmap.Camera

    Returns
    -------
    Camera

    Raises
    ------
    ValueError
        If epi360 has no such model, for example ``FULL_OPENCV``.
    """
    return camera_of_model(camera.model_name, camera.width, camera.height, camera.params.tolist())
