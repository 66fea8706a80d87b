# SPDX-License-Identifier: BSD-3-Clause
"""Where down is in the images of cameras that stand upright."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.base import Camera
from epi360.cameras.equirectangular import Equirectangular

DOWN = np.array([0.0, 1.0, 0.0])  # y is down in the frame of every upright camera
DOWN.setflags(write=False)


def gravity_of(
    camera: Camera, stated: NDArray[np.float64] | None, name: str
) -> NDArray[np.float64]:
    """Direction of gravity in an upright panorama; what its file states comes first.

    ValueError where the image, which messages call ``name``, is no panorama.
    """
    if not isinstance(camera, Equirectangular):
        raise ValueError(
            "--upright needs panoramas, which are stitched with the nadir at the bottom; of "
            f"{name}, which has the camera model {type(camera).__name__}, nobody knows where down "
            "is"
        )
    return DOWN if stated is None else stated


def check_upright(upright_deg: float | None) -> None:
    """Raise ``ValueError`` where a panorama cannot stand upright to so many degrees."""
    if upright_deg is not None and not 0.0 < upright_deg <= 45.0:
        raise ValueError(f"--upright must be in (0, 45] degrees, got {upright_deg}")


def is_full_panorama(camera: Camera) -> bool:
    """Whether a camera sees the whole sphere, the horizon in the middle of its images."""
    return camera == Equirectangular(camera.width, camera.height)


def has_a_vertical(camera: Camera) -> bool:
    """Whether a camera that stands upright has down in the middle of its lowest rows."""
    return isinstance(camera, Equirectangular)


def tilt_deg(rotation: NDArray[np.float64]) -> float:
    """Angle between the vertical axes of two cameras, by the rotation from one to the other."""
    turned = rotation @ DOWN
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(turned, DOWN)), turned @ DOWN)))


def elevation_deg(direction: NDArray[np.float64]) -> float:
    """Angle of a direction over the horizon of an upright camera."""
    x, y, z = direction
    return float(np.degrees(np.arctan2(-y, np.hypot(x, z))))
