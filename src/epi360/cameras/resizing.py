# SPDX-License-Identifier: BSD-3-Clause
"""How finely a camera sees, and the camera of a picture that was made smaller or larger."""

import math
from collections.abc import Iterable
from dataclasses import fields, replace

import numpy as np

from epi360.cameras.base import Camera
from epi360.cameras.equirectangular import Equirectangular

# No lens has so large an angle across, even where its edges are stretched.
_MOST_RADIANS = 40.0
_ALL_OVER = np.stack(np.meshgrid(*[np.linspace(0.05, 0.95, 10)] * 2), axis=-1).reshape(-1, 2)


def pixels_per_radian(camera: Camera) -> float:
    """Resolution in the middle of the image, the mean of both directions; of a panorama, across.

    If the middle has no ray, as of one of the two lenses of a raw frame, it is the resolution at
    the principal point, or else that of what has rays. ``ValueError`` if nothing has one, or
    lengths are not in pixels.
    """
    if isinstance(camera, Equirectangular):  # whose middle may be far from the horizon
        return camera.width / math.radians(camera.horizontal_fov_deg)
    size = np.array([camera.width, camera.height])
    middle = size / 2
    principal = np.array([getattr(camera, "cx", np.nan), getattr(camera, "cy", np.nan)])
    is_inside = ((principal >= 0) & (principal <= size)).all()
    for pixels in (middle, principal if is_inside else middle, size * _ALL_OVER):
        jacobians = camera.bearing_jacobians(np.atleast_2d(pixels))
        lengths = np.linalg.norm(jacobians, axis=(1, 2))
        lengths = lengths[np.isfinite(lengths)]
        if len(lengths):
            break
    if len(lengths) and camera.width * np.median(lengths) <= math.sqrt(2) * _MOST_RADIANS:
        return math.sqrt(2) / float(np.median(lengths))
    raise ValueError(
        f"the camera ({camera.width}x{camera.height}) must have as many pixels as its angles need; "
        f"cx {principal[0]:g}, cy {principal[1]:g} and fx {getattr(camera, 'fx', np.nan):g} must "
        "be in pixels of this size"
    )


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
