# SPDX-License-Identifier: BSD-3-Clause
"""What points in known places say of the angles of the camera that sees them."""

from dataclasses import replace

import numpy as np
import pytest
from seen_points import noisy

from epi360 import Equirectangular, KannalaBrandt, Pinhole, Pose, estimate_absolute_pose
from epi360.cameras.changed_angles import AngleModel, angles_of
from epi360.estimation.absolute_angles import (
    SeenPoints,
    angles_by_points,
    with_focal_uncertainty_by_points,
)
from epi360.estimation.absolute_covariance import refined_pose
from epi360.estimation.absolute_pose_fit import Gravity
from epi360.poses import rotation_from_vector

PHOTOGRAPH = Pinhole(1000, 750, 500.0, 500.0, 500.0, 375.0)
LENS = KannalaBrandt(1000, 1000, 320.0, 320.0, 500.0, 500.0)
PANORAMA = Equirectangular(2048, 1024)
POSE = Pose(rotation_from_vector([0.1, 0.7, -0.05]), np.array([0.3, -0.2, 0.5]))


def seen_by(camera, seed=0, count=300, wrong=60, nearest=1.5, noise_px=0.5):
    """Points in a room that a camera sees, some matched wrongly: pixels and points."""
    rng = np.random.default_rng(seed)
    size = [camera.width, camera.height]
    pixels = rng.uniform(0.0, size, (count, 2))
    if isinstance(camera, Equirectangular):
        pixels[:, 1] = camera.height * rng.uniform(0.2, 0.8, count)
    bearings = camera.bearings_from_pixels(pixels)
    pixels, bearings = (each[np.isfinite(bearings[:, 0])] for each in (pixels, bearings))
    depths = rng.uniform(nearest, 5.0, (len(bearings), 1))
    points = (bearings * depths - POSE.translation) @ POSE.rotation
    pixels = pixels + noise_px * rng.normal(size=pixels.shape)
    pixels[:wrong] = pixels[rng.permutation(wrong)]
    return pixels, points


def points_of(camera, pixels, points):
    return SeenPoints(
        camera, camera.bearings_from_pixels(pixels), points, np.zeros((len(points), 3, 3))
    )


def estimated(seen, bearings=None, guess=None):
    given = seen.bearings if bearings is None else bearings
    result = estimate_absolute_pose(given, seen.points, guess=guess, shared_error=1.0)
    assert result.success
    return result


def away(result):
    return float(
        np.linalg.norm(POSE.inverse().translation - result.cam_from_world.inverse().translation)
    )


def wrong(camera, factor):
    return replace(camera, fx=factor * camera.fx, fy=factor * camera.fy)


@pytest.mark.parametrize("camera", [PHOTOGRAPH, LENS])
@pytest.mark.parametrize("factor", [0.87, 0.97, 1.03, 1.15])
def test_a_wrong_focal_length_is_found_to_a_fraction_of_a_percent(camera, factor):
    seen = points_of(wrong(camera, factor), *seen_by(camera))
    given = estimated(seen)
    found = angles_by_points(given, seen, lambda b, guess: estimated(seen, b, guess))
    (change,) = found.clear
    assert change.sigma < 0.005
    assert abs(1.0 + change.change - factor) < 4.0 * change.sigma
    assert found.camera.fx == pytest.approx(camera.fx, rel=0.01)
    assert away(found.answer) < 0.02 < 0.5 * away(given)


@pytest.mark.parametrize("camera", [PHOTOGRAPH, LENS, PANORAMA])
def test_a_right_camera_stays(camera):
    for seed in range(8):
        seen = points_of(camera, *seen_by(camera, seed))
        assert (
            angles_by_points(estimated(seen), seen, lambda b, g, s=seen: estimated(s, b, g)) is None
        )


def test_a_panorama_without_its_lowest_part_is_found():
    given = Equirectangular(2048, 1024)
    truly = Equirectangular(2048, 1024, 360.0, 160.0, 0.0, 10.0)
    seen = points_of(given, *seen_by(truly))
    found = angles_by_points(estimated(seen), seen, lambda b, guess: estimated(seen, b, guess))
    _, vertical, middle = (each.change for each in found.changes)
    assert vertical == pytest.approx(160.0 / 180.0 - 1.0, abs=0.01)
    assert middle == pytest.approx(-np.radians(10.0), abs=0.01)
    assert found.camera is None  # COLMAP has none for a part of a panorama
    assert {each.direction for each in found.clear} == {"vertical", "middle"}
    assert away(found.answer) < 0.02


def test_few_points_say_nothing():
    seen = points_of(wrong(PHOTOGRAPH, 1.03), *seen_by(PHOTOGRAPH, count=18, wrong=0))
    given = estimated(seen)
    assert angles_by_points(given, seen, lambda b, guess: estimated(seen, b, guess)) is None
    assert with_focal_uncertainty_by_points(given, seen) is given


@pytest.mark.parametrize("camera", [PHOTOGRAPH, LENS])
@pytest.mark.parametrize("factor", [0.99, 1.0, 1.01])
def test_sigma_covers_a_focal_length_that_is_a_percent_wrong(camera, factor):
    before, after = [], []
    for seed in range(10):
        seen = points_of(wrong(camera, factor), *seen_by(camera, seed, nearest=3.5))
        given = estimated(seen)
        told = with_focal_uncertainty_by_points(given, seen)
        np.testing.assert_array_equal(told.cam_from_world.matrix(), given.cam_from_world.matrix())
        assert np.linalg.eigvalsh(told.covariance - given.covariance).min() > -1e-12
        before.append(away(given) / given.position_sigma)
        after.append(away(told) / told.position_sigma)
    assert np.median(after) < 1.6
    assert factor == 1.0 or np.median(before) > 1.5 * np.median(after)


def test_a_panorama_has_no_focal_length():
    seen = points_of(PANORAMA, *seen_by(PANORAMA))
    given = estimated(seen)
    assert with_focal_uncertainty_by_points(given, seen) is given


def test_the_covariance_of_pose_and_change_is_that_of_many_trials():
    level, deviations, stated = Gravity(None, np.array([0.0, 1.0, 0.0]), 1.0), [], []
    for seed in range(150):
        pixels, points = seen_by(PHOTOGRAPH, seed, count=80, wrong=0, noise_px=0.0)
        rng = np.random.default_rng(seed)
        b = noisy(rng, wrong(PHOTOGRAPH, 1.05).bearings_from_pixels(pixels), 1e-3)
        angles = angles_of(AngleModel.of(PHOTOGRAPH), b)
        found = refined_pose(POSE, b, points, None, level, 0.0, angles, np.zeros(1))
        error = np.append(found.pose.translation - POSE.translation, found.changes - 0.05)
        deviations.append(error[[2, 3]])
        stated.append(np.diag(found.covariance)[[5, 6]])
    ratio = np.mean(np.square(deviations), axis=0) / np.mean(stated, axis=0)
    assert ((0.7 < ratio) & (ratio < 1.5)).all()
