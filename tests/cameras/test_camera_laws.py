# SPDX-License-Identifier: BSD-3-Clause
"""Laws that hold for every camera model."""

import pickle

import numpy as np
import pytest

from epi360.cameras import (
    DoubleSphere,
    Equirectangular,
    ExtendedUnified,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
)

CAMERAS = {
    "panorama": Equirectangular(1024, 512),
    "turned panorama": Equirectangular(1000, 500, center_longitude_deg=-130),
    "crop": Equirectangular(300, 200, 90, 60, center_longitude_deg=150, center_latitude_deg=20),
    "crop to a pole": Equirectangular(300, 200, 90, 60, 90, -60),
    "pinhole": Pinhole(640, 480, 300, 310, 322.5, 238),
    "fisheye": KannalaBrandt(800, 800, 250, 251, 401, 399, 0.03, -0.01, 0.003, -0.0005),
    "fisheye of 220 degrees": KannalaBrandt(
        1000, 1000, 240, 240, 500, 500, 0.02, max_angle_deg=110
    ),
    "plain fisheye": KannalaBrandt(2000, 2000, 300, 300, 1000, 1000),
    "unified": UnifiedCamera(512, 512, 380, 381, 255, 257, 0.9),
    "unified with distortion": UnifiedCamera(
        512, 512, 380, 381, 255, 257, 0.9, -0.1, 0.03, 1e-3, -2e-3
    ),
    "mirror": UnifiedCamera(1000, 800, 700, 700, 500, 400, 2.0, -0.2, 0.1, 1e-3, 5e-4),
    "sphere": UnifiedCamera(800, 800, 200, 200, 400, 400, 1.0),
    "pinhole with distortion": UnifiedCamera(
        640, 480, 300, 301, 322, 238, 0, -0.3, 0.1, 1e-3, 2e-3
    ),
    "pinhole that folds": UnifiedCamera(640, 480, 300, 301, 322, 238, 0, -0.3, 0, 1e-3, 2e-3),
    "extended unified": ExtendedUnified(800, 800, 250, 251, 401, 399, 0.6, 1.2),
    "extended unified of a plane": ExtendedUnified(800, 800, 250, 251, 401, 399, 0.3, 0.8),
    "double sphere": DoubleSphere(800, 800, 240, 241, 401, 399, -0.2, 0.58),
    "double sphere of a plane": DoubleSphere(800, 800, 240, 241, 401, 399, 0.3, 0.4),
}
PANORAMAS_AND_PINHOLES = (Equirectangular, Pinhole)  # have a ray at every pixel of the image
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)


def pixels_in_the_field_of_view(camera, seed=0, count=2000):
    """Random pixels with a ray, a little away from its end, where inversion is ill-posed."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform((0, 0), (camera.width, camera.height), (count, 2))
    center = (camera.width / 2, camera.height / 2)
    has_ray = ~np.isnan(camera.bearings_from_pixels(center + 1.01 * (pixels - center))[:, 0])
    return pixels if isinstance(camera, PANORAMAS_AND_PINHOLES) else pixels[has_ray]


def corners(camera):
    w, h = camera.width, camera.height
    return np.array([(0.0, 0.0), (w, 0.0), (0.0, h), (w, h), (w / 2, 0.0), (0.0, h / 2)])


@every_camera
def test_pixel_to_bearing_to_pixel_is_the_identity(camera):
    pixels = pixels_in_the_field_of_view(camera)
    assert len(pixels) > 500
    bearings = camera.bearings_from_pixels(pixels)
    np.testing.assert_allclose(np.linalg.norm(bearings, axis=1), 1, atol=1e-15)
    np.testing.assert_allclose(camera.pixels_from_bearings(bearings), pixels, atol=1e-9)


@every_camera
def test_directions_survive_the_pixel_at_seam_poles_and_corners(camera):
    bearings = camera.bearings_from_pixels(corners(camera))
    has_ray = ~np.isnan(bearings[:, 0])
    if isinstance(camera, PANORAMAS_AND_PINHOLES):
        assert has_ray.all()
    else:  # its corners may be outside the lens: also the pixels around its field of view
        v, u = np.nonzero(camera.field_of_view_mask())
        outermost = [u.argmin(), u.argmax(), v.argmin(), v.argmax()]
        rim = camera.bearings_from_pixels(np.stack([u, v], axis=1)[outermost] + 0.5)
        assert not np.isnan(rim).any()
        bearings = np.concatenate([bearings[has_ray], rim])
    again = camera.bearings_from_pixels(camera.pixels_from_bearings(bearings))
    np.testing.assert_allclose(again, bearings, atol=1e-12)


@every_camera
def test_bearing_to_pixel_to_bearing_is_the_identity_for_any_length(camera):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(5000, 3))
    pixels = camera.pixels_from_bearings(directions * rng.uniform(0.01, 100, (5000, 1)))
    seen = ~np.isnan(pixels[:, 0])
    assert seen.sum() > 100
    unit = directions[seen] / np.linalg.norm(directions[seen], axis=1, keepdims=True)
    np.testing.assert_allclose(camera.bearings_from_pixels(pixels[seen]), unit, atol=1e-11)


@every_camera
def test_jacobians_equal_central_differences(camera):
    pixels = pixels_in_the_field_of_view(camera, seed=2, count=300)
    pixels = pixels[
        (pixels > 1).all(axis=1) & (pixels < (camera.width - 1, camera.height - 1)).all(axis=1)
    ]
    step = 1e-3
    numeric = np.stack(
        [
            camera.bearings_from_pixels(pixels + offset)
            - camera.bearings_from_pixels(pixels - offset)
            for offset in ((step, 0.0), (0.0, step))
        ],
        axis=2,
    ) / (2 * step)
    assert np.isfinite(numeric).all()
    np.testing.assert_allclose(camera.bearing_jacobians(pixels), numeric, atol=1e-10)


@every_camera
def test_a_bearing_changes_only_across_itself(camera):
    pixels = pixels_in_the_field_of_view(camera)
    bearings, jacobians = camera.bearings_from_pixels(pixels), camera.bearing_jacobians(pixels)
    np.testing.assert_allclose(np.einsum("ni,nij->nj", bearings, jacobians), 0, atol=1e-15)


@every_camera
def test_mask_says_which_pixel_centres_have_a_ray(camera):
    mask = camera.field_of_view_mask()
    assert mask.dtype == np.bool_ and mask.shape == (camera.height, camera.width)
    v, u = np.indices(mask.shape) + 0.5
    bearings = camera.bearings_from_pixels(np.column_stack([u.ravel(), v.ravel()]))
    np.testing.assert_array_equal(mask.ravel(), ~np.isnan(bearings[:, 0]))


@every_camera
@pytest.mark.filterwarnings("error")
def test_missing_rows_stay_missing_and_leave_the_others_alone(camera):
    center = [camera.width / 2, camera.height / 2]
    pixels = [[np.nan, 5.0], center, [5.0, np.nan], [np.inf, 5.0], [5.0, -np.inf]]
    missing = [True, False, True, True, True]
    bearings = camera.bearings_from_pixels(pixels)
    np.testing.assert_array_equal(np.isnan(bearings), np.repeat([missing], 3, 0).T)
    np.testing.assert_array_equal(
        np.isnan(camera.bearing_jacobians(pixels)).reshape(5, 6), np.repeat([missing], 6, 0).T
    )
    forward = bearings[1]
    bearings = [[np.nan, 0, 1], forward, [0, 0, 0], [0, np.inf, 1], [0.0, -0.0, -0.0]]
    pixels = camera.pixels_from_bearings(bearings)
    np.testing.assert_array_equal(np.isnan(pixels), np.repeat([missing], 2, 0).T)


@every_camera
def test_input_arrays_are_left_alone_and_empty_ones_are_fine(camera):
    pixels = np.asfortranarray(pixels_in_the_field_of_view(camera))
    bearings = np.asfortranarray(camera.bearings_from_pixels(pixels))
    bearings[:2] = (0.0, 0.0, -1.0)
    copies = pixels.copy(), bearings.copy()
    camera.bearing_jacobians(pixels)
    camera.pixels_from_bearings(bearings)
    np.testing.assert_array_equal(pixels, copies[0])
    np.testing.assert_array_equal(bearings, copies[1])
    assert camera.bearings_from_pixels(np.empty((0, 2))).shape == (0, 3)
    assert camera.pixels_from_bearings(np.empty((0, 3))).shape == (0, 2)
    assert camera.bearing_jacobians(np.empty((0, 2))).shape == (0, 3, 2)


@every_camera
def test_other_shapes_are_refused_by_name(camera):
    with pytest.raises(ValueError, match=r"pixels must have shape \(N, 2\), got \(2,\)"):
        camera.bearings_from_pixels([1.0, 2.0])
    with pytest.raises(ValueError, match=r"pixels must have shape \(N, 2\), got \(4, 3\)"):
        camera.bearing_jacobians(np.ones((4, 3)))
    with pytest.raises(ValueError, match=r"bearings must have shape \(N, 3\), got \(3, 2\)"):
        camera.pixels_from_bearings(np.ones((3, 2)))
    with pytest.raises(ValueError, match=r"pixels must be numbers of shape \(N, 2\)"):
        camera.bearings_from_pixels([["a", "b"]])


@every_camera
def test_camera_is_a_value(camera):
    camera.field_of_view_mask()
    copy = pickle.loads(pickle.dumps(camera))
    assert copy == camera and hash(copy) == hash(camera)
    with pytest.raises(AttributeError):
        camera.width = 5


@pytest.mark.parametrize("size", [0, -5, 10.0, 10.5, True, None, "10"])
def test_sizes_must_be_positive_integers(size):
    with pytest.raises(ValueError, match="width must be a positive integer"):
        Equirectangular(size, 512)
    with pytest.raises(ValueError, match="height must be a positive integer"):
        Pinhole(640, size, 300, 300, 320, 240)


@pytest.mark.parametrize("value", [np.nan, np.inf, None, "300", True])
def test_parameters_must_be_finite_numbers(value):
    with pytest.raises(ValueError, match="cx must be a finite number"):
        Pinhole(640, 480, 300, 300, value, 240)
    with pytest.raises(ValueError, match="k2 must be a finite number"):
        KannalaBrandt(640, 480, 300, 300, 320, 240, k2=value)


def test_numpy_numbers_are_numbers():
    camera = Pinhole(np.int64(640), np.int32(480), np.float32(300), 300, np.float64(320), 240)
    assert camera == Pinhole(640, 480, 300, 300, 320, 240)
    assert type(camera.width) is int and type(camera.fx) is float


@pytest.mark.parametrize("value", [1e13, -1e300, 10**400])
def test_numbers_that_no_lens_has_are_refused(value):
    with pytest.raises(ValueError, match=r"cx must be a finite number, got one above 1e\+12"):
        Pinhole(640, 480, 300, 300, value, 240)
    with pytest.raises(ValueError, match="width must be at most 10000000 pixels"):
        Pinhole(10**8, 480, 300, 300, 320, 240)


@pytest.mark.parametrize(
    "model",
    [
        Pinhole,
        KannalaBrandt,
        lambda *numbers: UnifiedCamera(*numbers, 0.9),
        lambda *numbers: ExtendedUnified(*numbers, 0.6, 1.1),
        lambda *numbers: DoubleSphere(*numbers, -0.2, 0.6),
    ],
)
@pytest.mark.parametrize("focal_length", [0, -300, 1e-300])
def test_focal_lengths_must_be_positive(model, focal_length):
    with pytest.raises(ValueError, match="fy must be positive"):
        model(640, 480, 300, focal_length, 320, 240)


@every_camera
def test_what_a_masked_array_hides_is_no_pixel(camera):
    pixels = pixels_in_the_field_of_view(camera)[:3]
    hidden = np.ma.masked_array(pixels, mask=[[False, False], [True, False], [False, False]])
    expected = camera.bearings_from_pixels(pixels)
    expected[1] = np.nan
    np.testing.assert_allclose(camera.bearings_from_pixels(hidden), expected, rtol=0, atol=1e-9)
