# SPDX-License-Identifier: BSD-3-Clause
"""Cameras whose angles are wrong by some percent: found from the matches, said, and in sigma."""

import re
from functools import partial

import numpy as np
import pytest

import epi360
from epi360 import estimate_relative_pose
from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.cameras.changed_angles import AngleModel, PairOfAngles, angles_of
from epi360.estimation.angle_changes import (
    MOST_OF_TURN,
    AngleChange,
    changed_by_a_turn,
    fit_angle_changes,
)
from epi360.estimation.angle_changes_reference import AngleFit, changed_by_a_turn_reference
from epi360.estimation.calibration_doubt import CALIBRATION_QUESTION, with_calibration_doubt
from epi360.estimation.result import pose_sigmas_deg
from epi360.poses import Pose, rotation_from_vector
from epi360.two_view import IMAGE_OPTIONS

NOISE_RAD = np.radians(0.05)
PANORAMA = Equirectangular(2048, 1024)
LENS = KannalaBrandt(1000, 1000, 300.0, 300.0, 500.0, 500.0)
OTHER_LENS = KannalaBrandt(1000, 1000, 310.0, 310.0, 500.0, 500.0)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def by_longitude_and_latitude(longitudes, down):
    cosines = np.cos(down)
    return np.stack(
        [cosines * np.sin(longitudes), np.sin(down), cosines * np.cos(longitudes)], axis=1
    )


def taken_for_smaller(bearings, camera, *changes):
    """Bearings as they are measured if the camera's angles should be larger by so much."""
    x, y, z = bearings.T
    if camera == PANORAMA:
        wider, higher, lowered = 1.0 + changes[0], 1.0 + changes[1], changes[2]
        down = (np.arctan2(y, np.hypot(x, z)) - lowered) / higher
        return by_longitude_and_latitude(np.arctan2(x, z) / wider, down)
    angle, around = np.arctan2(np.hypot(x, y), z) / (1.0 + changes[0]), np.arctan2(y, x)
    out = np.stack([np.cos(around), np.sin(around), np.zeros_like(x)], axis=1)
    return np.sin(angle)[:, None] * out + np.cos(angle)[:, None] * [0.0, 0.0, 1.0]


def seen(seed, camera, changes1, changes2=None, *, num=300, wrong=80, moved=True, noise=NOISE_RAD):
    """Bearings of a room in two views, which the cameras make smaller, and the true pose."""
    rng = np.random.default_rng(seed)
    most = 0.6 if camera != PANORAMA else 2.5  # radians
    turn = rotation_from_vector([0.05, rng.uniform(0.3 * most, most), -0.1])
    step = np.array([-0.7, 0.1, -0.3]) if moved else np.zeros(3)
    pose = Pose(turn, turn @ step)
    points = rng.uniform(-1.0, 1.0, (20 * num, 3)) * [4.0, 1.5, 4.0]
    points = points[np.linalg.norm(points, axis=1) > 0.8]
    if camera != PANORAMA:
        in_view = (unit(points) @ [0.0, 0.0, 1.0] > 0.0) & (
            unit(points @ turn.T + pose.translation) @ [0.0, 0.0, 1.0] > 0.0
        )
        points = points[in_view]
    points = points[:num]
    pair = unit(points), unit(points @ turn.T + pose.translation)
    changes = changes1, changes1 if changes2 is None else changes2
    measured = []
    for b, own in zip(pair, changes, strict=True):
        b = taken_for_smaller(b, camera, *own)
        b = unit(b + rng.normal(0.0, noise, b.shape))
        others = unit(rng.normal(size=(wrong, 3)))
        others[:, 2] = np.abs(others[:, 2]) if camera != PANORAMA else others[:, 2]
        measured.append(np.concatenate([b, others]))
    return tuple(measured), pose


def estimated(bearings):
    result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
    assert result.success
    return result


def errors_deg(pose, truth):
    return np.array(
        [epi360.rotation_error_deg(pose, truth), epi360.translation_error_deg(pose, truth)]
    )


@pytest.mark.parametrize(
    ("camera", "changes"),
    [
        (LENS, [0.05]),
        (LENS, [-0.08]),
        (PANORAMA, [-0.03, 0.0, 0.0]),
        (PANORAMA, [0.0, 0.1, 0.0]),
        (PANORAMA, [-0.02, -0.04, 0.0]),
        (PANORAMA, [0.0, 0.0, 0.1]),
        (PANORAMA, [0.0, -0.05, -0.025 * np.pi]),
    ],
)
def test_what_the_angles_must_be_multiplied_by_is_found_and_mends_the_pose(camera, changes):
    for seed in range(4):
        bearings, truth = seen(seed, camera, changes)
        result = estimated(bearings)
        found = fit_angle_changes(
            result.cam2_from_cam1, bearings, (camera, camera), result.noise_deg
        )
        assert [each.view for each in found.changes] == [0] * len(changes)
        for each, change in zip(found.changes, changes, strict=True):
            assert each.change == pytest.approx(change, abs=max(3.0 * each.sigma, 0.003))
        before = errors_deg(result.cam2_from_cam1, truth)
        after = errors_deg(found.cam2_from_cam1, truth)
        assert (after < 0.3).all() and after.sum() < 0.5 * before.sum()
        assert found.gain > 12.0


def test_each_of_two_cameras_has_its_own_change():
    changes = []
    for seed in range(9):
        bearings, _ = seen(seed, LENS, [0.06], [0.0])
        result = estimated(bearings)
        cameras = LENS, OTHER_LENS
        found = fit_angle_changes(result.cam2_from_cam1, bearings, cameras, result.noise_deg)
        first, second = found.changes
        assert (first.view, second.view) == (1, 2)
        assert first.direction == second.direction == "radial"
        changes.append([first.change, second.change])
    np.testing.assert_allclose(np.median(changes, axis=0), [0.06, 0.0], atol=0.01)


def test_swapped_views_say_the_same():
    bearings, _ = seen(1, LENS, [0.04])
    result = estimated(bearings)
    pose, noise = result.cam2_from_cam1, result.noise_deg
    there = fit_angle_changes(pose, bearings, (LENS, LENS), noise)
    back = fit_angle_changes(pose.inverse(), bearings[::-1], (LENS, LENS), noise)
    assert back.changes[0].change == pytest.approx(there.changes[0].change, abs=1e-5)
    assert back.changes[0].sigma == pytest.approx(there.changes[0].sigma, rel=0.3)
    errors = errors_deg(back.cam2_from_cam1.inverse(), there.cam2_from_cam1)
    np.testing.assert_allclose(errors, 0.0, atol=1e-3)


@pytest.mark.parametrize("camera", [LENS, PANORAMA, Equirectangular(900, 400, 180.0, 80.0, 40.0)])
def test_derivatives_are_those_of_the_residuals(camera):
    bearings, truth = seen(0, LENS, [0.0], num=30, wrong=0)
    angles = PairOfAngles.of((camera, camera), bearings)
    num = len(angles.names)
    changes = np.linspace(0.03, -0.02, num)
    pose = Pose(truth.rotation, unit(truth.translation))

    def constraints(step):
        fit = AngleFit(angles, changes, pose, NOISE_RAD)
        fit.move(step)
        return fit.linearised().residuals

    # At a pose whose residuals are about zero, the norm of the gradient need not be derived.
    residuals, J, *_ = AngleFit(angles, changes, pose, NOISE_RAD).linearised()
    small = np.abs(residuals) < 1e-2
    assert small.sum() > 10
    step = 1e-6
    for k in range(5 + num):
        move = np.zeros(5 + num)
        move[k] = step
        slopes = (constraints(move) - constraints(-move)) / (2.0 * step)
        np.testing.assert_allclose(J[small, k], slopes[small], atol=0.05)


CAMERAS = [
    (LENS, LENS),
    (LENS, OTHER_LENS),
    (PANORAMA, PANORAMA),
    (LENS, PANORAMA),
    (Equirectangular(900, 400, 180.0, 80.0, 40.0, -20.0), OTHER_LENS),
]


@pytest.mark.parametrize("only", [0, 1, 2])
@pytest.mark.parametrize("cameras", CAMERAS)
@pytest.mark.parametrize("change", [0.0, 0.05])
def test_the_core_fits_a_pose_as_its_twin_does(cameras, change, only):
    bearings, truth = seen(5, LENS, [change])
    pose = Pose(truth.rotation, unit(truth.translation))
    found = fit_angle_changes(pose, bearings, cameras, np.degrees(NOISE_RAD), only=only)
    angles = PairOfAngles.of(cameras, bearings, only=only)
    twin = AngleFit(angles, np.zeros(len(angles.names)), pose, NOISE_RAD)
    assert found.gain == pytest.approx(twin.run(), rel=1e-6, abs=1e-6)
    np.testing.assert_allclose(found.sizes, twin.changes, atol=1e-8)
    np.testing.assert_allclose(found.cam2_from_cam1.matrix(), twin.pose.matrix(), atol=1e-8)
    assert found.names == angles.names
    sigmas = [each.sigma for each in found.changes]
    np.testing.assert_allclose(sigmas, twin.linearised().sigmas_of_changes(), rtol=1e-5)


@pytest.mark.parametrize("only", [0, 1, 2])
@pytest.mark.parametrize("cameras", CAMERAS)
@pytest.mark.parametrize("moved", [False, True])
def test_the_core_fits_a_turn_as_its_twin_does(cameras, moved, only):
    bearings, truth = seen(5, LENS, [0.04], moved=moved, wrong=0)
    start = rotation_from_vector([0.0, 0.02, 0.0]) @ truth.rotation
    found = changed_by_a_turn(start, bearings, cameras, np.degrees(NOISE_RAD), only=only)
    some = tuple(b[:: 1 + len(b) // MOST_OF_TURN] for b in bearings)
    twin = changed_by_a_turn_reference(
        start, PairOfAngles.of(cameras, some, is_curved=True, only=only), NOISE_RAD
    )
    assert (found is None) == (twin is None)
    assert found is not None or moved or only or cameras[0] != LENS
    if found is not None:
        np.testing.assert_allclose(found, twin, atol=1e-8)


def test_the_bearings_themselves_come_back_without_a_change():
    bearings, _ = seen(2, PANORAMA, [0.0, 0.0, 0.0], num=50)
    for camera in (LENS, PANORAMA, Equirectangular(900, 400, 180.0, 80.0, 40.0, -20.0)):
        model = AngleModel.of(camera, is_curved=True)
        changed = angles_of(model, bearings[0]).changed(np.zeros(len(model.directions)))
        np.testing.assert_allclose(changed.bearings, bearings[0], atol=1e-12)
        lengths = np.linalg.norm(changed.by_measured, axis=1)
        np.testing.assert_allclose(lengths, 1.0, atol=1e-9)


def doubted(result, bearings, camera):
    estimate = partial(estimate_relative_pose, options=IMAGE_OPTIONS)
    return with_calibration_doubt(result, bearings, (camera, camera), estimate)


@pytest.mark.parametrize(
    ("camera", "changes", "words"),
    [
        (LENS, [-0.08], r"angles from the axis of both images are [78]\.\d% smaller"),
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
        (warning,) = set(told.warnings) - set(result.warnings)
        assert re.search(words, warning) and CALIBRATION_QUESTION in warning
        ratio = errors_deg(told.cam2_from_cam1, truth) / pose_sigmas_deg(told)
        assert (ratio < 3.0).all()
        assert (np.linalg.eigvalsh(told.covariance - result.covariance) > -1e-15).all()
        inflated.append(errors_deg(result.cam2_from_cam1, truth) / pose_sigmas_deg(result))
    assert len(inflated) >= 4
    assert np.median(inflated) > 1.5  # what they had stated


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


def test_matches_that_determine_no_change_have_none():
    """All on one circle around the axis: their angle from it is one number."""
    around = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    b = np.stack([0.5 * np.cos(around), 0.5 * np.sin(around), np.full(40, 0.75**0.5)], axis=1)
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
    found = fit_angle_changes(pose, (b, b), (LENS, LENS), 0.1)
    assert isinstance(found.changes[0], AngleChange) and not found.changes[0].sigma < 0.01


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


def test_a_turn_says_what_the_angles_must_be_multiplied_by():
    for change in (0.06, -0.1, 0.0):
        bearings, pose = seen(3, LENS, [change], moved=False, wrong=0)
        start = rotation_from_vector([0.0, 0.02, 0.0]) @ pose.rotation
        found = changed_by_a_turn(start, bearings, (LENS, LENS), 0.05)
        np.testing.assert_allclose(found, [change, 0.0], atol=0.005)


def test_no_turn_explains_a_step_in_a_room():
    bearings, pose = seen(3, LENS, [0.0], wrong=0)
    assert changed_by_a_turn(pose.rotation, bearings, (LENS, LENS), 0.05) is None


def test_exact_matches_leave_no_doubt():
    for moved in (True, False):
        bearings, _ = seen(3, PANORAMA, [0.0, 0.0, 0.0], moved=moved, wrong=0, noise=0.0)
        result = estimate_relative_pose(*bearings, options=IMAGE_OPTIONS)
        assert doubted(result, bearings, PANORAMA) is result


def test_rows_without_a_ray_are_left_out():
    bearings, _ = seen(3, LENS, [0.06])
    result = estimated(bearings)
    missing = tuple(np.concatenate([b, np.full((3, 3), np.nan)]) for b in bearings)
    found = [
        fit_angle_changes(result.cam2_from_cam1, b, (LENS, LENS), result.noise_deg)
        for b in (bearings, missing)
    ]
    assert found[0].changes == found[1].changes


@pytest.mark.parametrize("camera", [LENS, PANORAMA])
def test_derivatives_are_those_of_the_bearings(camera):
    bearings, _ = seen(1, camera, [0.0, 0.0, 0.0], num=40, wrong=0)
    model = AngleModel.of(camera, is_curved=True)
    view = angles_of(model, bearings[0])
    num = len(model.directions)
    changes = np.array([0.04, -0.02, 0.03])[:num]
    changed = view.changed(changes)
    for k in range(num):
        step = 1e-6 * np.eye(num)[k]
        slopes = (
            view.changed(changes + step).bearings - view.changed(changes - step).bearings
        ) / 2e-6
        np.testing.assert_allclose(changed.by_changes[:, :, k], slopes, atol=1e-7)
    # A small cap of measured bearings becomes one of this area.
    moved = [
        angles_of(model, unit(bearings[0] + 1e-6 * np.cross(bearings[0], axis)))
        .changed(changes)
        .bearings
        - changed.bearings
        for axis in np.eye(3)
    ]
    spans = np.stack(moved, axis=2) / 1e-6
    expected = np.linalg.svd(spans, compute_uv=False)[:, :2].prod(axis=1)
    areas = np.linalg.norm(np.cross(*np.moveaxis(changed.by_measured, 2, 0)), axis=1)
    np.testing.assert_allclose(areas, expected, rtol=1e-4)


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
        told = with_calibration_doubt(result, bearings, (PANORAMA, other), estimate)
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
