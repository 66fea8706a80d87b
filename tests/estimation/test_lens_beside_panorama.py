# SPDX-License-Identifier: BSD-3-Clause
"""A photograph beside a panorama, of which nearly all that both see is one wall."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from epi360 import Equirectangular, KannalaBrandt, Pinhole, Pose, estimate_relative_pose
from epi360.estimation.calibration_doubt import with_calibration_doubt
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.lens_beside_panorama import with_focal_uncertainty
from epi360.poses import rotation_error_deg, rotation_from_vector, translation_error_deg

PANORAMA = Equirectangular(2048, 1024)
PHOTOGRAPH = Pinhole(1000, 750, 500.0, 500.0, 500.0, 375.0)
LENS = KannalaBrandt(1000, 1000, 320.0, 320.0, 500.0, 500.0)
STEP = Pose(rotation_from_vector([0.05, 0.4, -0.03]), np.array([0.5, 0.1, 0.4]))
TURN = Pose(STEP.rotation, np.zeros(3))
NOISE_RAD = 5e-4


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def seen(share_of_wall=0.9, count=200, seed=0, motion=STEP):
    """Bearings of a wall four metres ahead, and of some things before it."""
    rng = np.random.default_rng(seed)
    depths = np.where(rng.uniform(size=count) < share_of_wall, 4.0, rng.uniform(2.0, 4.0, count))
    points = np.column_stack([rng.uniform(-1.5, 1.5, count), rng.uniform(-1.2, 1.2, count), depths])
    both = points, points @ motion.rotation.T + motion.translation
    return [unit(unit(each) + NOISE_RAD * rng.normal(size=each.shape)) for each in both]


def by_lens(bearings, camera, factor):
    """Bearings of a photograph by a focal length that is wrong by a factor."""
    other = replace(camera, fx=factor * camera.fx, fy=factor * camera.fy)
    return other.bearings_from_pixels(camera.pixels_from_bearings(bearings))


def errors(result):
    pose = result.cam2_from_cam1
    return np.array([rotation_error_deg(pose, STEP), translation_error_deg(pose, STEP)])


def sigmas(result):
    return np.array([result.rotation_sigma_deg, result.translation_sigma_deg])


def estimated(bearings):
    result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS, max_noise_deg=0.5)
    assert result.success
    return result


@pytest.mark.parametrize("camera", [PHOTOGRAPH, LENS])
@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_sigma_covers_a_focal_length_that_is_a_percent_wrong(camera, factor):
    first, second = seen()
    bearings = first, by_lens(second, camera, factor)
    given = estimated(bearings)
    told = with_focal_uncertainty(given, bearings, (PANORAMA, camera))
    assert (errors(given) / sigmas(given)).max() > 2.5
    assert (errors(told) / sigmas(told)).max() < 2.0
    np.testing.assert_array_equal(told.cam2_from_cam1.matrix(), given.cam2_from_cam1.matrix())
    assert np.linalg.eigvalsh(told.covariance - given.covariance).min() > -1e-12


def test_either_image_may_be_the_photograph():
    first, second = seen()
    there = with_focal_uncertainty(
        estimated((first, second)), (first, second), (PANORAMA, PHOTOGRAPH)
    )
    back = with_focal_uncertainty(
        estimated((second, first)), (second, first), (PHOTOGRAPH, PANORAMA)
    )
    # The direction is seen from the other camera, whose rotation is uncertain, too.
    np.testing.assert_allclose(sigmas(there), sigmas(back), rtol=0.25)


@pytest.mark.parametrize("factor", [0.87, 1.15])
@pytest.mark.parametrize("is_first", [False, True])
def test_a_focal_length_that_is_wrong_by_much_is_named_and_mended(factor, is_first):
    panorama, photograph = seen(share_of_wall=0.4)
    bearings = [panorama, by_lens(photograph, PHOTOGRAPH, factor)]
    cameras, truth = [PANORAMA, PHOTOGRAPH], STEP
    if is_first:
        bearings, cameras, truth = bearings[::-1], cameras[::-1], STEP.inverse()
    estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS, max_noise_deg=0.5)
    given = estimated(bearings)
    told = with_calibration_doubt(given, tuple(bearings), tuple(cameras), estimate)
    (warning,) = [each for each in told.result.warnings if "focal length" in each]
    change, how = (0.15, "longer") if factor < 1.0 else (0.13, "shorter")
    found = re.search(r"focal length of image (\d) is ([\d.]+)% (\w+) ", warning)
    assert found and found[1] == ("1" if is_first else "2") and found[3] == how
    assert float(found[2]) == pytest.approx(100.0 * change, abs=1.5)
    poses = [told.result.cam2_from_cam1, *told.result.alternatives]
    assert min(translation_error_deg(pose, truth) for pose in poses) < 1.0
    assert translation_error_deg(given.cam2_from_cam1, truth) > 3.0


def test_a_photograph_at_the_place_of_the_panorama_has_not_moved():
    estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS, max_noise_deg=0.5)
    steps = 0
    for seed in range(8):
        panorama, photograph = seen(share_of_wall=0.0, seed=seed, motion=TURN)
        bearings = panorama, by_lens(photograph, PHOTOGRAPH, 1.15)
        given = estimate(*bearings)
        told = with_calibration_doubt(given, bearings, (PANORAMA, PHOTOGRAPH), estimate)
        steps += given.status == "ok"
        assert told.result.status != "ok"
    assert steps >= 3


@pytest.mark.parametrize("is_first", [False, True])
def test_a_step_before_a_wall_by_a_right_focal_length_is_no_turn(is_first):
    estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS, max_noise_deg=0.5)
    for seed in range(12):
        panorama, photograph = seen(count=250, seed=seed)
        photograph[:60] = photograph[np.random.default_rng(seed).permutation(60)]
        bearings, cameras = (panorama, photograph), (PANORAMA, PHOTOGRAPH)
        if is_first:
            bearings, cameras = bearings[::-1], cameras[::-1]
        told = with_calibration_doubt(estimated(bearings), bearings, cameras, estimate)
        assert told.result.status == "ok"


def test_a_right_focal_length_leaves_no_doubt():
    estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS, max_noise_deg=0.5)
    for seed in range(10):
        bearings = seen(share_of_wall=0.1 * seed, seed=seed)
        given = estimated(bearings)
        told = with_calibration_doubt(given, tuple(bearings), (PANORAMA, PHOTOGRAPH), estimate)
        assert told.result is given


def test_it_is_said_where_the_pose_depends_on_the_focal_length_by_much():
    small = Pose(STEP.rotation, 0.3 * STEP.translation)
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1.5, 1.5, (300, 2)), rng.uniform(3.8, 4.0, 300)])
    both = points, points @ small.rotation.T + small.translation
    bearings = [unit(unit(each) + 1e-4 * rng.normal(size=each.shape)) for each in both]
    told = with_focal_uncertainty(estimated(bearings), bearings, (PANORAMA, PHOTOGRAPH))
    (warning,) = [each for each in told.warnings if "focal length of image 2" in each]
    moved_deg = float(warning.rpartition(" ")[2])
    assert moved_deg > 2.0
    assert told.translation_sigma_deg == pytest.approx(moved_deg, rel=0.3)
    room = seen(share_of_wall=0.0)
    told = with_focal_uncertainty(estimated(room), room, (PANORAMA, PHOTOGRAPH))
    assert not any("focal length" in each for each in told.warnings)


@pytest.mark.parametrize("cameras", [(PANORAMA, PANORAMA), (PHOTOGRAPH, PHOTOGRAPH), (LENS, LENS)])
def test_two_images_of_one_kind_are_as_they_were(cameras):
    bearings = seen()
    result = estimated(bearings)
    assert with_focal_uncertainty(result, bearings, cameras) is result


def test_without_a_pose_nothing_is_asked():
    bearings = seen(count=6)
    result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
    assert not result.success
    assert with_focal_uncertainty(result, bearings, (PANORAMA, PHOTOGRAPH)) is result
