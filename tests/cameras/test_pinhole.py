# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.cameras import Pinhole

CAMERA = Pinhole(width=640, height=480, fx=300, fy=200, cx=320, cy=240)


def test_pixels_look_where_a_reader_expects():
    bearings = CAMERA.bearings_from_pixels([[320, 240], [620, 240], [320, 40]])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(bearings, [[0, 0, 1], [half, 0, half], [0, -half, half]], atol=1e-15)


def test_directions_behind_or_sideways_have_no_pixel():
    bearings = [[0, 0, -1], [0.1, 0.1, -1], [1, 0, 0], [1, 0, 1e-300], [0, 0, 1]]
    pixels = CAMERA.pixels_from_bearings(bearings)
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [True, True, True, True, False])


def test_pixel_outside_the_image_has_a_ray_but_is_not_given_for_it():
    bearings = CAMERA.bearings_from_pixels([[700, 240], [320, -1], [640, 480]])
    assert np.isfinite(bearings).all()
    pixels = CAMERA.pixels_from_bearings(bearings)
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [True, True, False])


def test_pixels_as_far_as_numbers_go_have_a_ray():
    far = [[1e200, 240], [-1e308, 1e308], [320, 1e160]]
    bearings = CAMERA.bearings_from_pixels(far)
    np.testing.assert_allclose(np.linalg.norm(bearings, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(bearings[0], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(bearings[2], [0, 1, 0], atol=1e-15)
    assert np.isfinite(CAMERA.bearing_jacobians(far)).all()


def test_pinhole_agrees_with_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    colmap = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[300, 200, 320, 240])
    pixels = np.random.default_rng(0).uniform((0, 0), (640, 480), (1000, 2))
    np.testing.assert_allclose(
        CAMERA.bearings_from_pixels(pixels), colmap.cam_ray_from_img(pixels), atol=1e-14
    )
