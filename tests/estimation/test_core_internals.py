# SPDX-License-Identifier: BSD-3-Clause
"""Sampler, stopping rule, evidence, plane and rotation of the core, each by itself."""

from math import comb, log10

import numpy as np
import pytest
from noisy_problems import random_directions

from epi360 import _core
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector
from epi360.synthetic import two_view_scene

internals = _core.internals


def pose_of(seed):
    rng = np.random.default_rng(seed)
    t = rng.normal(size=3)
    return Pose(rotation_from_vector(rng.normal(size=3)), t / np.linalg.norm(t))


# Sampler


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("size", [2, 3, 5, 8])
def test_a_sample_has_distinct_matches(size, progressive):
    samples = np.array(internals.draw(size + 2, size, progressive, 300, seed=1))
    assert samples.max() < size + 2
    assert all(len(set(sample)) == size for sample in samples)


def test_without_scores_every_match_is_drawn_as_often():
    counts = np.bincount(np.ravel(internals.draw(20, 5, False, 20000, seed=2)), minlength=20)
    expected = 20000 * 5 / 20
    chi_squared = ((counts - expected) ** 2 / expected).sum()
    assert chi_squared < 43.8  # 99.9 % of 19 degrees of freedom


def test_with_scores_half_of_the_first_samples_come_from_the_best_matches():
    samples = np.array(internals.draw(1000, 5, True, 20, seed=3))
    ordered, uniform = samples[::2].max(axis=1), samples[1::2].max(axis=1)
    if np.median(uniform) < np.median(ordered):
        ordered, uniform = uniform, ordered
    assert (ordered < 30).all()
    assert np.median(uniform) > 500
    assert (np.diff(ordered) >= 0).all()  # the part that they come from grows


def test_in_the_end_samples_with_scores_come_from_all_matches():
    samples = np.array(internals.draw(100, 5, True, 60000, seed=4))[40000:]
    counts = np.bincount(samples.ravel(), minlength=100)
    assert counts.min() > 0.9 * counts.mean() and counts.max() < 1.1 * counts.mean()


def test_a_seed_fixes_the_samples():
    assert internals.draw(50, 5, True, 50, seed=9) == internals.draw(50, 5, True, 50, seed=9)
    assert internals.draw(50, 5, True, 50, seed=9) != internals.draw(50, 5, True, 50, seed=10)


# Stopping rule


@pytest.mark.parametrize("ratio", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("size", [2, 5, 8])
@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_after_the_iterations_needed_an_inlier_sample_was_drawn(ratio, size, confidence):
    needed = internals.iterations_needed(ratio, size, confidence=confidence)
    missed = 1.0 - ratio**size
    assert missed**needed <= (1.0 - confidence) * (1.0 + 1e-9) < missed ** (needed - 1) * (1 + 1e-6)


def test_the_iterations_needed_stay_within_their_limits():
    limits = {"min_iterations": 20, "max_iterations": 500}
    assert internals.iterations_needed(1.0, 5, **limits) == 20
    assert internals.iterations_needed(0.9, 5, **limits) == 20
    assert internals.iterations_needed(0.1, 5, **limits) == 500
    assert internals.iterations_needed(0.0, 5, **limits) == 500


def test_the_loop_draws_as_many_samples_as_its_stopping_rule_asks_for():
    needed = internals.iterations_needed(0.02, 1, confidence=0.99)
    model, score, num_samples = internals.run_loop(1000, 0.02, 5, 10000, 0.99, seed=1)
    assert num_samples == needed == 228
    smallest = min(sample[0] for sample in internals.draw(1000, 1, False, needed, seed=1))
    assert model == score == smallest - 0.5  # the best sample, refined


def test_the_loop_ends_at_the_most_iterations_where_nothing_agrees():
    assert internals.run_loop(1000, 0.0, 5, 321, 0.99, seed=1)[2] == 321


# Evidence


@pytest.mark.parametrize(
    ("matches", "inliers", "p"), [(20, 10, 0.1), (200, 40, 0.3), (50, 50, 0.5)]
)
def test_false_alarms_count_the_poses_that_chance_would_make(matches, inliers, p):
    expected = (
        log10(10 * (matches - 5))
        + log10(comb(matches, inliers))
        + log10(comb(inliers, 5))
        + (inliers - 5) * log10(p)
    )
    assert internals.log10_false_alarms(matches, inliers, p, 5) == pytest.approx(expected)


def test_a_sample_alone_is_no_evidence():
    assert internals.log10_false_alarms(100, 5, 1e-9, 5) > 0.0
    assert internals.log10_false_alarms(100, 0, 1e-9, 5) > 0.0


def test_matches_from_everywhere_agree_by_chance_as_residuals_on_the_sphere_are_distributed():
    b1, b2 = random_directions(1, 3000), random_directions(2, 3000)
    pose = pose_of(3)
    residuals, _ = _core.residuals(b1, b2, pose.rotation, pose.translation, "sampson")
    front = np.mean([_in_front(pose, x, y) for x, y in zip(b1, b2, strict=True)])
    expected = np.mean(np.abs(residuals) < 0.05) / 0.1 * front
    density = internals.chance_density(
        b1, b2, pose.rotation, pose.translation, "sampson", range=0.05, seed=1
    )
    assert density == pytest.approx(expected, rel=0.5)


def _in_front(pose, b1, b2):
    a = pose.rotation @ b1
    c, ta, tb = a @ b2, a @ pose.translation, b2 @ pose.translation
    return c * tb - ta > 0.0 and tb - c * ta > 0.0


def test_chance_does_not_see_what_the_matches_say():
    scene = two_view_scene(4, num_matches=500)  # without noise: every residual is zero
    pose = scene.cam2_from_cam1
    t = pose.translation / np.linalg.norm(pose.translation)
    density = internals.chance_density(
        scene.bearings1, scene.bearings2, pose.rotation, t, "sampson", range=0.02, seed=1
    )
    assert density < 2.0  # all of them would give 25


def bearings_within(seed, half_angle_deg, n=4000):
    rng = np.random.default_rng(seed)
    cosine = rng.uniform(np.cos(np.radians(half_angle_deg)), 1.0, n)
    sine, around = np.sqrt(1.0 - cosine**2), rng.uniform(0.0, 2.0 * np.pi, n)
    return np.stack([sine * np.cos(around), sine * np.sin(around), cosine], axis=1)


@pytest.mark.parametrize("half_angle_deg", [5.0, 15.0, 30.0, 45.0])
def test_wrong_matches_of_a_narrow_view_are_as_dense_as_points_beside_curves_through_others(
    half_angle_deg,
):
    wrong, right = bearings_within(1, half_angle_deg), bearings_within(2, half_angle_deg)
    other = random_directions(3, len(right))
    normals = np.cross(right, other)  # of great circles through one point in any direction
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = 0.05 * np.radians(half_angle_deg)
    expected = np.mean(np.abs(np.sum(normals * wrong, axis=1)) < near) / (2.0 * near)
    density = internals.density_in_view(right, wrong)
    assert density == pytest.approx(expected, rel=0.12)
    # Residuals of wrong matches in front, as they are counted under a pose; poses differ.
    counted = [
        internals.chance_density(right, wrong, np.eye(3), t, "sampson", near, 1) for t in np.eye(3)
    ]
    assert np.mean(counted) == pytest.approx(density, rel=0.4)


def test_the_wider_of_two_views_tells_how_far_wrong_matches_lie():
    around, narrow = random_directions(1, 2000), bearings_within(2, 20.0)[:2000]
    all_around = internals.density_in_view(around, around)
    assert all_around == 0.35
    assert internals.density_in_view(around, narrow) == all_around
    assert internals.density_in_view(narrow, around) == all_around
    assert internals.density_in_view(narrow, narrow) > 4.0 * all_around
    hemisphere, less = bearings_within(3, 90.0), bearings_within(4, 80.0)
    assert internals.density_in_view(hemisphere, hemisphere) == pytest.approx(all_around, rel=0.02)
    assert internals.density_in_view(less, less) > 1.05 * all_around
    one = np.tile([0.0, 0.0, 1.0], (5, 1))
    assert np.isfinite(internals.density_in_view(one, one))


def test_a_wrong_match_agrees_with_a_rotation_as_often_as_a_cap_is_large():
    b1, b2 = random_directions(1, 2000), random_directions(2, 2000)
    gate = np.radians(20.0)
    angle = np.sqrt(2.0) * gate  # a rotation's residual is the angle over sqrt 2
    expected = (1.0 - np.cos(angle)) / 2.0
    assert internals.rotation_chance(b1, b2, np.eye(3), gate, 1) == pytest.approx(expected, rel=0.4)


# Plane


def points_on_plane(seed, normal):
    """Points with n . X = 1."""
    rays = random_directions(seed, 400)
    rays = rays[rays @ normal > 0.3 * np.linalg.norm(normal)]
    return rays / (rays @ normal)[:, None]


def bearings_of(points, pose):
    moved = points @ pose.rotation.T + pose.translation
    return (
        points / np.linalg.norm(points, axis=1)[:, None],
        moved / np.linalg.norm(moved, axis=1)[:, None],
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_plane_of_points_on_a_plane_is_found(seed):
    normal, pose = np.array([0.2, -0.3, 0.4]), pose_of(seed)
    b1, b2 = bearings_of(points_on_plane(seed, normal), pose)
    found, share = internals.fit_plane(b1, b2, pose.rotation, pose.translation, gate=0.002)
    np.testing.assert_allclose(found, normal, rtol=0, atol=1e-6)
    assert share == 1.0


def test_points_in_all_directions_and_ranges_are_no_plane():
    scene = two_view_scene(6, layout="sphere", num_matches=300)
    pose = scene.cam2_from_cam1
    t = pose.translation / np.linalg.norm(pose.translation)
    _, share = internals.fit_plane(scene.bearings1, scene.bearings2, pose.rotation, t, gate=0.002)
    assert share < 0.5


@pytest.mark.parametrize("seed", range(8))
def test_the_twin_pose_has_the_same_homography_and_the_pose_as_its_own_twin(seed):
    normal, pose = np.array([0.2, -0.3, 0.4]), pose_of(seed)
    R, t = internals.twin_pose(pose.rotation, pose.translation, normal)
    twin = Pose(R, t)
    assert rotation_error_deg(twin, pose) > 0.1
    b1, b2 = bearings_of(points_on_plane(seed, normal), pose)
    residuals, _ = _core.residuals(b1, b2, R, t, "angular")
    np.testing.assert_allclose(residuals, 0.0, atol=1e-9)
    twin_normal, share = internals.fit_plane(b1, b2, R, t, gate=0.002)
    if share == 1.0:  # the twin sees the plane in front of both cameras
        back = Pose(*internals.twin_pose(R, t, twin_normal))
        assert rotation_error_deg(back, pose) < 1e-4


def test_a_plane_across_the_translation_has_no_twin():
    t = np.array([0.0, 0.0, 1.0])
    assert internals.twin_pose(np.eye(3), t, 0.5 * t) is None


# Rotation


@pytest.mark.parametrize("seed", range(5))
def test_alignment_of_turned_bearings_is_the_turn(seed):
    b1, R = random_directions(seed, 30), pose_of(seed).rotation
    found = internals.align_rotations(b1, b1 @ R.T, np.ones(30))
    np.testing.assert_allclose(found, R, atol=1e-12)


def test_alignment_is_the_rotation_of_least_squares():
    rng = np.random.default_rng(8)
    b1, R = random_directions(8, 50), pose_of(8).rotation
    b2 = b1 @ R.T + 0.05 * rng.normal(size=(50, 3))
    b2 /= np.linalg.norm(b2, axis=1)[:, None]
    weights = rng.uniform(0.1, 2.0, 50)
    found = internals.align_rotations(b1, b2, weights)
    U, _, Vt = np.linalg.svd((weights[:, None] * b2).T @ b1)  # Wahba's problem by an SVD
    best = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    np.testing.assert_allclose(found, best, atol=1e-9)


def test_a_match_of_weight_zero_does_not_turn_the_alignment():
    b1, R = random_directions(9, 20), pose_of(9).rotation
    b2 = b1 @ R.T
    b2[0] = -b2[0]
    weights = np.ones(20)
    weights[0] = 0.0
    np.testing.assert_allclose(internals.align_rotations(b1, b2, weights), R, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_best_rotation_explains_the_matches_that_turned(seed):
    b1, R = random_directions(seed, 100), pose_of(seed).rotation
    b2 = b1 @ R.T
    b2[:40] = random_directions(100 + seed, 40)
    found, residuals, support = internals.best_rotation(b1, b2, gate=0.01, seed=seed)
    np.testing.assert_allclose(found, R, atol=1e-9)
    assert 60 <= support <= 62 and support == np.count_nonzero(residuals < 0.01)
    angles = np.arccos(np.clip(np.einsum("ij,ij->i", b1 @ found.T, b2), -1.0, 1.0))
    np.testing.assert_allclose(residuals[:40], angles[:40] / np.sqrt(2.0), atol=1e-7)
