# SPDX-License-Identifier: BSD-3-Clause
import cv2
import numpy as np
import pytest

from epi360.cameras import KannalaBrandt

COEFFICIENTS = (0.03, -0.01, 0.003, -0.0005)
WIDE = KannalaBrandt(1000, 1000, 230, 231, 501, 498, *COEFFICIENTS)
PLAIN = KannalaBrandt(2000, 2000, 300, 300, 1000, 1000)  # r = a: 300 px a radian


def directions(angles_deg, azimuths_deg=0.0):
    angles, azimuths = np.broadcast_arrays(np.radians(angles_deg), np.radians(azimuths_deg))
    sines = np.sin(angles)
    return np.column_stack([sines * np.cos(azimuths), sines * np.sin(azimuths), np.cos(angles)])


def test_pixels_look_where_a_reader_expects():
    quarter = 300 * np.pi / 2
    bearings = PLAIN.bearings_from_pixels(
        [[1000, 1000], [1000 + quarter, 1000], [1000, 1000 - quarter], [1000 - 1.5 * quarter, 1000]]
    )
    half = np.sqrt(0.5)
    expected = [[0, 0, 1], [1, 0, 0], [0, -1, 0], [-half, 0, -half]]
    np.testing.assert_allclose(bearings, expected, atol=1e-14)


def test_field_of_view_over_180_degrees_goes_both_ways():
    bearings = directions([91, 100, 110, 120], [0, 90, 200, 310])
    pixels = WIDE.pixels_from_bearings(bearings)
    assert np.isfinite(pixels).all()
    np.testing.assert_allclose(WIDE.bearings_from_pixels(pixels), bearings, atol=1e-12)


def test_largest_angle_limits_pixels_directions_and_mask():
    camera = KannalaBrandt(2000, 2000, 300, 300, 1000, 1000, max_angle_deg=100)
    border = 300 * np.radians(100)
    bearings = camera.bearings_from_pixels(
        [[1000 + border - 0.01, 1000], [1000 + border + 0.01, 1000]]
    )
    np.testing.assert_array_equal(np.isnan(bearings[:, 0]), [False, True])
    pixels = camera.pixels_from_bearings(directions([99.99, 100, 100.01]))
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [False, False, True])
    area = camera.field_of_view_mask().sum()
    assert area == pytest.approx(np.pi * border**2, rel=1e-3)
    assert np.isnan(camera.bearing_jacobians([[1900, 1900]])).all()


def test_model_ends_where_two_angles_would_share_a_pixel():
    camera = KannalaBrandt(2000, 2000, 300, 300, 1000, 1000, k1=-0.1)
    turn = np.degrees(np.sqrt(1 / 0.3))  # r = a - 0.1 a^3 has its maximum there
    pixels = camera.pixels_from_bearings(directions([turn - 1e-6, turn + 1e-6]))
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [False, True])
    radius = 300 * np.radians(turn) * 2 / 3
    at_the_turn = camera.bearings_from_pixels(
        [[1000 + 0.9999999 * radius, 1000], [1000 + 1.0000001 * radius, 1000]]
    )
    np.testing.assert_array_equal(np.isnan(at_the_turn[:, 0]), [False, True])
    assert camera.field_of_view_mask().sum() == pytest.approx(np.pi * radius**2, rel=1e-3)


def test_later_extrema_do_not_count_and_a_narrower_limit_does():
    wiggling = KannalaBrandt(2000, 2000, 200, 200, 1000, 1000, 0, -0.3, 0, 0.05)
    slopes = wiggling._slopes(np.linspace(0, wiggling._max_angle - 1e-9, 1000))
    assert (slopes > 0).all() and wiggling._slopes(wiggling._max_angle) == pytest.approx(
        0, abs=1e-9
    )
    narrower = KannalaBrandt(2000, 2000, 200, 200, 1000, 1000, k1=-0.1, max_angle_deg=30)
    assert narrower._max_angle == pytest.approx(np.radians(30), abs=1e-15)


@pytest.mark.parametrize(
    "coefficients", [(0,) * 4, COEFFICIENTS, (0.3, 0, 0, 0.01), (-0.1, 0, 0, 0)]
)
def test_angles_are_inverted_to_a_trillionth_of_a_radian(coefficients):
    camera = KannalaBrandt(2000, 2000, 200, 200, 1000, 1000, *coefficients)
    angles = np.linspace(0, 0.98 * camera._max_angle, 2001)
    np.testing.assert_allclose(camera._angles(camera._radii(angles)), angles, atol=1e-12)


def test_angles_are_inverted_up_to_the_extremum():
    camera = KannalaBrandt(2000, 2000, 200, 200, 1000, 1000, k1=-0.1)
    radii = camera._max_radius * (1 - np.logspace(-16, 0, 200))
    angles = camera._angles(radii)
    assert (angles <= camera._max_angle).all()
    np.testing.assert_allclose(camera._radii(angles), radii, atol=1e-14)


def test_jacobian_is_exact_at_the_principal_point():
    camera = KannalaBrandt(1000, 1000, 230, 231, 501, 498, *COEFFICIENTS)
    expected = [[1 / 230, 0], [0, 1 / 231], [0, 0]]
    at, beside = camera.bearing_jacobians([[501, 498], [501 + 1e-7, 498 - 1e-7]])
    np.testing.assert_allclose(at, expected, atol=1e-18)
    np.testing.assert_allclose(beside, expected, atol=1e-10)


def test_straight_back_has_a_pixel_where_the_lens_sees_it():
    pixel = PLAIN.pixels_from_bearings([[0.0, 0.0, -1.0]])
    np.testing.assert_allclose(pixel, [[1000 + 300 * np.pi, 1000]], atol=1e-9)
    assert np.isnan(
        KannalaBrandt(2000, 2000, 300, 300, 1000, 1000, -0.1).pixels_from_bearings(
            [[0.0, 0.0, -1.0]]
        )
    ).all()


def test_directions_that_miss_the_image_have_no_pixel():
    camera = KannalaBrandt(600, 400, 300, 300, 300, 200)
    pixels = camera.pixels_from_bearings(directions([50, 50], [0, 90]))
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [False, True])


@pytest.mark.parametrize("max_angle_deg", [0, -5, 181])
def test_impossible_largest_angle_is_refused(max_angle_deg):
    with pytest.raises(ValueError, match=r"max_angle_deg must be in \(0, 180\]"):
        KannalaBrandt(1000, 1000, 300, 300, 500, 500, max_angle_deg=max_angle_deg)


def test_pixels_are_those_of_opencv_half_a_pixel_on():
    rng = np.random.default_rng(0)
    bearings = directions(rng.uniform(0.1, 85, 1000), rng.uniform(0, 360, 1000))
    matrix = np.array([[230, 0, 501 - 0.5], [0, 231, 498 - 0.5], [0, 0, 1]])
    zero = np.zeros(3)
    pixels, _ = cv2.fisheye.projectPoints(
        bearings[None], zero, zero, matrix, np.array(COEFFICIENTS)
    )
    expected = pixels[0] + 0.5
    np.testing.assert_allclose(WIDE.pixels_from_bearings(bearings), expected, atol=1e-9)


def test_pixels_are_those_of_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    colmap = pycolmap.Camera(
        model="OPENCV_FISHEYE", width=1000, height=1000, params=[230, 231, 501, 498, *COEFFICIENTS]
    )
    rng = np.random.default_rng(0)
    bearings = directions(rng.uniform(0, 85, 1000), rng.uniform(0, 360, 1000))
    np.testing.assert_allclose(
        WIDE.pixels_from_bearings(bearings), colmap.img_from_cam(bearings), atol=1e-9
    )
