# SPDX-License-Identifier: BSD-3-Clause
"""Pose in a map from bearings and points: laws, random and repeated matches, sigmas."""

import re

import numpy as np
import pytest
from seen_points import directions, noisy, points_around, random_pose, scene, seen_from

from epi360 import estimate_absolute_pose
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, vector_from_rotation


def scaled_error(result, pose):
    """Error of the six parameters in units of the covariance, squared and over six."""
    turn = vector_from_rotation(pose.rotation @ result.cam_from_world.rotation.T)
    error = np.append(turn, pose.translation - result.cam_from_world.translation)
    return error @ np.linalg.solve(result.covariance, error) / 6.0


@pytest.mark.parametrize("seed", range(5))
def test_exact_bearings_give_the_exact_pose(seed):
    pose, points, bearings = scene(seed, noise_rad=0.0)
    result = estimate_absolute_pose(3.0 * bearings, points)
    assert result.success and result.inlier_mask.all() and result.probability > 0.99
    np.testing.assert_allclose(result.cam_from_world.matrix(), pose.matrix(), atol=1e-6)


@pytest.mark.parametrize(
    ("num_points", "outliers", "noise_rad"),
    [(200, 0.0, 1e-3), (200, 0.5, 1e-3), (60, 0.2, 2e-3), (40, 0.3, 5e-3), (600, 0.7, 3e-4)],
)
def test_sigmas_cover_the_errors(num_points, outliers, noise_rad):
    squares, centers, noise = [], [], []
    num_trials = 60 if outliers < 0.7 else 40  # which take four times as long
    for seed in range(num_trials):
        pose, points, bearings = scene(seed, num_points, noise_rad, outliers)
        result = estimate_absolute_pose(bearings, points)
        if not result.success:
            continue
        squares.append(scaled_error(result, pose))
        away = pose.inverse().translation - result.cam_from_world.inverse().translation
        centers.append(away @ np.linalg.solve(result.center_covariance, away) / 3.0)
        noise.append(np.radians(result.noise_deg))
    assert len(squares) >= 0.95 * num_trials
    # The standard errors of these means are about 0.1; the median of the noise is theirs.
    assert 0.75 < np.mean(squares) < 1.4 and 0.65 < np.mean(centers) < 1.5
    assert abs(np.median(noise) / noise_rad - 1.0) < 0.15


def test_uncertain_points_count_less_and_the_sigmas_know_it():
    squares, plain = [], []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        pose, points, bearings = scene(seed, 120, 5e-4)
        # Badly known along the ray from the origin, as points of little parallax are.
        away = points / np.linalg.norm(points, axis=1, keepdims=True)
        sigma = np.where(rng.random(120) < 0.5, 0.6, 0.01)
        seen = points + sigma[:, None] * rng.normal(size=(120, 1)) * away
        covariances = sigma[:, None, None] ** 2 * away[:, :, None] * away[:, None, :]
        known = estimate_absolute_pose(bearings, seen, point_covariances=covariances)
        blind = estimate_absolute_pose(bearings, seen)
        assert known.success
        squares.append(scaled_error(known, pose))
        errors = [
            np.linalg.norm(each.cam_from_world.translation - pose.translation)
            for each in (known, blind)
            if each.success
        ]
        plain.append(errors)
    assert 0.7 < np.mean(squares) < 1.5
    both = np.array([errors for errors in plain if len(errors) == 2])
    assert np.median(both[:, 0]) < 0.9 * np.median(both[:, 1])


def test_shared_error_widens_the_covariance_to_what_it_does():
    """Stitching moves neighbouring bearings together, which more matches do not average out."""
    squares, naive = [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        pose, points, bearings = scene(seed, 400, 5e-4)
        # A smooth field over the sphere, of about the same size as the noise.
        waves = rng.normal(size=(3, 3)) * 8e-4
        bearings = bearings + np.sin(1.5 * bearings @ rng.normal(size=(3, 3))) @ waves
        results = [estimate_absolute_pose(bearings, points, shared_error=s) for s in (1.0, 0.0)]
        squares.append(scaled_error(results[0], pose))
        naive.append(scaled_error(results[1], pose))
    assert np.mean(naive) > 10.0 and np.mean(squares) < 3.0


@pytest.mark.parametrize("num_points", [12, 18, 40])
def test_few_bearings_may_be_wrong_together_too(num_points):
    """Too few to show what they share; so the least is assumed, and fewer are never surer."""
    pose, points, bearings = scene(0, num_points, 5e-4)
    shared, independent = (
        estimate_absolute_pose(bearings, points, shared_error=s) for s in (1.0, 0.0)
    )
    assert shared.success
    wider = np.linalg.eigvalsh(shared.covariance - independent.covariance)
    assert wider.min() > 0.0
    assert np.trace(shared.covariance) > 2.0 * np.trace(independent.covariance)


@pytest.mark.parametrize("num_points", [20, 60, 300, 1500])
def test_random_matches_are_never_accepted(num_points):
    for seed in range(25):
        rng = np.random.default_rng(seed)
        bearings, points = directions(rng, num_points), points_around(rng, num_points)
        if seed % 3 == 1:  # in clusters, as features on a few objects are
            bearings = noisy(rng, bearings[rng.integers(0, 5, num_points)], 0.05)
        if seed % 3 == 2:
            points = points[rng.integers(0, 5, num_points)] + 0.2 * rng.normal(size=points.shape)
        result = estimate_absolute_pose(bearings, points, seed=seed)
        assert not result.success and result.probability < 0.5
        assert np.isnan(result.cam_from_world.matrix()[:3]).all()


def test_a_poster_that_hangs_elsewhere_is_no_place():
    """Forty right matches of one object that was moved, among random ones."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        pose = random_pose(rng)
        poster = pose.inverse().rotation @ [0, 0, 4.0] + pose.inverse().translation
        on_it = poster + 0.3 * rng.normal(size=(40, 3))
        others = points_around(rng, 160)
        bearings = np.vstack([seen_from(pose, on_it), directions(rng, 160)])
        result = estimate_absolute_pose(noisy(rng, bearings, 1e-3), np.vstack([on_it, others]))
        assert not result.success


def test_two_rooms_alike_are_ambiguous_and_both_poses_are_told():
    rng = np.random.default_rng(0)
    pose, points, bearings = scene(0, 200)
    twin = Pose(rotation_from_vector([0, 1.0, 0]), np.array([30.0, 0, 0]))
    there = points @ twin.rotation.T + twin.translation
    unlike = rng.random(200) < 0.2  # what only the first room has
    rows = np.concatenate([np.arange(200), np.flatnonzero(~unlike)])
    world = np.vstack([points, there[~unlike]])
    result = estimate_absolute_pose(bearings[rows], world)
    assert result.status == "ambiguous" and len(result.alternatives) == 1
    assert rotation_error_deg(result.cam_from_world, pose) < 0.1
    assert rotation_error_deg(result.alternatives[0], pose @ twin.inverse()) < 0.2


def test_a_patch_is_concentrated_and_its_pose_is_an_alternative():
    rng = np.random.default_rng(1)
    pose = random_pose(rng)
    patch = 0.05 * directions(rng, 100) + [0, 0, 5.0]
    points = patch @ pose.rotation - pose.rotation.T @ pose.translation
    result = estimate_absolute_pose(noisy(rng, seen_from(pose, points), 1e-3), points)
    assert result.status in ("concentrated_inliers", "too_few_inliers")
    assert np.isnan(result.cam_from_world.translation).all()


def test_a_wrong_match_of_a_near_point_does_not_hold_the_camera():
    """It is explained by a small step of the camera, and a robust loss alone lets it."""
    for seed in range(20):
        pose, points, bearings = scene(seed, 200, 3e-3, outliers=0.6)
        points[0] = pose.inverse().translation + 0.1 * directions(np.random.default_rng(seed), 1)[0]
        result = estimate_absolute_pose(bearings, points)
        assert result.success and rotation_error_deg(result.cam_from_world, pose) < 0.5


def test_gravity_is_a_prior():
    pose, points, bearings = scene(3, 40, 5e-3)
    down = pose.rotation @ [0.0, 1.0, 0.0]
    level = estimate_absolute_pose(bearings, points, gravity=down, gravity_sigma_deg=0.01)
    assert np.degrees(np.arccos(min(1.0, down @ level.cam_from_world.rotation[:, 1]))) < 0.02
    alone = estimate_absolute_pose(bearings, points)
    assert level.rotation_sigma_deg < alone.rotation_sigma_deg


def test_missing_rows_and_order_change_nothing():
    pose, points, bearings = scene(4, outliers=0.3)
    order = np.random.default_rng(0).permutation(200)
    before = estimate_absolute_pose(bearings, points)
    holed = np.insert(bearings[order], 5, np.nan, axis=0)
    after = estimate_absolute_pose(holed, np.insert(points[order], 5, 0.0, axis=0))
    assert not after.inlier_mask[5] and np.isnan(after.residuals_rad[5])
    missing = "1 of 201 matches are missing (NaN, as of pixels outside the image)"
    assert missing in after.warnings
    np.testing.assert_array_equal(before.inlier_mask[order], np.delete(after.inlier_mask, 5))
    assert rotation_error_deg(before.cam_from_world, after.cam_from_world) < 1e-3


@pytest.mark.parametrize("seed", [-1, 2**64 + 5])
def test_any_whole_number_is_a_seed(seed):
    pose, points, bearings = scene(0, outliers=0.3)
    found = estimate_absolute_pose(bearings, points, seed=seed)
    assert found.success and rotation_error_deg(found.cam_from_world, pose) < 0.1


def test_same_seed_gives_the_same_bits():
    _, points, bearings = scene(5, outliers=0.6)
    one, two = (estimate_absolute_pose(bearings, points, seed=3) for _ in range(2))
    np.testing.assert_array_equal(one.cam_from_world.matrix(), two.cam_from_world.matrix())
    np.testing.assert_array_equal(one.covariance, two.covariance)


@pytest.mark.parametrize("num_points", [0, 1, 3, 5])
def test_few_matches_are_said_to_be_few(num_points):
    _, points, bearings = scene(6, 10)
    result = estimate_absolute_pose(bearings[:num_points], points[:num_points])
    assert result.status == "too_few_matches" and result.probability == 0.0


def test_a_camera_that_does_not_fit_is_said_to_be_noisy():
    _, points, bearings = scene(7, noise_rad=5e-3)
    result = estimate_absolute_pose(bearings, points, max_noise_deg=0.1)
    assert result.success and "agree only to" in result.warnings[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inlier_threshold_deg": 0.0}, "inlier_threshold_deg must be"),
        ({"min_num_inliers": 3}, "min_num_inliers must be at least 4, got 3"),
        ({"shared_error": -1.0}, "shared_error must be 0 or more"),
        ({"gravity_sigma_deg": 0.0}, "gravity_sigma_deg must be positive"),
        ({"point_covariances": np.eye(3)}, "point_covariances must have shape (200, 3, 3)"),
        ({"point_covariances": np.tile(-np.eye(3), (200, 1, 1))}, "symmetric and positive"),
        ({"point_covariances": np.tile(np.triu(np.ones((3, 3))), (200, 1, 1))}, "symmetric and"),
        ({"seed": 1.5}, "seed must be an integer, got 1.5"),
        ({"max_noise_deg": -1}, "max_noise_deg must be a positive number"),
        ({"seed": float("nan")}, "seed must be an integer, got nan"),
        ({"guess": np.eye(4)}, "guess must be a Pose"),
    ],
)
def test_wrong_options_are_named(options, message):
    _, points, bearings = scene(0)
    with pytest.raises(ValueError, match=re.escape(message)):
        estimate_absolute_pose(bearings, points, **options)
    with pytest.raises(ValueError, match="points must have shape"):
        estimate_absolute_pose(bearings, points[1:])


@pytest.mark.parametrize("seed", [-1, 10**30])
def test_any_integer_is_a_seed(seed):
    _, points, bearings = scene(0)
    assert estimate_absolute_pose(bearings, points, seed=seed).success


@pytest.mark.parametrize("number", [1e101, 1e200, -1e308])
def test_a_point_whose_distance_is_no_number_is_refused(number):
    _, points, bearings = scene(0)
    points[3, 1] = number
    with pytest.raises(ValueError, match=r"points must be at most 1e\+100 from zero"):
        estimate_absolute_pose(bearings, points)


@pytest.mark.parametrize("unit", [1e-12, 1e12])
def test_the_unit_of_the_points_does_not_matter(unit):
    _, points, bearings = scene(0)
    found = estimate_absolute_pose(bearings, unit * points)
    expected = estimate_absolute_pose(bearings, points).cam_from_world.rotation
    assert found.success
    np.testing.assert_allclose(found.cam_from_world.rotation, expected, atol=1e-8)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("distance", [0.0, 5e6, 5e9, 5e12])
@pytest.mark.parametrize("places", ["a line", "two points"])
def test_what_leaves_the_pose_open_is_never_ok_wherever_it_is(places, distance, unit):
    """The camera may turn about the line; far from the origin, rounding bends it a little."""
    rng = np.random.default_rng(0)
    for seed in range(6):
        pose = random_pose(rng)
        along = (
            rng.uniform(-5.0, 5.0, (100, 1))
            if places == "a line"
            else np.tile([[1.0], [2.0]], (50, 1))
        )
        points = 2.0 * directions(rng, 1) + along * directions(rng, 1)
        bearings = seen_from(pose, points)
        origin = distance * np.array([0.6, 0.5, -0.62])
        result = estimate_absolute_pose(bearings, unit * (points + origin), seed=seed)
        assert not result.success


@pytest.mark.parametrize("distance", [5e6, 5e9])
def test_a_map_in_coordinates_of_the_earth_gives_the_same_pose(distance):
    pose, points, bearings = scene(0)
    origin = distance * np.array([0.6, 0.5, -0.62])
    found = estimate_absolute_pose(bearings, points + origin)
    expected = estimate_absolute_pose(bearings, points)
    assert found.success
    np.testing.assert_allclose(
        found.cam_from_world.rotation, expected.cam_from_world.rotation, atol=1e-5
    )


def test_bearings_in_the_place_of_points_are_refused():
    _, points, bearings = scene(0)
    with pytest.raises(ValueError, match="the bearings come first"):
        estimate_absolute_pose(points, bearings)
    with pytest.raises(ValueError, match="the bearings come first"):
        estimate_absolute_pose(points, bearings.astype(np.float32))
    on_a_sphere = points / np.linalg.norm(points, axis=1, keepdims=True)
    estimate_absolute_pose(bearings, on_a_sphere)  # as far as anybody can tell


def test_a_result_prints_as_one_line_without_its_arrays():
    _, points, bearings = scene(0)
    result = estimate_absolute_pose(bearings, points)
    text = repr(result)
    assert text.startswith("AbsolutePoseResult(status='ok', probability=")
    assert f"rotation_sigma_deg={result.rotation_sigma_deg!r}" in text
    assert "array(" not in text.replace(repr(result.cam_from_world), "")
    assert "rotation_sigma_deg=nan" in repr(estimate_absolute_pose(bearings[:2], points[:2]))


@pytest.mark.parametrize("seed", range(8))
def test_a_photograph_of_which_nine_matches_of_ten_are_wrong_has_its_pose(seed):
    """What most matches agree with roughly leads far away from it."""
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    seen = directions(rng, 4000)
    seen = seen[seen[:, 2] > np.cos(np.radians(45.0))][:400]
    places = (seen * rng.uniform(1.5, 5.0, (400, 1)) - pose.translation) @ pose.rotation
    bearings = noisy(rng, seen, np.radians(0.05))
    bearings[40:] = bearings[40 + rng.permutation(360)]
    result = estimate_absolute_pose(bearings, places)
    assert result.success and result.inlier_mask[:40].sum() >= 35
    away = pose.inverse().translation - result.cam_from_world.inverse().translation
    assert np.linalg.norm(away) < 0.05
