# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.cameras import Equirectangular

PANORAMA = Equirectangular(1024, 512)


@pytest.mark.parametrize(
    ("pixel", "bearing"),
    [
        ((512, 256), (0, 0, 1)),
        ((768, 256), (1, 0, 0)),
        ((256, 256), (-1, 0, 0)),
        ((1024, 256), (0, 0, -1)),
        ((0, 256), (0, 0, -1)),
        ((512, 0), (0, -1, 0)),
        ((77, 512), (0, 1, 0)),
        ((640, 128), (0.5, -np.sqrt(0.5), 0.5)),
    ],
)
def test_pixels_look_where_a_reader_expects(pixel, bearing):
    np.testing.assert_allclose(PANORAMA.bearings_from_pixels([pixel]), [bearing], atol=1e-15)


@pytest.mark.parametrize(
    ("bearing", "pixel"),
    [
        ((0, 0, 1), (512, 256)),
        ((1, 0, 0), (768, 256)),
        ((0, -1, 0), (512, 0)),
        ((0, 1, 0), (512, 512)),
        ((0.0, 7.0, -0.0), (512, 512)),
        ((-0.0, -7.0, -0.0), (512, 0)),
        ((0, 0, -1), (0, 256)),
        ((-0.0, 0, -1), (0, 256)),
    ],
)
def test_directions_at_axes_seam_and_poles_have_their_pixel(bearing, pixel):
    np.testing.assert_allclose(PANORAMA.pixels_from_bearings([bearing]), [pixel], atol=1e-12)


def test_panorama_wraps_at_the_seam():
    assert PANORAMA.wraps and not Equirectangular(1024, 512, horizontal_fov_deg=359.0).wraps
    beyond, within = [[-0.3, 100.0], [1024.3, 400.0]], [[1023.7, 100.0], [0.3, 400.0]]
    bearings = PANORAMA.bearings_from_pixels(beyond)
    np.testing.assert_allclose(bearings, PANORAMA.bearings_from_pixels(within), atol=1e-14)
    np.testing.assert_allclose(PANORAMA.pixels_from_bearings(bearings), within, atol=1e-10)


def test_columns_stay_below_the_width_next_to_the_seam():
    angles = np.concatenate([np.pi + np.arange(-20, 21) * 2.0**-51, [-1e-300, 1e-17]])
    for camera in (PANORAMA, Equirectangular(999, 500, center_longitude_deg=57.3)):
        bearings = np.column_stack([np.sin(angles), 0 * angles, np.cos(angles)])
        columns = camera.pixels_from_bearings(bearings)[:, 0]
        assert (columns >= 0).all() and (columns < camera.width).all()


def test_rows_above_and_below_the_image_have_no_ray():
    bearings = PANORAMA.bearings_from_pixels([[10, -0.1], [10, 512.1], [10, 0], [10, 512]])
    np.testing.assert_array_equal(np.isnan(bearings[:, 0]), [True, True, False, False])


def test_directions_next_to_a_pole_keep_their_angle():
    for angle in (1e-3, 1e-8, 1e-12):
        bearing = [[np.sin(angle), -np.cos(angle), 0.0]]
        row = PANORAMA.pixels_from_bearings(bearing)[0, 1]
        assert row * np.pi / 512 == pytest.approx(angle, abs=1e-15)


def test_jacobian_at_a_pole_has_a_column_of_zeros():
    jacobians = PANORAMA.bearing_jacobians([[300.0, 0.0], [300.0, 512.0]])
    np.testing.assert_allclose(jacobians[:, :, 0], 0, atol=1e-17)
    np.testing.assert_allclose(np.linalg.norm(jacobians[:, :, 1], axis=1), np.pi / 512, atol=1e-15)


def test_crop_has_the_bearings_of_the_same_pixels_in_the_panorama():
    whole = Equirectangular(3600, 1800)  # ten pixels a degree
    left, top, width, height = 2500, 200, 800, 500
    crop = Equirectangular(
        width,
        height,
        horizontal_fov_deg=width / 10,
        vertical_fov_deg=height / 10,
        center_longitude_deg=(left + width / 2) / 10 - 180,
        center_latitude_deg=90 - (top + height / 2) / 10,
    )
    pixels = np.random.default_rng(0).uniform((0, 0), (width, height), (500, 2))
    bearings = whole.bearings_from_pixels(pixels + (left, top))
    np.testing.assert_allclose(crop.bearings_from_pixels(pixels), bearings, atol=1e-14)
    np.testing.assert_allclose(crop.pixels_from_bearings(bearings), pixels, atol=1e-10)
    np.testing.assert_allclose(
        crop.bearing_jacobians(pixels), whole.bearing_jacobians(pixels + (left, top)), atol=1e-15
    )


def test_crop_across_the_seam_is_in_one_piece():
    crop = Equirectangular(100, 50, 100, 50, center_longitude_deg=180)
    pixels = np.array([[10.0, 25.0], [50.0, 25.0], [90.0, 25.0]])
    bearings = crop.bearings_from_pixels(pixels)
    np.testing.assert_allclose(bearings[1], [0, 0, -1], atol=1e-15)
    assert bearings[0, 0] > 0 > bearings[2, 0]
    np.testing.assert_allclose(crop.pixels_from_bearings(bearings), pixels, atol=1e-12)


def test_crop_sees_nothing_beside_itself():
    crop = Equirectangular(100, 50, 100, 50)
    outside = [[-0.1, 25], [100.1, 25], [50, -0.1], [50, 50.1]]
    assert np.isnan(crop.bearings_from_pixels(outside)).all()
    assert np.isnan(crop.bearing_jacobians(outside)).all()
    whole = Equirectangular(360, 180)
    beside = whole.bearings_from_pixels([[129.9, 90], [230.1, 90], [180, 64.9], [180, 115.1]])
    assert np.isnan(crop.pixels_from_bearings(beside)).all()
    edge = whole.bearings_from_pixels([[130, 90], [230, 90], [180, 65], [180, 115]])
    np.testing.assert_allclose(
        crop.pixels_from_bearings(edge), [[0, 25], [100, 25], [50, 0], [50, 50]], atol=1e-12
    )


@pytest.mark.parametrize("center_longitude_deg", [0, 90, -90, 180])
def test_pole_of_a_crop_has_a_pixel_whatever_its_longitudes(center_longitude_deg):
    crop = Equirectangular(300, 200, 90, 60, center_longitude_deg, center_latitude_deg=60)
    for up in ([0.0, -1.0, 0.0], [1e-17, -1.0, -1e-17], [-1e-17, -1.0, 1e-17]):
        pixel = crop.pixels_from_bearings([up])
        np.testing.assert_allclose(crop.bearings_from_pixels(pixel), [[0, -1, 0]], atol=1e-15)
    assert np.isnan(crop.pixels_from_bearings([[0, 1, 0]])).all()


@pytest.mark.parametrize("size", [(1024, 512), (5760, 2880), (1000, 501), (3008, 1504)])
def test_image_of_two_to_one_is_a_full_panorama(size):
    assert Equirectangular.for_image(*size) == Equirectangular(*size)


@pytest.mark.parametrize("size", [(5000, 1000), (512, 512), (1024, 500), (512, 1024)])
def test_image_of_another_shape_needs_its_field_of_view(size):
    with pytest.raises(ValueError, match=f"must be 2:1, got {size[0]}x{size[1]}; give its field"):
        Equirectangular.for_image(*size)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"horizontal_fov_deg": 0}, "horizontal_fov_deg must be positive"),
        ({"vertical_fov_deg": -10}, "vertical_fov_deg must be positive"),
        ({"horizontal_fov_deg": 361}, "horizontal_fov_deg must be at most 360"),
        ({"vertical_fov_deg": 181}, "vertical_fov_deg must be at most 180"),
        ({"center_latitude_deg": 1}, "between the poles"),
        ({"vertical_fov_deg": 60, "center_latitude_deg": -61}, "between the poles"),
        ({"center_longitude_deg": np.nan}, "center_longitude_deg must be a finite number"),
    ],
)
def test_impossible_angles_are_refused(parameters, message):
    with pytest.raises(ValueError, match=message):
        Equirectangular(1024, 512, **parameters)


def test_panorama_agrees_with_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    colmap = pycolmap.Camera(model="EQUIRECTANGULAR", width=1024, height=512, params=[1024, 512])
    pixels = np.random.default_rng(0).uniform((0, 0), (1024, 512), (1000, 2))
    bearings = colmap.cam_ray_from_img(pixels)
    np.testing.assert_allclose(PANORAMA.bearings_from_pixels(pixels), bearings, atol=1e-12)
    np.testing.assert_allclose(PANORAMA.pixels_from_bearings(bearings), pixels, atol=1e-9)
