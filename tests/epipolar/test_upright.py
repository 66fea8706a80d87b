# SPDX-License-Identifier: BSD-3-Clause
"""Three matches and gravity: the solver of the core, its twin and the truth agree."""

import numpy as np
import pytest
from exact_matches import any_pose

from epi360 import _core
from epi360.epipolar import essential_from_pose, upright_three_point
from epi360.poses import Pose, rotation_from_vector

SEEDS = range(30)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def upright_problem(seed):
    """Three exact matches of any two cameras and gravity, somewhere, in both."""
    rng = np.random.default_rng(seed)
    pose, points = any_pose(seed), rng.normal(size=(3, 3))
    gravity1 = unit(rng.normal(size=3))
    seen = points @ pose.rotation.T + pose.translation
    return unit(points), unit(seen), gravity1, pose.rotation @ gravity1, pose


def native(*problem):
    return [Pose(R, t) for R, t in _core.upright_three_point(*problem)]


def difference(a, b):
    """Largest difference of two poses whose directions have no sign."""
    direction = min(np.abs(a.translation - sign * b.translation).max() for sign in (1.0, -1.0))
    return max(np.abs(a.rotation - b.rotation).max(), direction)


def assert_same_set(found, expected, atol):
    assert len(found) == len(expected)
    for poses, others in ((found, expected), (expected, found)):
        assert all(min(difference(pose, other) for other in others) < atol for pose in poses)


def unit_translation(pose):
    return Pose(pose.rotation, unit(pose.translation))


# A heading is a root of a quartic, which loses digits where two roots nearly meet: worst 5e-11 over
# 2,000 seeds.
@pytest.mark.parametrize("solve", [upright_three_point, native])
def test_the_truth_is_among_the_poses(solve):
    for seed in SEEDS:
        *problem, pose = upright_problem(seed)
        found = solve(*problem)
        assert 1 <= len(found) <= 4
        assert min(difference(p, unit_translation(pose)) for p in found) < 1e-8


@pytest.mark.parametrize("solve", [upright_three_point, native])
def test_every_pose_fits_the_matches_and_turns_gravity_into_gravity(solve):
    for seed in SEEDS:
        b1, b2, gravity1, gravity2, _ = upright_problem(seed)
        found = solve(b1, b2, gravity1, gravity2)
        assert len(found) >= 1
        for pose in found:
            np.testing.assert_allclose(pose.rotation @ gravity1, gravity2, atol=1e-12)
            residuals = np.einsum("ij,jk,ik->i", b2, essential_from_pose(pose), b1)
            np.testing.assert_allclose(residuals, 0.0, atol=1e-10)


def test_the_core_equals_its_twin():
    for seed in range(300):
        *problem, _ = upright_problem(seed)
        assert_same_set(native(*problem), upright_three_point(*problem), atol=1e-7)


def test_the_core_equals_its_twin_on_matches_that_fit_no_pose():
    rng = np.random.default_rng(0)
    for _ in range(100):
        b1, b2 = unit(rng.normal(size=(2, 3, 3)))
        gravity1, gravity2 = unit(rng.normal(size=(2, 3)))
        problem = b1, b2, gravity1, gravity2
        assert_same_set(native(*problem), upright_three_point(*problem), atol=1e-7)


@pytest.mark.parametrize("solve", [upright_three_point, native])
def test_turning_a_camera_with_its_gravity_turns_the_poses(solve):
    for seed in SEEDS:
        b1, b2, gravity1, gravity2, _ = upright_problem(seed)
        R = rotation_from_vector(np.random.default_rng(seed).normal(size=3))
        before, turn = solve(b1, b2, gravity1, gravity2), Pose(R, np.zeros(3))
        second = solve(b1, b2 @ R.T, gravity1, R @ gravity2)
        assert_same_set(second, [turn @ pose for pose in before], atol=1e-7)
        first = solve(b1 @ R.T, b2, R @ gravity1, gravity2)
        assert_same_set(first, [pose @ turn.inverse() for pose in before], atol=1e-7)


@pytest.mark.parametrize("solve", [upright_three_point, native])
def test_swapping_the_views_inverts_the_poses(solve):
    for seed in SEEDS:
        b1, b2, gravity1, gravity2, _ = upright_problem(seed)
        backward = solve(b2, b1, gravity2, gravity1)
        forward = solve(b1, b2, gravity1, gravity2)
        assert_same_set(backward, [pose.inverse() for pose in forward], atol=1e-7)


@pytest.mark.parametrize("solve", [upright_three_point, native])
@pytest.mark.parametrize("down", [1.0, -1.0])
def test_gravity_along_the_y_axis_is_nothing_special(solve, down):
    gravity = np.array([0.0, down, 0.0])
    truth = Pose(rotation_from_vector([0.0, 0.4, 0.0]), [0.6, 0.0, 0.8])
    points = np.random.default_rng(1).normal(size=(3, 3))
    seen = points @ truth.rotation.T + truth.translation
    found = solve(unit(points), unit(seen), gravity, gravity)
    assert min(difference(pose, truth) for pose in found) < 1e-9


@pytest.mark.parametrize("angle_deg", [179.0, 179.99, 180.0])
def test_the_twin_knows_half_turns(angle_deg):
    truth = Pose(rotation_from_vector([0.0, np.radians(angle_deg), 0.0]), [0.6, 0.0, 0.8])
    points = np.random.default_rng(2).normal(size=(3, 3))
    seen = points @ truth.rotation.T + truth.translation
    down = np.array([0.0, 1.0, 0.0])
    found = upright_three_point(points, seen, down, down)
    assert min(difference(pose, truth) for pose in found) < 1e-9


@pytest.mark.parametrize("solve", [upright_three_point, native])
def test_a_rotation_alone_leaves_the_direction_open_but_gives_no_nonsense(solve):
    b1, _, gravity1, gravity2, pose = upright_problem(3)
    poses = solve(b1, b1 @ pose.rotation.T, gravity1, gravity2)
    assert len(poses) >= 1
    for found in poses:
        assert np.isfinite(found.matrix()).all()
        np.testing.assert_allclose(found.rotation @ gravity1, gravity2, atol=1e-12)


def test_lengths_do_not_matter():
    b1, b2, gravity1, gravity2, _ = upright_problem(4)
    expected = upright_three_point(b1, b2, gravity1, gravity2)
    found = upright_three_point(3.0 * b1, 0.1 * b2, 9.81 * gravity1, 1e-200 * gravity2)
    assert_same_set(found, expected, atol=1e-9)


def test_a_missing_bearing_gives_no_pose():
    b1, b2, gravity1, gravity2, _ = upright_problem(5)
    b1[1, 2] = np.nan
    assert upright_three_point(b1, b2, gravity1, gravity2) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gravity1": np.zeros(3)}, r"gravity1 must be a finite direction, got \[0.0, 0.0, 0.0\]"),
        ({"gravity2": [0.0, np.inf, 0.0]}, "gravity2 must be a finite direction"),
        ({"gravity2": [0.0, np.nan, 0.0]}, "gravity2 must be a finite direction"),
        ({"gravity1": np.ones((1, 3))}, r"gravity1 must have shape \(3,\), got \(1, 3\)"),
        ({"bearings2": np.ones((2, 3))}, "must have the same length, got 3 and 2"),
    ],
)
def test_wrong_input_is_refused_by_name(change, message):
    names = "bearings1", "bearings2", "gravity1", "gravity2"
    arguments = dict(zip(names, upright_problem(6)[:4], strict=True)) | change
    with pytest.raises(ValueError, match=message):
        upright_three_point(**arguments)


def test_four_matches_are_too_many():
    b = np.eye(4)[:, :3] + 0.1
    with pytest.raises(ValueError, match="needs 3 matches, got 4"):
        upright_three_point(b, b, [0, 1, 0], [0, 1, 0])
