# SPDX-License-Identifier: BSD-3-Clause
"""Cameras whose angles are changed: their rays are those of the changed bearings."""

from dataclasses import replace

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
from epi360.cameras.changed_angles import AngleModel, angles_of
from epi360.cameras.changed_camera import changed_lens, changed_panorama

FISHEYE = KannalaBrandt(960, 600, 228.0, 227.0, 472.0, 308.0, 0.003, 0.03, -0.036, 0.0125)
EQUIDISTANT = KannalaBrandt(960, 600, 250.0, 250.0, 480.0, 300.0, max_angle_deg=95.0)
LENSES = [
    EQUIDISTANT,
    Pinhole(1000, 800, 500.0, 500.0, 500.0, 400.0),
    DoubleSphere(1000, 1000, 300.0, 300.0, 500.0, 500.0, xi=-0.2, alpha=0.55),
    ExtendedUnified(1000, 1000, 300.0, 300.0, 500.0, 500.0, 0.6, 1.1),
]


def pixels_of(camera, num=500):
    rng = np.random.default_rng(7)
    pixels = rng.uniform(0.0, [camera.width, camera.height], (num, 2))
    return pixels[np.isfinite(camera.bearings_from_pixels(pixels)).all(axis=1)]


def expected(camera, changes, pixels):
    model = AngleModel.of(camera, is_bent=True)
    return angles_of(model, camera.bearings_from_pixels(pixels)).changed(changes).bearings


def apart_deg(bearings, others):
    return np.degrees(np.linalg.norm(bearings - others, axis=1))


def test_a_factor_of_all_angles_is_exact_for_a_kannala_brandt_lens():
    changes, pixels = np.array([-0.05, 0.0, 0.0]), pixels_of(FISHEYE)
    lens = changed_lens(FISHEYE, changes)
    assert (
        apart_deg(lens.bearings_from_pixels(pixels), expected(FISHEYE, changes, pixels)).max()
        < 1e-6
    )
    assert lens.fx == pytest.approx(228.0 / 0.95)
    assert (lens.cx, lens.cy) == (472.0, 308.0)


@pytest.mark.parametrize("camera", LENSES, ids=lambda each: type(each).__name__)
def test_other_lenses_and_curves_are_met_within_a_fraction_of_a_pixel(camera):
    changes, pixels = np.array([0.06, -0.02, 0.005]), pixels_of(camera)
    lens = changed_lens(camera, changes)
    apart = apart_deg(lens.bearings_from_pixels(pixels), expected(camera, changes, pixels))
    assert apart.max() < 0.5 * np.degrees(1.0 / camera.fx)


def test_another_focal_length_of_a_pinhole_is_a_pinhole():
    camera = Pinhole(1000, 800, 500.0, 510.0, 490.0, 400.0)
    assert changed_lens(camera, np.array([0.25])) == replace(camera, fx=400.0, fy=408.0)


def test_another_focal_length_of_a_perspective_lens_is_met_within_a_fraction_of_a_pixel():
    camera = UnifiedCamera(1000, 800, 500.0, 500.0, 500.0, 400.0, xi=0.0, k1=-0.1, k2=0.01)
    pixels, factor = pixels_of(camera), 1.05
    lens = changed_lens(camera, np.array([factor - 1.0]))
    x, y, z = camera.bearings_from_pixels(pixels).T
    longer = np.stack([factor * x, factor * y, z], axis=1)
    longer /= np.linalg.norm(longer, axis=1)[:, None]
    apart = apart_deg(lens.bearings_from_pixels(pixels), longer)
    assert apart.max() < 0.5 * np.degrees(1.0 / camera.fx)


def test_the_edge_of_a_lens_moves_with_its_angles():
    lens = changed_lens(EQUIDISTANT, np.array([0.1, 0.0, 0.0]))
    rim = np.array([[480.0 + 0.999 * 250.0 * np.radians(95.0), 300.0]])
    x, _, z = lens.bearings_from_pixels(rim)[0]
    assert np.degrees(np.arctan2(x, z)) == pytest.approx(0.999 * 104.5, abs=1e-6)


def test_the_last_digits_of_the_changes_make_no_other_lens():
    lens = changed_lens(FISHEYE, np.array([0.06, -0.02, 0.005]))
    assert changed_lens(FISHEYE, np.array([0.06, -0.02, 0.005]) * (1.0 + 1e-14)) == lens


def test_no_change_is_the_same_lens():
    pixels = pixels_of(FISHEYE)
    lens = changed_lens(FISHEYE, np.zeros(3))
    assert (
        apart_deg(lens.bearings_from_pixels(pixels), FISHEYE.bearings_from_pixels(pixels)).max()
        < 1e-9
    )


@pytest.mark.parametrize(
    "camera",
    [Equirectangular(200, 100), UnifiedCamera(1000, 800, 500, 500, 500, 400, xi=0.9, p1=0.01)],
    ids=["panorama", "tangential"],
)
def test_what_no_such_lens_comes_near_to_has_none(camera):
    assert changed_lens(camera, np.array([0.05, 0.0, 0.0])) is None


def test_a_panorama_has_the_bearings_of_the_changed_angles():
    camera = Equirectangular(2000, 900, 340.0, 150.0, 10.0, 5.0)
    changes, pixels = np.array([-0.03, 0.05, -0.02]), pixels_of(Equirectangular(2000, 900))
    changed = changed_panorama(camera, changes)
    want = expected(camera, changes, pixels)
    assert apart_deg(changed.bearings_from_pixels(pixels), want).max() < 1e-9


def test_a_panorama_stays_within_the_sphere():
    changed = changed_panorama(Equirectangular(2000, 1000), np.array([0.1, 0.02, 0.1]))
    assert changed == Equirectangular(2000, 1000)
    lowered = changed_panorama(Equirectangular(2000, 1000), np.array([0.0, -0.1, 0.3]))
    assert lowered.vertical_fov_deg == pytest.approx(162.0)
    assert lowered.center_latitude_deg == pytest.approx(-9.0)
