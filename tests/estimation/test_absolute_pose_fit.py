# SPDX-License-Identifier: BSD-3-Clause
import re

import numpy as np
import pytest
from seen_points import directions, moved, noisy, points_around, random_pose, scene, seen_from

from epi360 import _core
from epi360.estimation.absolute_pose_fit import fit_absolute_pose
from epi360.estimation.absolute_pose_reference import p3p_reference
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, vector_from_rotation


def errors(result, pose):
    distance = np.linalg.norm(result.cam_from_world.translation - pose.translation)
    return rotation_error_deg(result.cam_from_world, pose), distance


@pytest.mark.parametrize("seed", range(300))
def test_three_points_give_the_poses_of_the_twin(seed):
    pose, points, bearings = scene(seed, num_points=3, noise_rad=0.0)
    twin = [p.matrix() for p in p3p_reference(bearings, points)]
    found = [Pose(*p).matrix() for p in _core.p3p(bearings, points)]
    assert len(found) == len(twin)
    assert min(abs(p - pose.matrix()).max() for p in found) < 1e-7
    for matrix in found:  # twins agree to 1e-9 unless two solutions are nearly one
        nearest = min(twin, key=lambda other: abs(other - matrix).max())
        apart = sorted(abs(other - nearest).max() for other in twin)
        np.testing.assert_allclose(
            matrix, nearest, atol=1e-9 if len(apart) < 2 or apart[1] > 1e-2 else 1e-6
        )


def test_every_pose_of_three_points_puts_them_on_their_bearings():
    for seed in range(100):
        _, points, bearings = scene(seed, num_points=3, noise_rad=0.1)
        for pose in _core.p3p(bearings, points):
            np.testing.assert_allclose(seen_from(Pose(*pose), points), bearings, atol=1e-8)


@pytest.mark.parametrize("side", [np.eye(3), 2.0 * np.eye(3) - 5.0])
def test_symmetric_triangles_have_their_poses(side):
    points = side + np.array([0.0, 0.0, 4.0])
    poses = [Pose(*p) for p in _core.p3p(seen_from(Pose(np.eye(3), np.zeros(3)), points), points)]
    assert min(abs(p.matrix() - np.eye(4)).max() for p in poses) < 1e-6


def test_three_points_on_a_line_have_no_pose():
    points = np.array([[0.0, 0, 1], [1, 0, 2], [2, 0, 3]])
    assert _core.p3p(seen_from(Pose(np.eye(3), np.array([0, 1.0, 0])), points), points) == []


@pytest.mark.parametrize("with_guess", [True, False])
@pytest.mark.parametrize("seed", range(10))
def test_exact_bearings_give_the_exact_pose(seed, with_guess):
    pose, points, bearings = scene(seed, noise_rad=0.0)
    guess = moved(np.random.default_rng(seed), pose, 0.05, 0.3) if with_guess else None
    result = fit_absolute_pose(bearings, points, guess=guess)
    assert result.success and result.inlier_mask.all()
    assert max(errors(result, pose)) < 1e-7
    assert result.residuals_rad.max() < 1e-9 and np.isfinite(result.covariance).all()


@pytest.mark.parametrize("outliers", [0.0, 0.2, 0.4, 0.6, 0.7])
@pytest.mark.parametrize("seed", range(5))
def test_wrong_bearings_are_found_without_a_guess(seed, outliers):
    pose, points, bearings = scene(seed, outliers=outliers)
    result = fit_absolute_pose(bearings, points)
    assert result.status == "ok"
    assert not result.inlier_mask[: int(outliers * 200)].sum() > 1
    assert result.inlier_mask[int(outliers * 200) :].all()
    turn, distance = errors(result, pose)
    assert turn < 0.05 and distance < 0.005
    assert abs(result.noise_rad / 1e-3 - 1) < 0.35


def test_a_wrong_guess_does_no_harm():
    pose, points, bearings = scene(1, outliers=0.4)
    wrong = Pose(rotation_from_vector([0, 3.0, 0]), [5.0, 0, 0]) @ pose
    found = fit_absolute_pose(bearings, points, guess=wrong)
    expected = fit_absolute_pose(bearings, points)
    np.testing.assert_allclose(
        found.cam_from_world.matrix(), expected.cam_from_world.matrix(), atol=1e-6
    )
    missing = fit_absolute_pose(bearings, points, guess=Pose.nan())
    np.testing.assert_array_equal(missing.cam_from_world.matrix(), expected.cam_from_world.matrix())


def test_turned_camera_turns_the_pose():
    pose, points, bearings = scene(2, outliers=0.3)
    turn = rotation_from_vector([1.0, 2.0, -0.5])
    before = fit_absolute_pose(bearings, points).cam_from_world
    after = fit_absolute_pose(bearings @ turn.T, points).cam_from_world
    np.testing.assert_allclose(after.rotation, turn @ before.rotation, atol=1e-6)
    np.testing.assert_allclose(after.translation, turn @ before.translation, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_world_that_is_turned_and_scaled_moves_the_pose(scale):
    pose, points, bearings = scene(3, outliers=0.3)
    turn = Pose(rotation_from_vector([1.0, 2.0, -0.5]), [3.0, 4.0, 5.0])
    before = fit_absolute_pose(bearings, points)
    after = fit_absolute_pose(bearings, scale * (points @ turn.rotation.T + turn.translation))
    expected = before.cam_from_world @ turn.inverse()
    np.testing.assert_allclose(after.cam_from_world.rotation, expected.rotation, atol=1e-6)
    np.testing.assert_allclose(
        after.cam_from_world.translation / scale, expected.translation, atol=1e-5
    )
    assert after.status == before.status


def test_order_of_the_points_does_not_matter():
    pose, points, bearings = scene(4, outliers=0.3)
    order = np.random.default_rng(0).permutation(200)
    found = fit_absolute_pose(bearings, points)
    again = fit_absolute_pose(bearings[order], points[order])
    np.testing.assert_array_equal(found.inlier_mask[order], again.inlier_mask)
    np.testing.assert_allclose(
        again.cam_from_world.matrix(), found.cam_from_world.matrix(), atol=1e-6
    )


def test_same_seed_gives_the_same_bits():
    _, points, bearings = scene(5, outliers=0.6)
    found, again = (fit_absolute_pose(bearings, points, seed=7) for _ in range(2))
    np.testing.assert_array_equal(found.cam_from_world.matrix(), again.cam_from_world.matrix())


def test_all_points_behind_is_no_special_case():
    rng = np.random.default_rng(6)
    points = points_around(rng, 100)
    points[:, 2] = -abs(points[:, 2]) - 1.0
    pose = Pose(rotation_from_vector([0.1, 0.0, 0.0]), [0.2, 0.1, 0.3])
    result = fit_absolute_pose(seen_from(pose, points), points)
    assert result.success and max(errors(result, pose)) < 1e-7


def test_mirrored_bearings_are_no_inliers():
    pose, points, bearings = scene(7)
    bearings[:50] *= -1.0
    result = fit_absolute_pose(bearings, points)
    assert not result.inlier_mask[:50].any() and result.inlier_mask[50:].all()
    assert result.residuals_rad[:50].min() > 3.1


def test_covariance_is_that_of_the_errors():
    squares = []
    for seed in range(200):
        pose, points, bearings = scene(seed, num_points=60, noise_rad=2e-3, outliers=0.2)
        result = fit_absolute_pose(bearings, points, guess=pose)
        turn = vector_from_rotation(pose.rotation @ result.cam_from_world.rotation.T)
        error = np.append(turn, pose.translation - result.cam_from_world.translation)
        squares.append(error @ np.linalg.solve(result.covariance, error))
    assert abs(np.mean(squares) / 6.0 - 1.0) < 0.2  # 0.04 is the standard error of 200


def test_gravity_helps_where_points_do_not():
    rng = np.random.default_rng(8)
    pose = random_pose(rng)
    inverse = pose.inverse()
    patch = directions(rng, 40) * 0.1 + np.array([0, 0, 5.0])
    points = patch @ inverse.rotation.T + inverse.translation
    bearings = noisy(rng, seen_from(pose, points), 1e-3)
    down = pose.rotation @ [0.0, 1.0, 0.0]
    alone = fit_absolute_pose(bearings, points, guess=pose)
    level = fit_absolute_pose(bearings, points, guess=pose, gravity=down, gravity_sigma_rad=1e-3)
    tilt = np.cross(down, [1.0, 0.0, 0.0])
    variances = [tilt @ r.covariance[:3, :3] @ tilt / (tilt @ tilt) for r in (alone, level)]
    assert variances[1] < 1.1e-6 < 0.01 * variances[0]
    assert np.degrees(np.arccos(down @ level.cam_from_world.rotation[:, 1])) < 0.2


@pytest.mark.parametrize("guessed", [True, False])
def test_a_small_patch_is_said_to_determine_nothing(guessed):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        pose = random_pose(rng)
        inverse = pose.inverse()
        patch = directions(rng, 100) * 0.05 + np.array([0, 0, 5.0])
        points = patch @ inverse.rotation.T + inverse.translation
        bearings = noisy(rng, seen_from(pose, points), 1e-3)
        result = fit_absolute_pose(bearings, points, guess=pose if guessed else None)
        assert result.status == "degenerate"
        assert (
            np.isfinite(result.covariance).all()
            and np.isfinite(result.cam_from_world.matrix()).all()
        )
        error = rotation_error_deg(result.cam_from_world, pose)
        assert np.degrees(np.sqrt(np.linalg.eigvalsh(result.covariance[:3, :3])[-1])) > 0.2 * error


def test_far_points_leave_the_translation_open_and_know_the_rotation():
    rng = np.random.default_rng(9)
    pose, points = random_pose(rng), 1e6 * directions(rng, 100)
    result = fit_absolute_pose(noisy(rng, seen_from(pose, points), 1e-3), points)
    assert rotation_error_deg(result.cam_from_world, pose) < 0.05
    sigmas = np.sqrt(np.diag(result.covariance))
    assert sigmas[:3].max() < 1e-3 and sigmas[3:].min() > 10.0


def test_points_on_a_line_are_degenerate():
    rng = np.random.default_rng(10)
    pose = random_pose(rng)
    points = np.outer(rng.uniform(-5, 5, 60), [1.0, 2.0, 0.5]) + [3.0, 0, 0]
    bearings = noisy(rng, seen_from(pose, points), 1e-3)
    assert fit_absolute_pose(bearings, points, guess=pose).status == "degenerate"


@pytest.mark.parametrize("num_points", [0, 1, 3, 9])
def test_few_points_give_nan_and_the_reason(num_points):
    pose, points, bearings = (
        scene(11, num_points=num_points) if num_points else (None, *np.zeros((2, 0, 3)))
    )
    for guess in (None, pose):
        result = fit_absolute_pose(bearings, points, guess=guess)
        assert result.status == "too_few_inliers" and not result.inlier_mask.any()
        assert (
            np.isnan(result.cam_from_world.matrix()[:3]).all() and np.isnan(result.covariance).all()
        )


def test_random_bearings_have_no_pose():
    rng = np.random.default_rng(12)
    for _ in range(5):
        result = fit_absolute_pose(directions(rng, 400), points_around(rng, 400))
        assert result.status == "too_few_inliers"


def test_missing_rows_are_not_inliers():
    pose, points, bearings = scene(13)
    bearings[3], points[5] = np.nan, np.nan
    result = fit_absolute_pose(bearings, points)
    assert result.success
    np.testing.assert_array_equal(np.flatnonzero(~result.inlier_mask), [3, 5])
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(result.residuals_rad)), [3, 5])


def test_a_point_in_the_centre_of_the_camera_is_no_inlier():
    _, points, _ = scene(15)
    shifted = np.vstack([points, [[0.0, 0.0, 0.0]]])
    pose = Pose(np.eye(3), np.zeros(3))
    seen = np.vstack([seen_from(pose, points), [[0.0, 0.0, 1.0]]])
    result = fit_absolute_pose(seen, shifted, guess=pose)
    assert result.success and not result.inlier_mask[-1] and np.isfinite(result.residuals_rad).all()


def test_one_point_many_times_is_degenerate():
    pose, points, bearings = scene(14)
    points[:], bearings[:] = points[0], bearings[0]
    assert fit_absolute_pose(bearings, points).status != "ok"
    assert fit_absolute_pose(bearings, points, guess=pose).status == "degenerate"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"threshold_rad": 0.0}, "threshold_rad must be between 0 and pi / 2, got 0.0"),
        ({"min_inliers": 3}, "min_inliers must be at least 4, got 3"),
        ({"gravity": np.zeros(3)}, "gravity must be a finite direction"),
        ({"gravity_sigma_rad": 0.0}, "gravity_sigma_rad must be positive"),
    ],
)
def test_wrong_options_are_named(options, message):
    _, points, bearings = scene(0)
    with pytest.raises(ValueError, match=re.escape(message)):
        fit_absolute_pose(bearings, points, **options)
    with pytest.raises(ValueError, match="points must have shape"):
        fit_absolute_pose(bearings, points[1:])
