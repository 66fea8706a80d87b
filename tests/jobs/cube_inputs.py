# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas that are cut into cube faces: pictures whose colors say where each pixel looks."""

import cv2
import numpy as np

from epi360.cameras import Equirectangular
from epi360.interop import PosedImage, Reconstruction
from epi360.poses import Pose

PANORAMA = Equirectangular(256, 128)


def pixel_centres(camera):
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.column_stack([u.ravel(), v.ravel()])


def direction_colors(bearings, camera):
    """A picture whose color says where each pixel looks."""
    colors = np.round(127.5 + 120 * np.nan_to_num(bearings)).astype(np.uint8)
    return colors.reshape(camera.height, camera.width, 3)


def write_png(path, rgb):
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = rgb[..., ::-1] if rgb.ndim == 3 else rgb
    path.write_bytes(cv2.imencode(".png", np.ascontiguousarray(pixels))[1].tobytes())


def read_picture(path):
    return cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def plain_reconstruction(names, camera=PANORAMA, **more):
    images = tuple(
        PosedImage(name, "pano", Pose(np.eye(3), np.array([0.1 * number, 0.0, 0.0])))
        for number, name in enumerate(names)
    )
    return Reconstruction({"pano": camera}, images, **more)


def two_panoramas(tmp_path, names=("a.png", "b.png"), camera=PANORAMA):
    picture = direction_colors(camera.bearings_from_pixels(pixel_centres(camera)), camera)
    for name in names:
        write_png(tmp_path / "in" / name, picture)
    return tmp_path / "in", plain_reconstruction(names, camera)
