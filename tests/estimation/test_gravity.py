# SPDX-License-Identifier: BSD-3-Clause
"""Gravity makes the search short; the answer does not rest on it."""

import numpy as np
import pytest
from noisy_problems import errors_deg, noisy_scene, unit_pose

from epi360 import estimate_relative_pose, estimate_relative_poses
from epi360.poses import rotation_from_vector


def tilted(gravity, angle_deg, rng):
    """Turn a direction by an angle, about any axis across it."""
    axis = np.cross(gravity, rng.normal(size=3))
    return rotation_from_vector(np.radians(angle_deg) * axis / np.linalg.norm(axis)) @ gravity


def gravity_of(scene, seed, error1_deg, error2_deg):
    rng = np.random.default_rng(seed)
    gravity = rng.normal(size=3)
    gravity /= np.linalg.norm(gravity)
    return {
        "gravity1": tilted(gravity, error1_deg, rng),
        "gravity2": tilted(scene.cam2_from_cam1.rotation @ gravity, error2_deg, rng),
    }


def estimate(scene, **options):
    return estimate_relative_pose(scene.bearings1, scene.bearings2, **options)


@pytest.mark.parametrize(
    ("outliers", "share_of_iterations"),
    # Five right matches of 30 % in a thousand samples, three in a hundred; at 80 % the search
    # without gravity stops at its limit.
    [(0.7, 0.15), (0.8, 0.25)],
)
def test_gravity_good_to_a_few_degrees_gives_the_same_pose_with_fewer_samples(
    outliers, share_of_iterations
):
    scenes = [noisy_scene(seed, 0.15, outliers, num_matches=300) for seed in range(10)]
    plain = [estimate(scene) for scene in scenes]
    assert all(result.success for result in plain)
    expected = [
        errors_deg(r.cam2_from_cam1, unit_pose(s)) for r, s in zip(plain, scenes, strict=True)
    ]
    iterations = np.median([result.num_iterations for result in plain])
    for error_deg in (0.0, 1.0, 3.0):
        results = [
            estimate(scene, **gravity_of(scene, seed, error_deg, error_deg), gravity_sigma_deg=5.0)
            for seed, scene in enumerate(scenes)
        ]
        assert all(result.success for result in results)
        found = [
            errors_deg(r.cam2_from_cam1, unit_pose(s)) for r, s in zip(results, scenes, strict=True)
        ]
        # The same optimum, but for the last steps of the refinement.
        np.testing.assert_allclose(found, expected, atol=0.01)
        samples = np.median([result.num_iterations for result in results])
        assert samples < share_of_iterations * iterations


def test_gravity_of_no_weight_does_not_pull_at_the_answer():
    scene = noisy_scene(0, 0.2, 0.3)
    plain = estimate(scene)
    for error_deg in (0.0, 2.0, 5.0):
        gravity = gravity_of(scene, 1, error_deg, 0.0)
        result = estimate(scene, **gravity, gravity_sigma_deg=90.0)
        assert max(errors_deg(result.cam2_from_cam1, plain.cam2_from_cam1)) < 1e-3
        np.testing.assert_array_equal(result.inlier_mask, plain.inlier_mask)
        np.testing.assert_allclose(result.covariance, plain.covariance, rtol=1e-2)


def test_gravity_that_is_known_well_narrows_the_rotation_and_its_sigma():
    plain_errors, errors, narrower = [], [], []
    for seed in range(30):
        scene = noisy_scene(seed, 1.0, 0.3, num_matches=60)
        plain = estimate(scene)
        known = estimate(scene, **gravity_of(scene, seed, 0.0, 0.0), gravity_sigma_deg=0.1)
        if not (plain.success and known.success):
            continue
        plain_errors.append(errors_deg(plain.cam2_from_cam1, unit_pose(scene))[0])
        errors.append(errors_deg(known.cam2_from_cam1, unit_pose(scene))[0])
        narrower.append(np.trace(known.covariance[:3, :3]) < np.trace(plain.covariance[:3, :3]))
    assert len(errors) > 20 and np.mean(narrower) > 0.9
    assert np.mean(errors) < 0.8 * np.mean(plain_errors)


def is_silently_wrong(result, truth):
    return result.success and max(errors_deg(result.cam2_from_cam1, truth)) > 5.0


@pytest.mark.parametrize("error_deg", [90.0, 180.0])
@pytest.mark.parametrize("outliers", [0.7, 0.8])
def test_wrong_gravity_among_many_outliers_is_never_silently_wrong(outliers, error_deg):
    for seed in range(12):
        scene = noisy_scene(seed, 0.15, outliers, num_matches=300)
        result = estimate(scene, **gravity_of(scene, seed, 0.0, error_deg))
        assert not is_silently_wrong(result, unit_pose(scene))


def test_wrong_gravity_is_never_silently_wrong():
    wrong = []
    for seed in range(40):
        scene = noisy_scene(seed, 0.15, 0.5, num_matches=300)
        result = estimate(scene, **gravity_of(scene, seed, 0.0, 90.0))
        if is_silently_wrong(result, unit_pose(scene)):
            wrong.append(seed)
    assert wrong == []


def test_turning_a_camera_with_its_gravity_turns_the_pose():
    scene = noisy_scene(2, 0.1, 0.5)
    gravity = gravity_of(scene, 2, 0.5, 0.5)
    R = rotation_from_vector([1.0, -2.0, 0.5])
    before = estimate(scene, **gravity)
    turned = gravity | {"gravity2": R @ gravity["gravity2"]}
    after = estimate_relative_pose(scene.bearings1, scene.bearings2 @ R.T, **turned)
    assert after.success and after.num_iterations == before.num_iterations
    pose, expected = after.cam2_from_cam1, before.cam2_from_cam1
    np.testing.assert_allclose(pose.rotation, R @ expected.rotation, atol=1e-5)
    np.testing.assert_allclose(pose.translation, R @ expected.translation, atol=1e-5)


def test_the_length_of_gravity_does_not_matter():
    scene = noisy_scene(3, 0.2, 0.5)
    gravity = gravity_of(scene, 3, 1.0, 0.0)
    unit, metric = (
        estimate(scene, gravity1=scale * gravity["gravity1"], gravity2=gravity["gravity2"].tolist())
        for scale in (1.0, 9.81)
    )
    np.testing.assert_allclose(
        unit.cam2_from_cam1.matrix(), metric.cam2_from_cam1.matrix(), atol=1e-9
    )


def test_gravity_goes_with_scores_pixels_and_missing_rows():
    scene = noisy_scene(4, 0.15, 0.8, num_matches=300)
    b1 = scene.bearings1.copy()
    b1[::50] = np.nan
    scores = scene.inlier_mask + np.random.default_rng(0).normal(size=300)
    result = estimate_relative_pose(
        b1, scene.bearings2, match_scores=scores, **gravity_of(scene, 4, 1.0, 1.0)
    )
    assert result.success and result.num_iterations < 300
    assert max(errors_deg(result.cam2_from_cam1, unit_pose(scene))) < 2.0


def test_a_pure_rotation_with_gravity_is_still_one():
    for seed in range(5):
        scene = noisy_scene(seed, 0.1, 0.3, baseline_m=0.0)
        assert estimate(scene, **gravity_of(scene, seed, 0.5, 0.5)).status == "pure_rotation"


@pytest.mark.parametrize("num_matches", range(9))
def test_five_matches_are_needed_with_gravity_as_without(num_matches):
    scene = noisy_scene(5, 0.2, num_matches=max(num_matches, 1))
    arrays = scene.bearings1[:num_matches], scene.bearings2[:num_matches]
    result = estimate_relative_pose(*arrays, **gravity_of(scene, 5, 0.0, 0.0))
    assert (result.status == "too_few_matches") == (num_matches < 5)


@pytest.mark.parametrize(
    ("gravity", "message"),
    [
        ({"gravity1": [0, 1, 0]}, "gravity1 and gravity2 must be given together, got only one"),
        ({"gravity2": [0, 1, 0]}, "gravity1 and gravity2 must be given together, got only one"),
        ({"gravity1": [0, 0, 0], "gravity2": [0, 1, 0]}, "gravity1 must be a finite direction"),
        ({"gravity1": [0, 1, 0], "gravity2": [0, np.nan, 0]}, "gravity2 must be a finite direct"),
        ({"gravity1": [np.inf, 1, 0], "gravity2": [0, 1, 0]}, "gravity1 must be a finite direct"),
        ({"gravity1": [0, 1], "gravity2": [0, 1, 0]}, r"gravity1 must have shape \(3,\), got \(2,"),
        ({"gravity1": 9.81, "gravity2": [0, 1, 0]}, r"gravity1 must have shape \(3,\), got"),
    ],
)
def test_wrong_gravity_is_refused(gravity, message):
    with pytest.raises(ValueError, match=message):
        estimate(noisy_scene(0), **gravity)


def test_little_motion_stays_a_motion_where_gravity_is_known():
    lost = 0
    for seed in range(30):
        scene = noisy_scene(seed, 0.06, 0.7, num_matches=150, baseline_m=0.3)
        plain = estimate(scene)
        known = estimate(scene, **gravity_of(scene, seed, 1.0, 1.0), gravity_sigma_deg=1.0)
        lost += plain.success and not known.success
    assert lost <= 1


@pytest.mark.parametrize("num_pairs", [2, 3, 4])
def test_gravity_may_be_unknown_for_some_of_any_number_of_pairs(num_pairs):
    scene = noisy_scene(0, 0.1, 0.3)
    pairs = [(scene.bearings1, scene.bearings2)] * num_pairs
    gravity = gravity_of(scene, 0, 0.0, 0.0)
    each = {name: [down] + [None] * (num_pairs - 1) for name, down in gravity.items()}
    some = estimate_relative_poses(pairs, **each)
    none = estimate_relative_poses(pairs, gravity1=[None] * num_pairs, gravity2=[None] * num_pairs)
    for result, expected in zip(some, [estimate(scene, **gravity), *none[1:]], strict=True):
        np.testing.assert_array_equal(
            result.cam2_from_cam1.rotation, expected.cam2_from_cam1.rotation
        )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"elevation_sigma_deg": 2.0}, "needs gravity1 and gravity2"),
        ({"gravity_sigma_deg": None}, "gravity_sigma_deg must be a number from 1e-6 to 90"),
        ({"gravity_sigma_deg": 0.0}, "gravity_sigma_deg must be a number"),
    ],
)
def test_sigmas_that_cannot_be_used_are_refused(options, message):
    scene = noisy_scene(0, 0.1, 0.3)
    with pytest.raises(ValueError, match=message):
        estimate(scene, **options)
    with pytest.raises(ValueError, match=message):
        estimate_relative_poses([(scene.bearings1, scene.bearings2)], **options)


def test_a_number_is_no_direction():
    scene = noisy_scene(0, 0.1, 0.3)
    with pytest.raises(ValueError, match="gravity1 must be a direction"):
        estimate_relative_poses(
            [(scene.bearings1, scene.bearings2)], gravity1=5.0, gravity2=[0.0, 1.0, 0.0]
        )


def test_gravity_that_the_matches_contradict_is_said():
    scene = noisy_scene(1, 0.1, 0.3)
    right = gravity_of(scene, 1, 0.5, 0.5)
    assert not estimate(scene, **right).warnings
    wrong = right | {"gravity2": tilted(right["gravity2"], 60.0, np.random.default_rng(0))}
    result = estimate(scene, **wrong)
    assert max(errors_deg(result.cam2_from_cam1, unit_pose(scene))) < 1.0
    (warning,) = result.warnings
    assert "against the given gravity" in warning
    tilt = float(warning.split("tilts the cameras by ")[1].split(" degrees")[0])
    assert 59.0 < tilt < 61.0
