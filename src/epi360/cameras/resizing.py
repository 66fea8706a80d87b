# SPDX-License-Identifier: BSD-3-Clause
"""How finely a camera sees, and the camera of a picture that was made smaller or larger."""

import math
from collections.abc import Iterable
from dataclasses import fields, replace

import numpy as np

from epi360.cameras.base import Camera
from epi360.cameras.equirectangular import Equirectangular


def pixels_per_radian(camera: Camera) -> float:
    """Resolution in the middle of the image, the mean of both directions; of a panorama, across.

    NaN if the middle has no ray.
    """
    if isinstance(camera, Equirectangular):  # whose middle may be far from the horizon
        return camera.width / math.radians(camera.horizontal_fov_deg)
    middle = np.array([[camera.width / 2, camera.height / 2]])
    return math.sqrt(2) / float(np.linalg.norm(camera.bearing_jacobians(middle)[0]))


def smallest_pixel_deg(cameras: Iterable[Camera]) -> float:
    """Angle of a pixel at the middle of the image, the smallest one of some cameras."""
    return math.degrees(1.0 / max(map(pixels_per_radian, cameras)))


def resized_camera(camera: Camera, width: int, height: int | None = None) -> Camera:
    """Camera of the picture after resizing it to a width; the height follows, rounded, or is given.

    Of a lens with one focal length, or distortion, width and height must change alike, nearly.
    """
    if height is None:
        height = max(1, round(camera.height * width / camera.width))
    scales = {"x": width / camera.width, "y": height / camera.height}
    # Continuous pixels scale without an offset. Panoramas have angles only, which stay.
    scaled = {
        field.name: getattr(camera, field.name) * scales[field.name[1]]
        for field in fields(camera)
        if field.name in ("fx", "fy", "cx", "cy")
    }
    return replace(camera, width=width, height=height, **scaled)
