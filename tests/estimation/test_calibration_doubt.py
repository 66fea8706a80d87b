# SPDX-License-Identifier: BSD-3-Clause
"""Cameras whose angles are wrong by some percent: noticed, said, and in sigma."""

import re
from functools import partial

import numpy as np
import pytest
from rooms_by_wrong_cameras import (
    LENS,
    NOISE_RAD,
    PANORAMA,
    PINHOLE,
    errors_deg,
    estimated,
    seen,
    taken_for_smaller,
    unit,
)

import epi360
from epi360 import estimate_relative_pose
from epi360.cameras import Equirectangular
from epi360.cameras.changed_angles import AngleModel, PairOfAngles, angles_of
from epi360.estimation.angle_changes import fit_angle_changes
from epi360.estimation.calibration_doubt import (
    CALIBRATION_QUESTION,
    with_calibration_doubt,
)
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.result import pose_sigmas_deg
from epi360.poses import rotation_from_vector


def doubted(result, bearings, camera):
    estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS)
    return with_calibration_doubt(result, bearings, (camera, camera), estimate).result


@pytest.mark.parametrize(
    ("camera", "changes", "words"),
    [
        (LENS, [-0.08], r"angles from the axis of both images are [78]\.\d% smaller"),
        (PINHOLE, [0.1], r"the focal length of both images is (8|9|10)\.\d% shorter"),
        (PANORAMA, [-0.0278, 0.0, 0.0], r"both images are 3(49|50)\.\d degrees around, not 360 "),
        (PANORAMA, [0.0, 0.1, 0.0], r"both images are 19[789]\.\d degrees high, not 180 "),
        (
            PANORAMA,
            [0.0, 0.0, 0.1],
            r"the middle row of both images is at a latitude of -5\.\d degrees, not 0 ",
        ),
    ],
)
def test_a_doubt_is_said_and_sigma_covers_the_error(camera, changes, words):
    inflated = []
    for seed in range(6):
        bearings, truth = seen(seed, camera, changes)
        result = estimated(bearings)
        told = doubted(result, bearings, camera)
        np.testing.assert_array_equal(told.cam2_from_cam1.matrix(), result.cam2_from_cam1.matrix())
        if told.warnings == result.warnings:
            continue
        *_, other = told.alternatives
        assert (errors_deg(other, truth) < 0.3).all()
        (warning,) = set(told.warnings) - set(result.warnings)
        assert re.search(words, warning) and CALIBRATION_QUESTION in warning
        ratio = errors_deg(told.cam2_from_cam1, truth) / pose_sigmas_deg(told)
        assert (ratio < 3.0).all()
        assert (np.linalg.eigvalsh(told.covariance - result.covariance) > -1e-15).all()
        inflated.append(errors_deg(result.cam2_from_cam1, truth) / pose_sigmas_deg(result))
    assert len(inflated) >= 4
    assert np.median(inflated) > 1.5  # what they had stated


def test_a_lens_with_another_curve_has_its_angles_named():
    model = AngleModel.of(LENS, is_curved=True)
    named = 0
    for seed in range(10):
        bearings, truth = seen(seed, LENS, [0.0])
        angles = angles_of(model, np.concatenate(bearings))
        curved = np.split(angles.changed(np.array([-0.01, 0.03])).bearings, 2)
        told = doubted(estimated(curved), curved, LENS)
        words = "what is taken for 30 and 60 degrees from the axis of both images is"
        if words not in " ".join(told.warnings):
            continue
        named += 1
        other = told.alternatives[-1] if told.alternatives else told.cam2_from_cam1
        assert (errors_deg(other, truth) < 0.6).all()
    assert named >= 3


@pytest.mark.parametrize("view", [1, 2])
def test_a_pose_that_a_cut_picture_leads_astray_is_that_with_other_angles(view):
    replaced = 0
    for seed in range(12):
        bearings, truth = with_one_cut(seed, 9.0, view, moved=True)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        if not result.success or errors_deg(result.cam2_from_cam1, truth).max() < 12.0:
            continue
        told = doubted(result, bearings, PANORAMA)
        assert told.success
        if not is_of_other_angles(told):
            continue
        assert "this is the pose that they say then" in told.warnings[-1]
        replaced += 1
        errors = errors_deg(told.cam2_from_cam1, truth)
        assert (errors < 0.5).all() and (errors < 3.0 * np.array(pose_sigmas_deg(told))).all()
        assert f"of image {view}" in told.warnings[-1] or f"image {view} is" in told.warnings[-1]
    assert replaced >= 2


def is_of_other_angles(result):
    return any("this is the pose that they say then" in warning for warning in result.warnings)


def misled(view):
    """A problem of which a cut picture leads the pose astray, and what other angles say."""
    for seed in range(12):
        bearings, truth = with_one_cut(seed, 9.0, view, moved=True)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        if result.success and errors_deg(result.cam2_from_cam1, truth).max() > 12.0:
            cameras = PANORAMA, PANORAMA
            told = with_calibration_doubt(result, bearings, cameras, estimate_relative_pose)
            if is_of_other_angles(told.result):
                return result, bearings, told
    raise AssertionError("no problem is misled")


@pytest.mark.parametrize("view", [1, 2])
def test_the_cameras_of_such_a_pose_are_told(view):
    _, _, told = misled(view)
    cut, other = told.cameras[view - 1], told.cameras[2 - view]
    assert other == PANORAMA
    assert cut.vertical_fov_deg == pytest.approx(171.0, abs=1.0)
    assert cut.center_latitude_deg == pytest.approx(4.5, abs=0.6)


def test_no_pose_belongs_to_more_than_a_sphere(monkeypatch):
    result, bearings, _ = misled(2)
    monkeypatch.setattr(PairOfAngles, "share_beyond", lambda *_: 0.03)
    cameras = PANORAMA, PANORAMA
    told = with_calibration_doubt(result, bearings, cameras, estimate_relative_pose)
    assert told.result is result and told.cameras == cameras


@pytest.mark.parametrize(("camera", "changes"), [(LENS, [0.0]), (PANORAMA, [0.0, 0.0, 0.0])])
def test_good_cameras_leave_no_doubt(camera, changes):
    for seed in range(8):
        bearings, _ = seen(seed, camera, changes)
        result = estimated(bearings)
        assert doubted(result, bearings, camera) is result


def test_wrong_matches_that_agree_with_other_angles_leave_no_doubt():
    """They gain by such a change; the inliers, which lie around the horizon, do not."""
    for seed in range(6):
        right, truth = seen(seed, PANORAMA, [0.0, 0.0, 0.0], num=900, wrong=0)
        stretched, _ = seen(seed, PANORAMA, [0.0, 0.2, 0.0], num=900, wrong=0)
        sines = np.abs(right[0][:, 1])
        bearings = tuple(
            np.concatenate([b[sines < 0.15], other[sines > 0.5][:100]])
            for b, other in zip(right, stretched, strict=True)
        )
        result = estimated(bearings)
        assert (errors_deg(result.cam2_from_cam1, truth) < 0.3).all()
        assert doubted(result, bearings, PANORAMA) is result
        cameras = PANORAMA, PANORAMA
        found = fit_angle_changes(result.cam2_from_cam1, bearings, cameras, result.noise_deg)
        assert found.changes[1].change > 10.0 * found.changes[1].sigma and found.gain < 0.0


def test_nothing_is_asked_without_a_pose_or_with_few_inliers():
    rng = np.random.default_rng(0)
    apart = unit(rng.normal(size=(60, 3))), unit(rng.normal(size=(60, 3)))
    result = estimate_relative_pose(*apart)
    assert not result.success and doubted(result, apart, PANORAMA) is result
    bearings, _ = seen(0, LENS, [0.1], num=15, wrong=0)
    few = estimate_relative_pose(*bearings)
    assert doubted(few, bearings, LENS) is few


def test_a_step_straight_up_says_nothing_of_heights():
    """Latitudes do not matter to epipolar curves that are meridians."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-1.0, 1.0, (300, 3)) * [4.0, 1.5, 4.0]
    points = points[np.hypot(points[:, 0], points[:, 2]) > 1.0]
    pair = unit(points), unit(points - [0.0, 0.3, 0.0])
    bearings = tuple(unit(b + rng.normal(0.0, NOISE_RAD, b.shape)) for b in pair)
    result = estimated(bearings)
    assert doubted(result, bearings, PANORAMA) is result


def turns_that_seem_to_be_steps(wrong_bearings):
    """Answers of which the wrong lens makes a step, with the doubt, and the true poses."""
    found = []
    for seed in range(12):
        bearings, pose = wrong_bearings(seed)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        if result.success:
            found.append((doubted(result, bearings, LENS), pose))
    assert len(found) >= 3  # which the wrong lens seems to show
    return found


def test_a_turn_through_a_wrong_lens_is_a_turn():
    def larger(seed):
        return seen(seed, LENS, [0.06], moved=False)

    for told, pose in turns_that_seem_to_be_steps(larger):
        assert told.status == "pure_rotation"
        assert epi360.rotation_error_deg(told.cam2_from_cam1, pose) < 0.2
        assert told.num_inliers > 280 and np.isnan(told.cam2_from_cam1.translation).all()
        assert (
            "has only turned if what is taken for 30 and 60 degrees from the axis of both"
            in told.warnings[-1]
        )
        assert told.warnings[-1].endswith(CALIBRATION_QUESTION)


def test_exact_matches_leave_no_doubt():
    for moved in (True, False):
        bearings, _ = seen(3, PANORAMA, [0.0, 0.0, 0.0], moved=moved, wrong=0, noise=0.0)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        assert doubted(result, bearings, PANORAMA) is result


def test_a_turn_through_a_lens_with_another_curve_is_a_turn():
    def curved(seed):
        bearings, pose = seen(seed, LENS, [0.0], moved=False)
        model = AngleModel.of(LENS, is_curved=True)
        angles = angles_of(model, np.concatenate(bearings))
        return np.split(angles.changed(np.array([0.0, 0.03])).bearings, 2), pose

    for told, pose in turns_that_seem_to_be_steps(curved):
        assert told.status == "pure_rotation"
        assert epi360.rotation_error_deg(told.cam2_from_cam1, pose) < 0.5


def cut_off(bearings, degrees):
    """Bearings of a panorama without what lies so far down, stretched back to 2:1."""
    kept = 1.0 - degrees / 180.0
    return taken_for_smaller(bearings, PANORAMA, 0.0, kept - 1.0, -np.radians(degrees) / 2.0)


def with_one_cut(seed, degrees, view, *, moved):
    (first, second), pose = seen(seed, PANORAMA, [0.0, 0.0, 0.0], moved=moved, wrong=40)
    cut = [b if k != view else cut_off(b, degrees) for k, b in enumerate((first, second), 1)]
    # What lies below is not in the picture.
    kept = np.arcsin((first, second)[view - 1][:, 1]) < np.radians(90.0 - degrees)
    return tuple(b[kept] for b in cut), pose


@pytest.mark.parametrize("view", [1, 2])
@pytest.mark.parametrize("degrees", [18.0, 36.0])
@pytest.mark.parametrize("other", [PANORAMA, Equirectangular(1024, 512)])
def test_a_panorama_whose_bottom_was_cut_off_has_not_moved_from_the_other(other, degrees, view):
    answers = set()
    for seed in range(6):
        bearings, pose = with_one_cut(seed, degrees, view, moved=False)
        estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS)
        result = estimate(*bearings)
        told = with_calibration_doubt(result, bearings, (PANORAMA, other), estimate).result
        answers.add(told.status)
        if result.status == "ok":
            assert told.status == "pure_rotation"
            assert epi360.rotation_error_deg(told.cam2_from_cam1, pose) < 0.3
            words = r"turned if image [12] is 3(60\.0|59\.9) degrees around"
            assert re.search(words, told.warnings[-1])
    assert "pure_rotation" in answers and answers <= {"pure_rotation", "too_few_inliers"}


def test_a_panorama_whose_bottom_was_cut_off_is_named():
    named = []
    for seed in range(6):
        bearings, truth = with_one_cut(seed, 5.0, 2, moved=True)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        if not result.success:
            continue
        told = doubted(result, bearings, PANORAMA)
        named.append("the middle row of image 2 is at a latitude of 2." in " ".join(told.warnings))
        ratio = errors_deg(told.cam2_from_cam1, truth) / pose_sigmas_deg(told)
        assert (ratio < 3.0).all()
    assert len(named) >= 3 and np.mean(named) > 0.6


@pytest.mark.parametrize("step_m", [0.02, 0.05, 0.1, 0.3])
def test_a_small_step_stays_a_step(step_m):
    """Where the noise is large, other angles of both images may hide it (none of these)."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        turn = rotation_from_vector([0.02, rng.uniform(-0.6, 0.6), 0.01])
        step = step_m * unit(rng.normal(size=3) * [1.0, 0.3, 1.0])
        room = rng.uniform(-1.0, 1.0, (300, 3))
        walls = rng.integers(0, 3, 300)
        room[np.arange(300), walls] = np.sign(room[np.arange(300), walls])
        room = room * [3.5, 1.4, 2.8]
        pair = unit(room), unit((room - step) @ turn.T)
        bearings = tuple(unit(b + rng.normal(0.0, 0.4 * NOISE_RAD, b.shape)) for b in pair)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        if result.success:
            assert doubted(result, bearings, PANORAMA) is result


@pytest.mark.parametrize(("distance_m", "height_m", "spread"), [(10, 3, 0.05), (10, 1, 0.02)])
def test_a_camera_that_rises_in_a_round_hall_has_moved(distance_m, height_m, spread):
    """Where all is at one distance, it lowers the middle, as a cut does, but shrinks nothing."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        around = rng.uniform(0.0, 2.0 * np.pi, 400)
        away = distance_m * (1.0 + spread * rng.normal(size=400))
        heights = rng.uniform(-height_m, height_m, 400)
        points = np.stack([away * np.cos(around), heights, away * np.sin(around)], axis=1)
        pair = unit(points), unit(points - [0.0, -1.0, 0.0])
        bearings = tuple(unit(b + rng.normal(0.0, 2.0 * NOISE_RAD, b.shape)) for b in pair)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        assert result.success and doubted(result, bearings, PANORAMA).success


@pytest.mark.parametrize("seed", [75, 111, 321, 495, 693])
def test_a_step_before_a_wall_is_no_turn_with_other_angles(seed):
    """Nearer by a fifth, one wall looks as in a panorama that is narrower by a fifth."""
    rng = np.random.default_rng(seed)
    num_on_wall, half_m = int(rng.uniform(100, 220)), rng.uniform(0.4, 1.2)
    rough_m, noise_deg, away_m = (
        rng.uniform(*each) for each in ((0, 0.15), (0.05, 0.25), (1.5, 3.5))
    )
    size = num_on_wall
    sides = rng.uniform(-half_m, half_m, size), rng.uniform(-0.7, 0.7, size)
    wall = np.column_stack([*sides, away_m + rough_m * rng.normal(size=size)])
    to_wall = rotation_from_vector([0.0, rng.uniform(-3.0, 3.0), 0.0])
    num_around = int(rng.uniform(30, 120))
    around = unit(rng.normal(size=(num_around, 3))) * rng.uniform(1.5, 5.0, (num_around, 1))
    points = np.concatenate([wall @ to_wall.T, around])
    turn = rotation_from_vector([0.0, rng.uniform(-1.5, 1.5), 0.0])
    ahead = to_wall @ [rng.normal(), 0.0, rng.choice([-1, 1])]
    step = rng.uniform(0.1, 0.35) * away_m * ahead / np.linalg.norm(ahead)
    views = [unit(points), unit((points - step) @ turn.T)]
    views = [unit(b + np.radians(noise_deg) * rng.normal(size=b.shape)) for b in views]
    bearings = tuple(np.concatenate([b, unit(rng.normal(size=(60, 3)))]) for b in views)
    result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS, max_noise_deg=0.5)
    assert result.status == "ok"
    assert doubted(result, bearings, PANORAMA).status == "ok"
