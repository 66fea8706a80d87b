# SPDX-License-Identifier: BSD-3-Clause
"""Changes of the cameras' angles, fitted together with a pose or a turn, and their twins."""

from dataclasses import replace

import numpy as np
import pytest
from rooms_by_wrong_cameras import (
    LENS,
    NOISE_RAD,
    OTHER_LENS,
    PANORAMA,
    PINHOLE,
    errors_deg,
    estimated,
    seen,
    unit,
)

import epi360
from epi360 import estimate_relative_pose
from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.cameras.changed_angles import AngleModel, PairOfAngles, angles_of, with_curves
from epi360.epipolar.residuals import tangent_basis
from epi360.estimation.angle_changes import (
    MOST_OF_TURN,
    AngleChange,
    changed_by_a_turn,
    fit_angle_changes,
)
from epi360.estimation.angle_changes_reference import AngleFit, changed_by_a_turn_reference
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.poses import Pose, rotation_from_vector


@pytest.mark.parametrize(
    ("camera", "changes"),
    [
        (LENS, [0.05]),
        (LENS, [-0.08]),
        (PINHOLE, [0.05]),
        (PINHOLE, [-0.08]),
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


@pytest.mark.parametrize(
    "camera", [LENS, PINHOLE, PANORAMA, Equirectangular(900, 400, 180.0, 80.0, 40.0)]
)
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
    (PINHOLE, PINHOLE),
    (PANORAMA, PINHOLE),
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
    part = Equirectangular(900, 400, 180.0, 80.0, 40.0, -20.0)
    models = [AngleModel.of(each, is_curved=True) for each in (LENS, PANORAMA, part)]
    for model in (*models, AngleModel.of(PINHOLE)):
        changed = angles_of(model, bearings[0]).changed(np.zeros(len(model.directions)))
        np.testing.assert_allclose(changed.bearings, bearings[0], atol=1e-12)
        lengths = np.linalg.norm(changed.by_measured, axis=1)
        np.testing.assert_allclose(lengths, 1.0, atol=1e-9)


@pytest.mark.parametrize("only", [0, 1, 2])
@pytest.mark.parametrize("cameras", CAMERAS)
def test_the_core_fits_from_changes_that_are_known_as_its_twin_does(cameras, only):
    bearings, truth = seen(5, LENS, [0.05])
    pose = Pose(truth.rotation, unit(truth.translation))
    angles = PairOfAngles.of(cameras, bearings, is_curved=True, only=only)
    start = np.linspace(0.02, -0.01, len(angles.names))
    found = fit_angle_changes(
        pose, bearings, cameras, np.degrees(NOISE_RAD), only=only, is_curved=True, start=start
    )
    twin = AngleFit(angles, start, pose, NOISE_RAD)
    assert found.gain == pytest.approx(twin.run(), rel=1e-6, abs=1e-6)
    assert found.names == angles.names
    np.testing.assert_allclose(found.sizes, twin.changes, atol=1e-8)
    np.testing.assert_allclose(found.cam2_from_cam1.matrix(), twin.pose.matrix(), atol=1e-8)


@pytest.mark.parametrize("change", [0.02, -0.1])
def test_a_shorter_focal_length_has_the_rays_of_that_camera(change):
    pixels = np.random.default_rng(0).uniform(0.0, 1000.0, (50, 2))
    shorter = replace(PINHOLE, fx=PINHOLE.fx / (1.0 + change), fy=PINHOLE.fy / (1.0 + change))
    angles = angles_of(AngleModel.of(PINHOLE), PINHOLE.bearings_from_pixels(pixels))
    changed = angles.changed(np.array([change])).bearings
    np.testing.assert_allclose(changed, shorter.bearings_from_pixels(pixels), atol=1e-14)
    assert not angles.beyond(np.array([change])).any()


def test_a_focal_length_that_changes_little_is_a_curve_of_the_angles():
    """Up to 60 degrees from the axis, to a hundredth of the change."""
    angle, change = np.linspace(0.0, np.pi / 3.0, 20), 0.001
    b = np.stack([np.sin(angle), np.zeros(20), np.cos(angle)], axis=1)
    sizes = with_curves({(2, "focal"): change, (1, "radial"): 0.3})
    assert sizes.pop((1, "radial")) == 0.3
    bent = np.array([sizes.pop((2, each)) for each in ("radial", "curve", "edge")])
    assert not sizes
    as_focal = angles_of(AngleModel("focal"), b).changed(np.array([change])).bearings
    as_bent = angles_of(AngleModel("bent"), b).changed(bent).bearings
    assert np.abs(as_focal - as_bent).max() < 0.03 * change
    assert np.abs(as_focal - b).max() > 0.3 * change


def test_as_many_changes_must_be_known_as_the_cameras_have():
    bearings, truth = seen(5, LENS, [0.05])
    pose = Pose(truth.rotation, unit(truth.translation))
    with pytest.raises(ValueError, match="as many changes as these cameras have"):
        fit_angle_changes(pose, bearings, (LENS, LENS), 0.05, start=np.zeros(2))


def test_how_uncertain_the_changes_are_is_part_of_the_pose():
    """With the changes fixed a pose moves with them as the covariance says."""
    bearings, truth = seen(0, LENS, [0.05], wrong=0)
    pose, cameras = Pose(truth.rotation, unit(truth.translation)), (LENS, LENS)
    found = fit_angle_changes(pose, bearings, cameras, np.degrees(NOISE_RAD))
    basis = tangent_basis(found.cam2_from_cam1.translation)
    covariance = found.pose_covariance(basis)
    assert (np.linalg.eigvalsh(covariance) > -1e-15).all()
    (change,) = found.changes
    moved = []
    for sizes in (found.sizes - change.sigma, found.sizes + change.sigma):
        angles = PairOfAngles.of(cameras, bearings)
        views = (view.bearings for view in angles.changed(sizes))
        moved.append(estimate_relative_pose(*views, options=IMAGE_OPTIONS).cam2_from_cam1)
    turned = epi360.rotation_error_deg(*moved) / 2.0
    aside = epi360.translation_error_deg(*moved) / 2.0
    assert turned == pytest.approx(np.degrees(np.sqrt(np.trace(covariance[:3, :3]))), rel=0.3)
    assert aside == pytest.approx(np.degrees(np.sqrt(np.trace(covariance[3:, 3:]))), rel=0.3)


def test_matches_that_determine_no_change_have_none():
    """All on one circle around the axis: their angle from it is one number."""
    around = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    b = np.stack([0.5 * np.cos(around), 0.5 * np.sin(around), np.full(40, 0.75**0.5)], axis=1)
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
    found = fit_angle_changes(pose, (b, b), (LENS, LENS), 0.1)
    assert isinstance(found.changes[0], AngleChange) and not found.changes[0].sigma < 0.01


def test_a_turn_says_what_the_angles_must_be_multiplied_by():
    for change in (0.06, -0.1, 0.0):
        bearings, pose = seen(3, LENS, [change], moved=False, wrong=0)
        start = rotation_from_vector([0.0, 0.02, 0.0]) @ pose.rotation
        found = changed_by_a_turn(start, bearings, (LENS, LENS), 0.05)
        np.testing.assert_allclose(found, [change, 0.0], atol=0.005)


def test_no_turn_explains_a_step_in_a_room():
    bearings, pose = seen(3, LENS, [0.0], wrong=0)
    assert changed_by_a_turn(pose.rotation, bearings, (LENS, LENS), 0.05) is None


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


@pytest.mark.parametrize(
    ("changes", "is_beyond"),
    [
        ((0.0, 0.0, 0.0), False),
        ((-0.1, -0.1, 0.0), False),
        ((0.0, -0.1, 0.15), False),  # the lowest tenth was cut off
        ((0.0, -0.1, 0.3), True),  # what is lowest would lie beyond the nadir
        ((0.05, 0.0, 0.0), True),
        ((0.0, 0.2, 0.0), True),
    ],
)
def test_no_panorama_shows_more_than_a_sphere(changes, is_beyond):
    panorama = Equirectangular(2000, 1000)
    pixels = np.random.default_rng(0).uniform(0.0, [2000.0, 1000.0], (2000, 2))
    bearings = panorama.bearings_from_pixels(pixels)
    smaller = Equirectangular(1000, 500)  # of another camera, so that it changes by itself
    for only, own in ((0, (*changes, 0.0, 0.0, 0.0)), (1, changes), (2, changes)):
        angles = PairOfAngles.of((panorama, smaller), (bearings, bearings), only=only)
        assert (angles.share_beyond(np.array(own)) > 0.01) == is_beyond


def test_no_lens_looks_farther_than_behind_itself():
    lens = KannalaBrandt(800, 800, 250.0, 250.0, 400.0, 400.0)
    angles = np.radians([30.0, 90.0, 150.0])
    bearings = np.column_stack([np.sin(angles), 0.0 * angles, np.cos(angles)])
    pair = PairOfAngles.of((lens, lens), (bearings, bearings))
    assert pair.share_beyond(np.array([0.1])) == 0.0
    assert pair.share_beyond(np.array([0.3])) == pytest.approx(1 / 3)
