# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's camera_models.json."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt, UnifiedCamera, load_cameras

SIZE = {"width": 4000, "height": 3000}
CENTER = {"focal_x": 0.8, "focal_y": 0.81, "c_x": 0.01, "c_y": -0.02}
OPENSFM = {
    "v2 maker model 4000 3000 perspective 0.85": {
        "projection_type": "perspective", **SIZE, "focal": 0.85, "k1": -0.1, "k2": 0.02,
    },
    "brown": {
        "projection_type": "brown", **SIZE, **CENTER,
        "k1": -0.1, "k2": 0.02, "p1": 0.001, "p2": -0.002, "k3": 0.0,
    },
    "radial": {"projection_type": "radial", **SIZE, **CENTER, "k1": -0.1, "k2": 0.02},
    "simple_radial": {"projection_type": "simple_radial", **SIZE, **CENTER, "k1": -0.1},
    "fisheye": {"projection_type": "fisheye", **SIZE, "focal": 0.4, "k1": 0.03, "k2": -0.01},
    "fisheye_opencv": {
        "projection_type": "fisheye_opencv", **SIZE, **CENTER,
        "k1": 0.03, "k2": -0.01, "k3": 0.003, "k4": -0.0005,
    },
    "panorama": {"projection_type": "spherical", "width": 5376, "height": 2688},
    "old panorama": {"projection_type": "equirectangular", "width": 5376, "height": 2688},
    "band": {"projection_type": "spherical", "width": 6000, "height": 2000},
    "no type": {**SIZE, "focal": 0.85},
}  # fmt: skip
# Pixels of a 4000 x 3000 image: 4000 times the normalised numbers, from its middle.
FOCUS, UNEVEN = (4000, 3000, 3400, 3400, 2000, 1500), (4000, 3000, 3200, 3240, 2040, 1420)


def test_normalised_numbers_become_pixels(written):
    assert load_cameras(written(OPENSFM, "camera_models.json")) == {
        "v2 maker model 4000 3000 perspective 0.85": UnifiedCamera(*FOCUS, 0, -0.1, 0.02),
        "brown": UnifiedCamera(*UNEVEN, 0, -0.1, 0.02, 0.001, -0.002),
        "radial": UnifiedCamera(*UNEVEN, 0, -0.1, 0.02),
        "simple_radial": UnifiedCamera(*UNEVEN, 0, -0.1),
        "fisheye": KannalaBrandt(4000, 3000, 1600, 1600, 2000, 1500, 0.03, -0.01),
        "fisheye_opencv": KannalaBrandt(*UNEVEN, 0.03, -0.01, 0.003, -0.0005),
        "panorama": Equirectangular(5376, 2688),
        "old panorama": Equirectangular(5376, 2688),
        "band": Equirectangular(6000, 2000, vertical_fov_deg=120),
        "no type": UnifiedCamera(*FOCUS, 0),
    }


def normalised_from_pixels(pixels, camera):
    """OpenSfM's pixels start at the centre of the first one; see its geometry page."""
    size = np.array([camera.width, camera.height])
    return (pixels - 0.5 - (size - 1) / 2) / size.max()


def test_pixels_follow_the_formulas_of_opensfm(written):
    cameras = load_cameras(written(OPENSFM))
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.4, 0.4, (2, 500))
    bearings = np.column_stack([x, y, np.ones(500)])

    camera = cameras["brown"]
    r2 = x * x + y * y
    radial = 1 - 0.1 * r2 + 0.02 * r2**2
    u = 0.8 * (radial * x + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)) + 0.01
    v = 0.81 * (radial * y - 2 * 0.002 * x * y + 0.001 * (r2 + 2 * y * y)) - 0.02
    pixels = camera.pixels_from_bearings(bearings)
    np.testing.assert_allclose(
        normalised_from_pixels(pixels, camera), np.column_stack([u, v]), atol=1e-12
    )

    camera = cameras["fisheye"]
    r, theta = np.sqrt(r2), np.arctan(np.sqrt(r2))
    scale = 0.4 * theta * (1 + 0.03 * theta**2 - 0.01 * theta**4) / r
    pixels = camera.pixels_from_bearings(bearings)
    np.testing.assert_allclose(
        normalised_from_pixels(pixels, camera), np.column_stack([scale * x, scale * y]), atol=1e-12
    )

    for name in ("panorama", "band"):
        camera = cameras[name]
        longitudes = np.arctan2(x, 1)
        latitudes = np.arctan2(-y, np.sqrt(x * x + 1))
        pixels = camera.pixels_from_bearings(bearings)
        expected = np.column_stack([longitudes, -latitudes]) / (2 * np.pi)
        np.testing.assert_allclose(normalised_from_pixels(pixels, camera), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"projection_type": "dual"}, "'dual' is not supported; supported: persp.*spherical"),
        ({"projection_type": "fisheye62"}, "OpenSfM projection_type 'fisheye62' is not supported"),
        ({"projection_type": 5}, "is not supported"),
        ({"k3": 0.1}, "brown with k3 = 0.1 is not supported"),
        ({"k3": "a"}, "k3 must be a number, got 'a'"),
        ({"width": 0}, "width must be a positive integer"),
        ({"width": None}, "width must be a positive integer number of pixels, got None"),
        ({"width": 10**400}, "width must be at most"),
        ({"focal_x": None}, "focal_x must be a number, got None"),
        ({"focal_x": 10**400}, "focal_x must be a finite number"),
        ({"focal_x": -1}, "fx must be positive"),
        ({"c_x": [1]}, r"c_x must be a number, got \[1\]"),
        ({"projection_type": "perspective"}, "missing keys: focal$"),
        ({"projection_type": "spherical"}, "must be 2:1 or flatter, got 4000x3000"),
    ],
)  # fmt: skip
def test_cameras_that_cannot_be_used_say_why(change, message, written):
    document = {"cam": {**OPENSFM["brown"], **change}}
    with pytest.raises(ValueError, match=message) as raised:
        load_cameras(written(document, "camera_models.json"))
    assert "camera_models.json: camera cam: " in str(raised.value) and "\n" not in str(raised.value)


def test_size_is_needed(written):
    with pytest.raises(ValueError, match="camera all: missing keys: width, height"):
        load_cameras(written({"all": {"projection_type": "perspective", "focal": 0.9}}))
