# SPDX-License-Identifier: BSD-3-Clause
import cv2
import numpy as np
import pytest

from epi360.cameras import Pinhole, UnifiedCamera

FISHEYE = UnifiedCamera(1000, 900, 620, 622, 501, 448, 0.95, -0.12, 0.04, 1e-3, -8e-4)
MIRROR = UnifiedCamera(1000, 900, 640, 642, 501, 448, 1.8, -0.1, 0.05, 1e-3, -8e-4)
RADTAN = UnifiedCamera(1280, 960, 600, 602, 641, 478, 0, -0.28, 0.08, 1e-3, -2e-3)


def directions(angles_deg, azimuths_deg=0.0):
    angles, azimuths = np.broadcast_arrays(np.radians(angles_deg), np.radians(azimuths_deg))
    sines = np.sin(angles)
    return np.column_stack([sines * np.cos(azimuths), sines * np.sin(azimuths), np.cos(angles)])


def mei_rives(direction, camera):
    """Mei & Rives, ICRA 2007, steps 1 to 5 of section II, for one direction."""
    x, y, z = np.array(direction) / np.linalg.norm(direction)
    x, y = x / (z + camera.xi), y / (z + camera.xi)
    r2 = x * x + y * y
    radial = 1 + camera.k1 * r2 + camera.k2 * r2 * r2
    distorted_x = x * radial + 2 * camera.p1 * x * y + camera.p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + camera.p1 * (r2 + 2 * y * y) + 2 * camera.p2 * x * y
    return camera.fx * distorted_x + camera.cx, camera.fy * distorted_y + camera.cy


def test_pixels_look_where_a_reader_expects():
    half_sphere = UnifiedCamera(1000, 1000, 200, 100, 500, 500, 0.5)
    # 90 degrees to the right: (1, 0) / (0 + 0.5) = (2, 0); the same for 90 degrees up.
    bearings = half_sphere.bearings_from_pixels([[500, 500], [900, 500], [500, 300]])
    np.testing.assert_allclose(bearings, [[0, 0, 1], [1, 0, 0], [0, -1, 0]], atol=1e-15)
    # xi = 1 is the stereographic projection: tan(a / 2).
    stereographic = UnifiedCamera(1000, 1000, 200, 200, 500, 500, 1)
    pixels = stereographic.pixels_from_bearings(directions([60, 90, 120]))
    expected = 500 + 200 * np.tan(np.radians([30, 45, 60]))
    np.testing.assert_allclose(pixels[:, 0], expected, atol=1e-10)


@pytest.mark.parametrize(("camera", "limit_deg"), [(FISHEYE, 130), (MIRROR, 120), (RADTAN, 70)])
def test_pixels_follow_the_published_formula(camera, limit_deg):
    rng = np.random.default_rng(0)
    bearings = directions(rng.uniform(0, limit_deg, 1000), rng.uniform(0, 360, 1000))
    pixels = camera.pixels_from_bearings(bearings)
    seen = np.isfinite(pixels[:, 0])
    assert seen.sum() > 300
    expected = np.array([mei_rives(bearing, camera) for bearing in bearings[seen]])
    np.testing.assert_allclose(pixels[seen], expected, atol=1e-9)


def test_without_mirror_and_distortion_it_is_the_pinhole():
    camera, pinhole = (
        UnifiedCamera(640, 480, 300, 310, 322, 238, 0),
        Pinhole(640, 480, 300, 310, 322, 238),
    )
    pixels = np.random.default_rng(0).uniform((0, 0), (640, 480), (500, 2))
    bearings = pinhole.bearings_from_pixels(pixels)
    np.testing.assert_allclose(camera.bearings_from_pixels(pixels), bearings, atol=1e-15)
    np.testing.assert_allclose(
        camera.bearing_jacobians(pixels), pinhole.bearing_jacobians(pixels), atol=1e-17
    )
    behind = [[0, 0, -1], [0.1, 0, -1], [1, 0, 0], [0.1, 0.2, 1]]
    np.testing.assert_allclose(
        camera.pixels_from_bearings(behind), pinhole.pixels_from_bearings(behind), atol=1e-12
    )


def test_with_xi_zero_pixels_are_those_of_opencv_half_a_pixel_on():
    rng = np.random.default_rng(0)
    bearings = directions(rng.uniform(0, 42, 1000), rng.uniform(0, 360, 1000))
    matrix = np.array([[600, 0, 641 - 0.5], [0, 602, 478 - 0.5], [0, 0, 1]])
    coefficients = np.array([-0.28, 0.08, 1e-3, -2e-3])
    zero = np.zeros(3)
    pixels, _ = cv2.projectPoints(bearings, zero, zero, matrix, coefficients)
    expected = pixels[:, 0] + 0.5
    np.testing.assert_allclose(RADTAN.pixels_from_bearings(bearings), expected, atol=1e-9)


@pytest.mark.skipif(not hasattr(cv2, "omnidir"), reason="needs OpenCV's contrib modules")
@pytest.mark.parametrize("camera", [FISHEYE, MIRROR])
def test_pixels_are_those_of_opencv_omnidir_half_a_pixel_on(camera):
    rng = np.random.default_rng(0)
    bearings = directions(rng.uniform(0, 100, 1000), rng.uniform(0, 360, 1000))
    matrix = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]])
    coefficients = np.array([camera.k1, camera.k2, camera.p1, camera.p2])
    zero = np.zeros((3, 1))
    expected, _ = cv2.omnidir.projectPoints(
        bearings[None], zero, zero, matrix, camera.xi, coefficients
    )
    pixels = camera.pixels_from_bearings(bearings)
    seen = np.isfinite(pixels[:, 0])
    assert seen.sum() > 500
    np.testing.assert_allclose(pixels[seen], expected[0][seen] + 0.5, atol=1e-9)


@pytest.mark.parametrize(
    ("model", "parameters", "coefficients"),
    [
        ("SIMPLE_RADIAL", [600, 641, 478, -0.2], (-0.2, 0, 0, 0)),
        ("RADIAL", [600, 641, 478, -0.28, 0.08], (-0.28, 0.08, 0, 0)),
        ("OPENCV", [600, 600, 641, 478, -0.28, 0.08, 1e-3, -2e-3], (-0.28, 0.08, 1e-3, -2e-3)),
    ],
)
def test_with_xi_zero_pixels_are_those_of_colmap(model, parameters, coefficients):
    pycolmap = pytest.importorskip("pycolmap")
    colmap = pycolmap.Camera(model=model, width=1280, height=960, params=parameters)
    camera = UnifiedCamera(1280, 960, 600, 600, 641, 478, 0, *coefficients)
    rng = np.random.default_rng(0)
    bearings = directions(rng.uniform(0, 40, 1000), rng.uniform(0, 360, 1000))
    pixels = camera.pixels_from_bearings(bearings)
    np.testing.assert_allclose(pixels, colmap.img_from_cam(bearings), atol=1e-9)


@pytest.mark.parametrize("xi", [-0.3, 0, 0.5, 0.95, 1.0, 1.8, 4.0])
def test_field_of_view_ends_where_the_model_says(xi):
    # The picture of the sphere is small in the image: only the model limits it. The centre is
    # the image's corner, so that pixels have all their digits.
    camera = UnifiedCamera(100_000, 100_000, 5, 5, 0, 0, xi)
    limit = np.degrees(np.arccos(-xi if xi <= 1 else -1 / xi))
    pixels = camera.pixels_from_bearings(directions([limit - 0.1, min(limit + 0.1, 180)], 30))
    np.testing.assert_array_equal(np.isnan(pixels[:, 0]), [False, True])
    angles = np.linspace(0, limit - 0.05, 500)
    pixels = camera.pixels_from_bearings(directions(angles, 30))
    assert (np.diff(pixels[:, 0]) > 0).all()  # no two angles share a pixel
    np.testing.assert_allclose(
        camera.bearings_from_pixels(pixels), directions(angles, 30), atol=1e-8
    )  # a pixel is up to 20 degrees here


def test_rim_of_a_mirror_is_a_circle_of_pixels():
    camera = UnifiedCamera(1000, 900, 640, 640, 501, 448, 2)
    radius = 640 / np.sqrt(3)  # 1 / sqrt(xi^2 - 1)
    bearings = camera.bearings_from_pixels([[501 + radius - 1e-6, 448], [501 + radius + 1e-6, 448]])
    np.testing.assert_array_equal(np.isnan(bearings[:, 0]), [False, True])
    # At the rim the angle changes with the root of the distance: 1e-6 px are 1e-4 rad.
    np.testing.assert_allclose(bearings[0], directions(120)[0], atol=1e-3)
    at_the_rim = camera.pixels_from_bearings(directions([120, 120 + 1e-4]))
    np.testing.assert_allclose(at_the_rim, [[501 + radius, 448], [np.nan] * 2], atol=1e-6)
    mask_area = camera.field_of_view_mask().sum()
    assert mask_area == pytest.approx(np.pi * radius**2, rel=1e-3)


def test_directions_at_180_degrees_and_corners_go_both_ways():
    sideways = directions(90, np.arange(0, 360, 15))
    for camera in (
        UnifiedCamera(2000, 2000, 400, 400, 1000, 1000, 0.95, -0.05, 0.01, 1e-3, -8e-4),
        MIRROR,
    ):
        pixels = camera.pixels_from_bearings(sideways)
        assert np.isfinite(pixels).all()
        np.testing.assert_allclose(camera.bearings_from_pixels(pixels), sideways, atol=1e-12)
    pinned = np.array([(0, 0), (1000, 0), (0, 900), (1000, 900), (500, 450), (501, 448)], float)
    again = FISHEYE.pixels_from_bearings(FISHEYE.bearings_from_pixels(pinned))
    np.testing.assert_allclose(again, pinned, atol=1e-9)


def test_pixels_beyond_the_fold_of_the_distortion_have_no_ray():
    camera = UnifiedCamera(2000, 2000, 600, 600, 1000, 1000, 0, k1=-0.3)
    fold = np.sqrt(1 / 0.9)
    angles = np.degrees(np.arctan(fold * np.array([0.999, 1.001, 1.5])))
    np.testing.assert_array_equal(
        np.isnan(camera.pixels_from_bearings(directions(angles))[:, 0]), [False, True, True]
    )
    radius = 600 * fold * 2 / 3
    bearings = camera.bearings_from_pixels(
        [[1000 + 0.9999 * radius, 1000], [1000 + 1.0001 * radius, 1000], [0, 0]]
    )
    np.testing.assert_array_equal(np.isnan(bearings[:, 0]), [False, True, True])
    assert camera.field_of_view_mask().sum() == pytest.approx(np.pi * radius**2, rel=1e-3)


@pytest.mark.parametrize("xi", [0.5, 1.0, 2.0])
def test_straight_back_is_not_seen(xi):
    camera = UnifiedCamera(1000, 1000, 100, 100, 500, 500, xi)
    bearings = [[0, 0, -1], [1e-9, 0, -1], [0, -1e-7, -1.0]]
    assert np.isnan(camera.pixels_from_bearings(bearings)).all()


def test_jacobian_is_exact_at_the_principal_point():
    camera = UnifiedCamera(1000, 900, 640, 642, 501, 448, 1.8, -0.1, 0.05)
    expected = [[2.8 / 640, 0], [0, 2.8 / 642], [0, 0]]  # 1 + xi
    np.testing.assert_allclose(camera.bearing_jacobians([[501, 448]])[0], expected, atol=1e-17)


@pytest.mark.parametrize("xi", [-1, -1.5])
def test_pinhole_outside_the_sphere_on_the_wrong_side_is_refused(xi):
    with pytest.raises(ValueError, match="xi must be above -1"):
        UnifiedCamera(640, 480, 300, 300, 320, 240, xi)
