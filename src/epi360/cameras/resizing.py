# SPDX-License-Identifier: BSD-3-Clause
"""The camera of a picture that was made smaller or larger."""

from dataclasses import fields, replace

from epi360.cameras.base import Camera


def resized_camera(camera: Camera, width: int) -> Camera:
    """Camera of the picture after resizing it to a width; the height follows, rounded."""
    height = max(1, round(camera.height * width / camera.width))
    scales = {"x": width / camera.width, "y": height / camera.height}
    # Continuous pixels scale without an offset. Panoramas have angles only, which stay.
    scaled = {
        field.name: getattr(camera, field.name) * scales[field.name[1]]
        for field in fields(camera)
        if field.name in ("fx", "fy", "cx", "cy")
    }
    return replace(camera, width=width, height=height, **scaled)
