# SPDX-License-Identifier: BSD-3-Clause
"""A resized picture shows the same directions."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.cameras.resizing import pixels_per_radian, resized_camera


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


def test_one_of_two_lenses_in_a_picture_has_its_resolution_at_its_principal_point():
    alone = KannalaBrandt(480, 480, 140, 140, 240, 240, 0, 0, 0, 0, max_angle_deg=95)
    of_two = KannalaBrandt(960, 480, 140, 140, 240, 240, 0, 0, 0, 0, max_angle_deg=95)
    assert pixels_per_radian(of_two) == pytest.approx(pixels_per_radian(alone))


@pytest.mark.parametrize(("focal", "centre"), [(0.29, 0.5), (140, -400)])
def test_intrinsics_in_other_units_are_refused(focal, centre):
    camera = KannalaBrandt(
        480, 480, focal, focal, centre, centre, 0, 0, 0, 0, max_angle_deg=95
    )  # fmt: skip
    with pytest.raises(ValueError, match="must be in pixels of this size"):
        pixels_per_radian(camera)
