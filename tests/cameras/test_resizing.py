# SPDX-License-Identifier: BSD-3-Clause
"""A resized picture shows the same directions."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.cameras.resizing import resized_camera


@pytest.mark.parametrize(
    "camera",
    [
        Equirectangular(1000, 500),
        Equirectangular(600, 400, horizontal_fov_deg=200, vertical_fov_deg=100),
        KannalaBrandt(600, 400, 140.0, 141.0, 301.0, 199.0, 0.01, -0.002, 0.0, 0.0),
    ],
)
def test_a_scaled_pixel_looks_in_the_same_direction(camera):
    small = resized_camera(camera, 300)
    pixels = np.random.default_rng(0).uniform(0.2, 0.8, (50, 2)) * (camera.width, camera.height)
    scale = np.array([small.width / camera.width, small.height / camera.height])
    np.testing.assert_allclose(
        small.bearings_from_pixels(pixels * scale), camera.bearings_from_pixels(pixels), atol=1e-12
    )


def test_the_height_is_rounded():
    assert resized_camera(Equirectangular(1001, 500), 301).height == round(500 * 301 / 1001)
