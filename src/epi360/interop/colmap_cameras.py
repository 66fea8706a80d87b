# SPDX-License-Identifier: BSD-3-Clause
"""Our cameras to pycolmap's and back; `epi360.cameras.calibration.colmap` pairs the models."""

from typing import Any

from epi360.cameras import Camera
from epi360.cameras.calibration.colmap import camera_of_model, model_of_camera
from epi360.extras import extra_library


def colmap_camera(camera: Camera) -> Any:
    """Return a ``pycolmap.Camera`` with the same rays, of the simplest model that is exactly equal.

    It has no id, and its focal length counts as known. The ``max_angle_deg`` of a fisheye is lost.
    In COLMAP 4.2 only panoramas have rays behind the camera; pixels of a fisheye that look 90
    degrees or more from the axis have no ray there, or a wrong one.

    Raises
    ------
    ValueError
        If COLMAP has no such model: for a part of a panorama, `DoubleSphere`, and `UnifiedCamera`
        with xi other than 0.
    ImportError
        If pycolmap is missing.
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
    """Return the camera with the same rays as a ``pycolmap.Camera``.

    Raises
    ------
    ValueError
        If epi360 has no such model, for example ``FULL_OPENCV``.
    """
    return camera_of_model(camera.model_name, camera.width, camera.height, camera.params.tolist())
