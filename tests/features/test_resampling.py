# SPDX-License-Identifier: BSD-3-Clause
"""What a camera's pictures show along bearings."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.features.resampling import Resampling, pixel_centers

PANORAMA = Equirectangular(64, 32)
FISHEYE = KannalaBrandt(40, 40, 15.0, 15.0, 20.0, 20.0, max_angle_deg=75.0)
NOISE = np.random.default_rng(0).integers(1, 256, (32, 64, 3), dtype=np.uint8)


def _turn(degrees):
    return Rotation.from_euler("y", degrees, degrees=True).as_matrix()


def _own_bearings(camera):
    return camera.bearings_from_pixels(pixel_centers(camera.width, camera.height))


@pytest.mark.parametrize("interpolation", [cv2.INTER_NEAREST, cv2.INTER_LINEAR, cv2.INTER_CUBIC])
def test_own_bearings_show_the_picture_itself(interpolation):
    resampling = Resampling(PANORAMA, [_own_bearings(PANORAMA)], (32, 64))
    np.testing.assert_array_equal(resampling.picture(NOISE, interpolation), NOISE)
    assert resampling.seen.all()


@pytest.mark.parametrize("columns", [1, 20, 63])
def test_a_turn_about_the_vertical_rolls_a_panorama_across_its_seam(columns):
    turn = _turn(360.0 / 64 * columns)
    turned = Resampling(PANORAMA, [_own_bearings(PANORAMA) @ turn.T], (32, 64))
    np.testing.assert_array_equal(turned.picture(NOISE), np.roll(NOISE, -columns, axis=1))


def test_half_a_column_is_the_mean_of_both_sides_of_the_seam():
    turn = _turn(360.0 / 64 / 2)
    turned = Resampling(PANORAMA, [_own_bearings(PANORAMA) @ turn.T], (32, 64)).picture(NOISE)
    means = (NOISE.astype(float) + np.roll(NOISE, -1, axis=1)) / 2
    assert np.abs(turned - means).max() <= 0.5


def test_a_part_of_a_panorama_does_not_go_on_at_the_other_side():
    part = Equirectangular(64, 32, horizontal_fov_deg=180.0)
    turn = _turn(45.0)
    turned = Resampling(part, [_own_bearings(part) @ turn.T], (32, 64))
    assert not turned.seen[:, 48:].any()
    assert not turned.picture(NOISE)[:, 48:].any()
    assert turned.seen[16, :48].all()


def test_what_a_lens_does_not_see_is_black():
    white = np.full((40, 40), 255, np.uint8)
    resampling = Resampling(FISHEYE, [_own_bearings(PANORAMA)], (32, 64))
    angles = np.degrees(np.arccos(_own_bearings(PANORAMA)[:, 2])).reshape(32, 64)
    np.testing.assert_array_equal(resampling.seen, angles <= 75.0)
    np.testing.assert_array_equal(resampling.picture(white) == 255, resampling.seen)
    np.testing.assert_array_equal(resampling.picture(white) == 0, ~resampling.seen)


def test_bearings_may_come_in_parts():
    bearings = _own_bearings(PANORAMA)
    whole = Resampling(FISHEYE, [bearings], (32, 64))
    parts = Resampling(FISHEYE, np.split(bearings, [64, 640]), (32, 64))
    picture = NOISE[:, :40, 0].repeat(2, axis=0)[:40]
    np.testing.assert_array_equal(parts.picture(picture), whole.picture(picture))
    np.testing.assert_array_equal(parts.seen, whole.seen)


def test_pixel_centers_are_in_the_order_of_a_picture():
    np.testing.assert_array_equal(
        pixel_centers(2, 2), [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [1.5, 1.5]]
    )
