# SPDX-License-Identifier: BSD-3-Clause
"""Cameras against COLMAP's own."""

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
from epi360.cameras.calibration.colmap import MODELS_BY_NUMBER
from epi360.interop.colmap_cameras import camera_from_colmap, colmap_camera

pycolmap = pytest.importorskip("pycolmap")

ROUND, UNEVEN = (800, 600, 300, 300, 401.5, 299), (800, 600, 300, 301, 401.5, 299)
LENSES = {
    "SIMPLE_PINHOLE": Pinhole(*ROUND),
    "PINHOLE": Pinhole(*UNEVEN),
    "SIMPLE_RADIAL": UnifiedCamera(*ROUND, 0, -0.1),
    "RADIAL": UnifiedCamera(*ROUND, 0, -0.1, 0.02),
    "OPENCV": UnifiedCamera(*UNEVEN, 0, -0.1, 0.02, 0.001, -0.002),
    "SIMPLE_FISHEYE": KannalaBrandt(*ROUND),
    "FISHEYE": KannalaBrandt(*UNEVEN),
    "SIMPLE_RADIAL_FISHEYE": KannalaBrandt(*ROUND, -0.02),
    "RADIAL_FISHEYE": KannalaBrandt(*ROUND, -0.02, 0.003),
    "OPENCV_FISHEYE": KannalaBrandt(*UNEVEN, 0.03, -0.01, 0.003, -0.0005),
    "EUCM": ExtendedUnified(*UNEVEN, 0.6, 1.1),
}
ONLY_OURS = {
    "no model equal to DoubleSphere.*KannalaBrandt": DoubleSphere(
        800, 800, 240, 240, 400, 400, -0.2, 0.58
    ),
    "no model equal to UnifiedCamera with xi=0.9.*KannalaBrandt": UnifiedCamera(
        800, 800, 400, 400, 400, 400, 0.9
    ),
    "for a part of a panorama.*fill the picture up to 2:1": Equirectangular(
        800, 300, vertical_fov_deg=135
    ),
    "or one turned about its centre": Equirectangular(800, 400, center_longitude_deg=10),
}


def random_directions(seed=0, count=2000):
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1)[:, None]


@pytest.mark.parametrize(("model", "camera"), LENSES.items(), ids=LENSES)
def test_lens_has_the_simplest_model_and_colmap_sees_the_same_pixels_and_rays(model, camera):
    theirs = colmap_camera(camera)
    assert theirs.model_name == model and theirs.verify_params() and theirs.has_prior_focal_length
    assert camera_from_colmap(theirs) == camera
    directions = random_directions()
    pixels = camera.pixels_from_bearings(directions)
    # COLMAP has rays in front of the camera alone, and stops early near the fold of a distortion.
    used = ~np.isnan(pixels[:, 0]) & (directions[:, 2] > 0.55)
    assert used.sum() > 100
    pixels, directions = pixels[used], directions[used]
    np.testing.assert_allclose(theirs.img_from_cam(directions), pixels, rtol=0, atol=1e-9)
    ours, rays = camera.bearings_from_pixels(pixels), theirs.cam_ray_from_img(pixels)
    np.testing.assert_allclose(rays, ours, rtol=0, atol=1e-9)
    plane = theirs.cam_from_img(pixels)
    np.testing.assert_allclose(plane, ours[:, :2] / ours[:, 2:], rtol=0, atol=1e-8)


def test_panorama_agrees_with_colmap_all_around():
    camera = Equirectangular(1024, 512)
    theirs = colmap_camera(camera)
    assert theirs.model_name == "EQUIRECTANGULAR" and camera_from_colmap(theirs) == camera
    directions = random_directions()
    assert (directions[:, 2] < 0).sum() > 900
    pixels = camera.pixels_from_bearings(directions)
    np.testing.assert_allclose(theirs.img_from_cam(directions), pixels, rtol=0, atol=1e-9)
    np.testing.assert_allclose(theirs.cam_ray_from_img(pixels), directions, rtol=0, atol=1e-9)
    # On paper: a quarter of the width right of the middle is +x, the middle of the left border -z.
    known = theirs.cam_ray_from_img(np.array([[512.0, 256], [768, 256], [0, 256], [512, 384]]))
    np.testing.assert_allclose(
        known, [[0, 0, 1], [1, 0, 0], [0, 0, -1], [0, 0.5**0.5, 0.5**0.5]], atol=1e-12
    )


@pytest.mark.parametrize(
    ("camera", "model"),
    [
        (UnifiedCamera(*ROUND, 0), "SIMPLE_PINHOLE"),
        (UnifiedCamera(*UNEVEN, 0), "PINHOLE"),
        (UnifiedCamera(*UNEVEN, 0, -0.1), "OPENCV"),
        (UnifiedCamera(*ROUND, 0, 0, 0, 0.001), "OPENCV"),
        (UnifiedCamera(*ROUND, 0, 0, 0.1), "RADIAL"),
        (KannalaBrandt(*ROUND, 0, 0, 0, 0.001), "OPENCV_FISHEYE"),
        (KannalaBrandt(*ROUND, max_angle_deg=95), "SIMPLE_FISHEYE"),
    ],
)
def test_no_parameter_of_a_camera_is_lost(camera, model):
    theirs = colmap_camera(camera)
    assert theirs.model_name == model
    pixels = np.random.default_rng(0).uniform((350, 250), (450, 350), (100, 2))
    np.testing.assert_allclose(
        theirs.cam_ray_from_img(pixels), camera.bearings_from_pixels(pixels), rtol=0, atol=1e-9
    )


@pytest.mark.parametrize(("what", "camera"), ONLY_OURS.items(), ids=ONLY_OURS)
def test_what_colmap_lacks_is_refused_with_the_alternatives(what, camera):
    with pytest.raises(ValueError, match=what) as raised:
        colmap_camera(camera)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("model", ["FULL_OPENCV", "FOV", "DIVISION", "THIN_PRISM_FISHEYE"])
def test_what_we_lack_is_refused_with_the_alternatives(model):
    theirs = pycolmap.Camera.create_from_model_name(1, model, 300, 640, 480)
    with pytest.raises(ValueError, match=f"{model}' is not supported; supported: .*EUCM"):
        camera_from_colmap(theirs)


def test_models_have_the_numbers_of_colmap():
    numbers = {name: int(model) for name, model in pycolmap.CameraModelId.__members__.items()}
    del numbers["INVALID"]
    assert dict(zip(MODELS_BY_NUMBER, range(len(numbers)), strict=True)) == numbers
