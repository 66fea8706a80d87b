# SPDX-License-Identifier: BSD-3-Clause
"""What regions and exchanged neighbours say for a pose: laws, and cases made by hand."""

import numpy as np
import pytest

from epi360 import _core, estimate_relative_pose
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.synthetic import two_view_scene

internals = _core.internals
DOWN = np.array([0.0, 1.0, 0.0])


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def scene_of(seed, **options):
    scene = two_view_scene(
        seed, **{"num_matches": 300, "noise_deg": 0.1, "noise_in_both_views": True} | options
    )
    pose = scene.cam2_from_cam1
    return scene.bearings1, scene.bearings2, Pose(pose.rotation, unit(pose.translation))


def said_for(b1, b2, pose, noise_deg=0.1, **options):
    return internals.testimony(
        b1,
        b2,
        np.ascontiguousarray(pose.rotation),
        np.ascontiguousarray(pose.translation),
        scale=np.radians(noise_deg),
        gate=2.6 * np.radians(noise_deg),
        density=0.35,
        **options,
    )


def test_a_region_of_many_matches_weighs_as_much_as_one():
    east, north = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    near_east = unit(east + np.radians(0.5) * np.random.default_rng(0).normal(size=(9, 3)))
    b1 = np.vstack([near_east, north])
    weights = internals.region_weights(b1, b1)
    np.testing.assert_allclose(weights[:9], 1 / 9)
    assert weights[9] == 1.0
    # Neighbours in view 1 that part in view 2 are regions of their own.
    apart = np.vstack([unit(np.random.default_rng(1).normal(size=(9, 3))), north])
    np.testing.assert_array_equal(internals.region_weights(b1, apart), 1.0)


def test_region_weights_count_neighbours_as_numpy_does():
    b1, b2, _ = scene_of(3, num_matches=200, layout="cone", cone_half_angle_deg=20.0)
    chord = 2.0 * np.sin(np.radians(1.5))

    def near(b):
        return np.linalg.norm(b[:, None] - b[None], axis=2) <= chord

    expected = 1.0 / (near(b1) & near(b2)).sum(axis=1)
    np.testing.assert_allclose(internals.region_weights(b1, b2), expected)


def test_the_true_pose_is_spoken_for_and_a_random_one_is_not():
    for seed in range(10):
        b1, b2, pose = scene_of(seed, outlier_ratio=0.5)
        wrong = Pose(rotation_from_vector([0.0, 1.0, 0.0]) @ pose.rotation, pose.translation)
        right_ratio, right_sigma = said_for(b1, b2, pose)
        wrong_ratio, wrong_sigma = said_for(b1, b2, wrong)
        assert right_ratio > 300.0 and right_sigma < np.radians(1.0)
        assert wrong_ratio < 25.0 and wrong_sigma > 5.0 * right_sigma


def test_copies_of_matches_add_hardly_anything():
    b1, b2, pose = scene_of(0, num_matches=60)
    once, sigma_once = said_for(b1, b2, pose)
    fourfold, sigma_fourfold = said_for(np.tile(b1, (4, 1)), np.tile(b2, (4, 1)), pose)
    # Copies exchange partners among themselves and agree all the same: they say less, not more.
    assert fourfold < once
    assert sigma_fourfold == pytest.approx(sigma_once, rel=0.2)


def test_agreement_that_survives_an_exchange_of_neighbours_says_little():
    # The same share of inliers: once as exact as key points are, once only region by region.
    b1, b2, pose = scene_of(1, num_matches=400, layout="cone", cone_half_angle_deg=40.0)
    exact, _ = said_for(b1, b2, pose)
    rng = np.random.default_rng(0)
    coarse = unit(b2 + np.radians(3.0) * rng.normal(size=b2.shape))
    vague, _ = said_for(b1, coarse, pose, noise_deg=3.0)
    assert exact > 600.0 and vague < 0.3 * exact


def test_what_stands_still_in_the_image_says_nothing():
    b1, b2, pose = scene_of(2, num_matches=200, baseline_m=1.0)
    still = unit(np.array([0.0, 1.0, 0.0]) + 0.3 * np.random.default_rng(0).normal(size=(60, 3)))
    steady = Pose(np.eye(3), pose.translation)
    moving = unit(b1 @ np.eye(3))
    alone, _ = said_for(moving[:80], b2[:80], steady)
    with_tripod, _ = said_for(np.vstack([moving[:80], still]), np.vstack([b2[:80], still]), steady)
    # Sixty matches of a tripod agree with any pose that does not turn; here they are most inliers,
    # so they count as the scene. With a scene of their own size they do not.
    assert with_tripod > alone
    far = unit(np.random.default_rng(1).normal(size=(120, 3)))
    seen = unit(far + 0.2 * pose.translation)
    scene_only, _ = said_for(far, seen, steady)
    both, _ = said_for(np.vstack([far, still]), np.vstack([seen, still]), steady)
    assert both < scene_only + 5.0


def test_the_answer_does_not_depend_on_the_order_of_few_matches():
    b1, b2, pose = scene_of(4)
    order = np.random.default_rng(0).permutation(len(b1))
    before, after = said_for(b1, b2, pose), said_for(b1[order], b2[order], pose)
    np.testing.assert_allclose(after, before, rtol=0.05)


def level_scene(seed, outlier_ratio):
    rng = np.random.default_rng(seed)
    heading, azimuth = rng.uniform(0.0, 2.0 * np.pi, 2)
    direction = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    pose = Pose(rotation_from_vector([0.0, heading, 0.0]), 1.5 * direction)
    b1, b2, _ = scene_of(seed, cam2_from_cam1=pose, outlier_ratio=outlier_ratio, num_matches=120)
    return b1, b2, Pose(pose.rotation, direction)


def test_all_upright_poses_are_tried_and_the_right_one_comes_first():
    first = []
    for seed in range(20):
        b1, b2, pose = level_scene(seed, 0.85)
        R, t = internals.upright_poses(b1, b2, DOWN, DOWN, 4)[0]
        found = Pose(R, t)
        assert rotation_error_deg(found, Pose(found.rotation, t)) == 0.0
        first.append(
            rotation_error_deg(found, pose) < 3.0 and translation_error_deg(found, pose) < 6.0
        )
    assert sum(first) >= 18  # two degrees of freedom, so 18 right matches of 120 suffice


def test_upright_poses_follow_gravity_that_is_not_the_y_axis():
    b1, b2, pose = level_scene(5, 0.5)
    turn1, turn2 = rotation_from_vector([0.3, 0.0, 0.5]), rotation_from_vector([-0.6, 0.1, 0.0])
    R, t = internals.upright_poses(b1 @ turn1.T, b2 @ turn2.T, turn1 @ DOWN, turn2 @ DOWN, 1)[0]
    found = Pose(turn2.T @ R @ turn1, turn2.T @ t)
    assert rotation_error_deg(found, pose) < 3.0 and translation_error_deg(found, pose) < 6.0


def test_gravity_finds_poses_that_samples_miss():
    found = {"plain": 0, "gravity": 0}
    for seed in range(20):
        b1, b2, pose = level_scene(seed, 0.85)
        plain = estimate_relative_pose(b1, b2)
        known = estimate_relative_pose(b1, b2, gravity1=DOWN, gravity2=DOWN)
        for name, result in (("plain", plain), ("gravity", known)):
            right = result.success and translation_error_deg(result.cam2_from_cam1, pose) < 5.0
            found[name] += right
            assert right or not result.success
    assert found["gravity"] >= found["plain"] + 2


def test_a_tilt_against_known_gravity_lowers_the_probability():
    # Only twenty right matches, of a camera that tilts by eight degrees where none is expected.
    scene = two_view_scene(
        3,
        num_matches=60,
        noise_deg=0.2,
        outlier_ratio=0.5,
        cam2_from_cam1=Pose(rotation_from_vector([0.14, 0.4, 0.0]), np.array([1.0, 0.0, 0.3])),
    )
    plain = estimate_relative_pose(scene.bearings1, scene.bearings2)
    known = estimate_relative_pose(
        scene.bearings1, scene.bearings2, gravity1=DOWN, gravity2=DOWN, gravity_sigma_deg=0.5
    )
    assert plain.success and 0.85 < plain.probability <= 1.0
    assert known.probability < plain.probability


def degenerate(kind, rng, noise=1e-4, num_matches=100):
    turn = rotation_from_vector(rng.normal(size=3))
    t = unit(rng.normal(size=3))
    if kind.startswith("points"):
        points = 3.0 * rng.normal(size=(int(kind[6:]), 3))
        points = points[rng.integers(len(points), size=num_matches)]
    elif kind == "line":
        points = 3.0 * rng.normal(size=3) + rng.uniform(-3, 3, (num_matches, 1)) * rng.normal(
            size=3
        )
    else:  # all rays and the baseline in one plane
        centre2 = -turn.T @ t
        points = rng.normal(size=(num_matches, 2)) @ np.stack([3.0 * rng.normal(size=3), centre2])
    b1, b2 = unit(points), unit(points @ turn.T + t)
    return (
        unit(b1 + noise * rng.normal(size=b1.shape)),
        unit(b2 + noise * rng.normal(size=b2.shape)),
        Pose(turn, t),
    )


@pytest.mark.parametrize("kind", ["points2", "points3", "points4", "line", "plane"])
def test_degenerate_matches_are_not_taken_for_a_pose(kind):
    wrong = 0
    for seed in range(40):
        b1, b2, pose = degenerate(kind, np.random.default_rng(seed))
        result = estimate_relative_pose(b1, b2)
        if result.success:
            wrong += translation_error_deg(result.cam2_from_cam1, pose) > 10.0
            assert np.linalg.eigvalsh(result.covariance).min() > 0.0
    assert wrong == 0


def test_a_motion_of_a_few_noises_is_no_rotation_where_many_matches_say_so():
    # The median parallax is 2.2 times the noise; four hundred matches reject the rotation.
    statuses, ratios = [], []
    for seed in range(20):
        b1, b2, pose = scene_of(
            seed, num_matches=400, noise_deg=1.0, baseline_m=0.12, layout="room"
        )
        result = estimate_relative_pose(b1, b2)
        statuses.append(result.status)
        if result.success:
            sigma_deg = np.degrees(np.trace(result.covariance[3:, 3:]) ** 0.5)
            ratios.append(translation_error_deg(result.cam2_from_cam1, pose) / sigma_deg)
    assert statuses.count("ok") >= 18
    assert 0.3 < np.median(ratios) < 1.5
