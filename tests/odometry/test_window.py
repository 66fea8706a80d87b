# SPDX-License-Identifier: BSD-3-Clause
import re
from dataclasses import replace

import numpy as np
import pytest
from seen_points import (
    directions,
    noisy,
    points_around,
    random_pose,
    seen_from,
    walk,
    window,
    worst_center_error,
)

from epi360.odometry.window import WindowProblem, _checked, _observations, adjust_window
from epi360.odometry.window_reference import (
    _moved,
    adjust_reference,
    bearing_residuals,
    cost_of,
    normal_equations,
)
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector

EXACT = {"max_iterations": 100, "tolerance": 1e-13}


def reference(problem, loss, max_iterations, tolerance=1e-12):
    start = _observations(*_checked(problem, False))
    return adjust_reference(start, loss, 2.0, max_iterations, tolerance)


@pytest.mark.parametrize("offset", [1e-9, 1e-6, 1e-4, 1e-2, 0.5, 1.5])
def test_derivatives_by_the_point_are_finite_differences(offset):
    rng = np.random.default_rng(3)
    bearings = directions(rng, 200)
    points = 3.0 * (bearings + offset * directions(rng, 200))
    ahead = np.einsum("ni,ni->n", bearings, points) > 0.05
    bearings, points = bearings[ahead], points[ahead]
    _, jacobians = bearing_residuals(bearings, points)
    h = 1e-5
    for k, axis in enumerate(np.eye(3)):
        after, before = (bearing_residuals(bearings, points + s * h * axis)[0] for s in (1, -1))
        np.testing.assert_allclose(jacobians[:, :, k], (after - before) / (2 * h), atol=1e-8)


def test_residual_is_as_long_as_the_angle():
    rng = np.random.default_rng(0)
    for angle in (0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi):
        tangent = np.array([[0.0, np.sin(angle), np.cos(angle)]])
        turn = random_pose(rng).rotation
        residuals, _ = bearing_residuals(np.array([[0.0, 0.0, 1.0]]) @ turn.T, 2 * tangent @ turn.T)
        np.testing.assert_allclose(np.linalg.norm(residuals), angle, atol=1e-15, rtol=1e-12)


def test_gradient_of_the_twin_is_the_slope_of_its_cost():
    problem, _, _ = window(1, num_points=10)
    problem = replace(problem, gravity=problem.rotations[:, :, 1], fixed=np.arange(6) < 1)
    start = _observations(*_checked(problem, False))
    _, gradient = normal_equations(start, "cauchy", 2.0)
    for k in range(0, len(gradient), 7):
        step = np.zeros(len(gradient))
        step[k] = 1e-6
        after, before = (cost_of(_moved(start, s * step), "cauchy", 2.0) for s in (1, -1))
        # The cost is a sum of squares: its slope is twice J^T r.
        np.testing.assert_allclose(2 * gradient[k], (after - before) / 2e-6, rtol=1e-5, atol=1e-2)


@pytest.mark.parametrize("loss", ["squared", "huber", "cauchy"])
@pytest.mark.parametrize("seed", range(4))
def test_core_takes_the_steps_of_its_twin(seed, loss):
    # A wrong bearing leads least squares astray, where it magnifies roundings.
    problem, _, _ = window(seed, num_points=40, outliers=0.0 if loss == "squared" else 0.05)
    if seed % 2:
        problem = replace(problem, gravity=problem.rotations[:, :, 1], gravity_sigma_rad=0.01)
    for max_iterations in (1, 2, 50):
        twin, cost, num_iterations, _ = reference(problem, loss, max_iterations)
        found = adjust_window(problem, loss=loss, max_iterations=max_iterations, tolerance=1e-12)
        np.testing.assert_allclose(found.cost, cost, rtol=1e-9)
        np.testing.assert_allclose(found.rotations, twin.rotations, atol=1e-6)
        np.testing.assert_allclose(found.translations, twin.translations, atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_exact_bearings_give_the_exact_world(seed):
    problem, poses, points = window(seed, noise_rad=0.0)
    found = adjust_window(problem, **EXACT)
    assert worst_center_error(found, poses) < 1e-7
    np.testing.assert_allclose(found.points, points, atol=1e-6)


def test_errors_are_those_of_the_noise():
    squares, errors = [], []
    for seed in range(10):
        problem, poses, _ = window(seed, num_points=100)
        found = adjust_window(problem, loss="squared", **EXACT)
        freedom = 2 * len(problem.bearings) - 6 * 4 - 3 * 100
        squares.append(found.cost / freedom)
        errors.append(worst_center_error(found, poses))
    assert abs(np.mean(squares) - 1.0) < 0.05
    assert max(errors) < 0.01  # of a path of 1.5


def test_fixed_frames_and_points_seen_once_stay():
    problem, _, _ = window(0)
    lonely = len(problem.points)
    problem = replace(
        problem,
        points=np.vstack([problem.points, [[1.0, 2.0, 3.0]], [[5.0, 5.0, 5.0]]]),
        frame_index=np.append(problem.frame_index, 3),
        point_index=np.append(problem.point_index, lonely),
        bearings=np.vstack([problem.bearings, [[0.0, 0.0, 1.0]]]),
    )
    found = adjust_window(problem)
    np.testing.assert_array_equal(found.rotations[:2], problem.rotations[:2])
    np.testing.assert_array_equal(found.translations[:2], problem.translations[:2])
    np.testing.assert_array_equal(found.points[lonely:], problem.points[lonely:])
    assert np.isfinite(found.residuals_rad).all()


def test_fixed_points_stay_and_place_the_frames():
    problem, poses, points = window(2, noise_rad=0.0)
    problem = replace(problem, points=points, fixed=np.arange(6) < 1)
    found = adjust_window(problem, points_fixed=True, **EXACT)
    np.testing.assert_array_equal(found.points, points)
    assert worst_center_error(found, poses) < 1e-7


def test_order_of_the_observations_does_not_matter():
    problem, _, _ = window(4, outliers=0.1)
    order = np.random.default_rng(0).permutation(len(problem.bearings))
    mixed = replace(
        problem,
        frame_index=problem.frame_index[order],
        point_index=problem.point_index[order],
        bearings=problem.bearings[order],
    )
    found, again = adjust_window(problem), adjust_window(mixed)
    np.testing.assert_array_equal(found.points, again.points)
    np.testing.assert_array_equal(found.residuals_rad[order], again.residuals_rad)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_world_that_is_turned_shifted_and_scaled_gives_the_same(scale):
    problem, _, _ = window(5, outliers=0.1)
    turn = Pose(rotation_from_vector([0.3, -2.0, 1.0]), [30.0, -20.0, 10.0])
    rotations = problem.rotations @ turn.rotation.T
    translations = scale * problem.translations - rotations @ turn.translation
    points = scale * problem.points @ turn.rotation.T + turn.translation
    moved = replace(problem, rotations=rotations, translations=translations, points=points)
    found, again = adjust_window(problem, **EXACT), adjust_window(moved, **EXACT)
    np.testing.assert_allclose(again.cost, found.cost, rtol=1e-9)
    np.testing.assert_allclose(again.rotations, found.rotations @ turn.rotation.T, atol=1e-8)
    expected = found.points @ turn.rotation.T + turn.translation / scale
    np.testing.assert_allclose(again.points / scale, expected, atol=1e-6)


def test_one_fixed_frame_keeps_the_length_of_the_path():
    problem, poses, _ = window(6, num_fixed=1)
    found = adjust_window(problem, **EXACT)
    centers = [pose.inverse().translation for pose in found.cam_from_world]
    start = [-R.T @ t for R, t in zip(problem.rotations, problem.translations, strict=True)]
    distances = np.linalg.norm(np.array(start) - start[0], axis=1)
    far = distances.argmax()
    np.testing.assert_allclose(np.linalg.norm(centers[far] - centers[0]), distances[far])
    again = adjust_window(
        replace(
            problem, rotations=found.rotations, translations=found.translations, points=found.points
        )
    )
    np.testing.assert_allclose(again.cost, found.cost, rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_tenth_of_wrong_bearings_does_little(seed):
    problem, poses, _ = window(seed, num_points=150, outliers=0.1)
    found = adjust_window(problem, max_iterations=50)
    assert worst_center_error(found, poses) < 0.01


def test_points_behind_the_cameras_are_like_others():
    problem, poses, points = window(7, noise_rad=0.0)
    assert (points[:, 2] < 0).sum() > 10
    np.testing.assert_allclose(adjust_window(problem, **EXACT).points, points, atol=1e-6)


def test_points_at_infinity_stay_finite_and_turn_the_frames_right():
    rng = np.random.default_rng(8)
    problem, poses, points = window(8)
    far = directions(rng, 40)
    frames, tracks = np.repeat(np.arange(6), 40), len(points) + np.tile(np.arange(40), 6)
    bearings = np.vstack([noisy(rng, far @ pose.rotation.T, 1e-3) for pose in poses])
    problem = replace(
        problem,
        points=np.vstack([problem.points, 20.0 * far]),
        frame_index=np.append(problem.frame_index, frames),
        point_index=np.append(problem.point_index, tracks),
        bearings=np.vstack([problem.bearings, bearings]),
    )
    found = adjust_window(problem, max_iterations=50)
    assert np.isfinite(found.points).all()
    towards = found.points[len(points) :]
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    assert np.linalg.norm(found.points[len(points) :], axis=1).min() > 100.0
    assert np.arccos(np.einsum("ni,ni->n", towards, far)).max() < 5e-3
    for pose, true in zip(found.cam_from_world, poses, strict=True):
        assert rotation_error_deg(pose, true) < 0.05


def test_turning_on_the_spot_keeps_the_points():
    rng = np.random.default_rng(9)
    points = points_around(rng, 80)
    place = walk(rng, 2)
    poses = [
        *place,
        *(Pose(rotation_from_vector([0, 0.3 * k, 0]), [0, 0, 0]) @ place[1] for k in range(1, 7)),
    ]
    bearings = np.vstack([noisy(rng, seen_from(pose, points), 1e-3) for pose in poses])
    problem = problem_of(poses, points, bearings)
    before = adjust_window(replace(problem, **only(problem, 2)), **EXACT)
    after = adjust_window(problem, **EXACT)
    before_error, after_error = (
        np.median(np.linalg.norm(found.points - points, axis=1)) for found in (before, after)
    )
    assert after_error < before_error


def test_exact_turns_alone_change_no_point():
    rng = np.random.default_rng(9)
    points, place = points_around(rng, 80), random_pose(rng)
    poses = [Pose(rotation_from_vector([0, 0.3 * k, 0]), [0, 0, 0]) @ place for k in range(6)]
    problem = problem_of(poses, points, np.vstack([seen_from(pose, points) for pose in poses]))
    found = adjust_window(replace(problem, fixed=np.arange(6) < 1), **EXACT)
    np.testing.assert_allclose(found.points, points, atol=1e-6)


def only(problem, num_frames):
    keep = problem.frame_index < num_frames
    return {
        name: getattr(problem, name)[keep] for name in ("frame_index", "point_index", "bearings")
    }


def problem_of(poses, points, bearings):
    """Every frame sees every point; the first two are fixed."""
    F, P = len(poses), len(points)
    rotations = np.stack([pose.rotation for pose in poses])
    translations = np.stack([pose.translation for pose in poses])
    frames, tracks = np.repeat(np.arange(F), P), np.tile(np.arange(P), F)
    return WindowProblem(
        rotations, translations, points, frames, tracks, bearings, 1e-3, np.arange(F) < 2
    )


def test_a_point_in_the_centre_of_a_camera_gives_no_nan():
    problem, _, _ = window(10)
    points = problem.points.copy()
    points[0] = -problem.rotations[3].T @ problem.translations[3]
    found = adjust_window(replace(problem, points=points), max_iterations=50)
    assert np.isfinite(found.points).all() and np.isfinite(found.translations).all()


def test_missing_numbers_stay_missing_and_harm_nothing():
    problem, _, _ = window(11)
    expected = adjust_window(replace(problem, **{
        name: getattr(problem, name)[(problem.frame_index != 4) & (problem.point_index != 7)]
        for name in ("frame_index", "point_index", "bearings")
    }))  # fmt: skip
    rotations, points = problem.rotations.copy(), problem.points.copy()
    rotations[4], points[7] = np.nan, np.nan
    bearings = np.vstack([problem.bearings, [[np.nan] * 3]])
    found = adjust_window(replace(
        problem, rotations=rotations, points=points, bearings=bearings,
        frame_index=np.append(problem.frame_index, 3),
        point_index=np.append(problem.point_index, 9),
    ))  # fmt: skip
    np.testing.assert_allclose(found.cost, expected.cost, rtol=1e-12)
    assert np.isnan(found.rotations[4]).all() and np.isnan(found.points[7]).all()
    missing = np.append((problem.frame_index == 4) | (problem.point_index == 7), True)
    np.testing.assert_array_equal(np.isnan(found.residuals_rad), missing)


def test_gravity_levels_what_points_leave_open():
    problem, _, _ = window(12, num_fixed=1)
    gravity = problem.rotations[:, :, 1] @ rotation_from_vector([0.3, -0.2, 0.1])
    found = adjust_window(replace(problem, **only(problem, 0), gravity=gravity), **EXACT)
    np.testing.assert_allclose(found.rotations[1:, :, 1], gravity[1:], atol=1e-6)


def test_nothing_to_adjust_is_an_answer():
    problem, _, _ = window(0)
    found = adjust_window(replace(problem, **only(problem, 0)))
    assert found.converged and found.cost == 0.0 and len(found.residuals_rad) == 0
    np.testing.assert_array_equal(found.points, problem.points)
    all_fixed = adjust_window(replace(problem, fixed=np.ones(6, dtype=bool)))
    assert all_fixed.cost > 0.0 and (all_fixed.points != problem.points).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fixed": np.zeros(6, dtype=bool)}, "at least one frame must be fixed"),
        ({"fixed": np.ones(5, dtype=bool)}, "fixed must have shape (6,), got (5,)"),
        ({"points": np.zeros((3, 2))}, "points must have shape (N, 3), got (3, 2)"),
        ({"points": np.full((60, 3), np.inf)}, "points must be finite"),
        ({"noise_rad": 0.0}, "noise_rad must be positive"),
        ({"gravity": np.zeros((2, 3))}, "gravity"),
    ],
)
def test_wrong_input_is_named(change, message):
    problem, _, _ = window(0)
    with pytest.raises(ValueError, match=re.escape(message)):
        adjust_window(replace(problem, **change))


def test_index_beyond_the_points_is_named():
    problem, _, _ = window(0)
    with pytest.raises(ValueError, match="point_index must hold whole numbers from 0 to 59"):
        adjust_window(replace(problem, point_index=problem.point_index + 1))
