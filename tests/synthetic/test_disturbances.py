# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.synthetic import (
    add_metric_noise,
    replace_with_outliers,
    sample_relative_pose,
    scene_from_points,
    two_view_scene,
)


def generator(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def directions(num, seed=0):
    vectors = generator(seed).standard_normal((num, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def rows_of(array):
    return {tuple(row) for row in array}


def test_noise_in_metres_has_its_deviation_on_each_coordinate():
    points = np.zeros((40_000, 3))
    gaussian = add_metric_noise(generator(), points, sigma_m=0.05)
    np.testing.assert_allclose(gaussian.std(axis=0), 0.05, rtol=0.02)  # four standard errors
    as_published = add_metric_noise(generator(), points, kappa=500)
    np.testing.assert_allclose(as_published.std(axis=0), 1 / np.sqrt(500), rtol=0.02)
    assert not points.any()


@pytest.mark.parametrize("options", [{}, {"sigma_m": 1, "kappa": 1}])
def test_noise_in_metres_needs_exactly_one_strength(options):
    with pytest.raises(ValueError, match="give one of sigma_m and kappa"):
        add_metric_noise(generator(), np.zeros((2, 3)), **options)
    with pytest.raises(ValueError, match="sigma_m must be 0 or more, got -1"):
        add_metric_noise(generator(), np.zeros((2, 3)), sigma_m=-1)
    with pytest.raises(ValueError, match="kappa must be positive, got 0"):
        add_metric_noise(generator(), np.zeros((2, 3)), kappa=0)


@pytest.mark.parametrize("model", ["uniform", "shuffled"])
@pytest.mark.parametrize("ratio, count", [(0.0, 0), (0.1, 1), (0.34, 3), (1.0, 10)])
def test_the_share_of_outliers_is_exact(model, ratio, count):
    exact = directions(10)
    for seed in range(20):
        disturbed, inliers = replace_with_outliers(generator(seed), exact, ratio, model=model)
        np.testing.assert_array_equal(inliers, (disturbed == exact).all(axis=1))
        assert np.sum(~inliers) == count


def test_shuffled_outliers_are_bearings_of_other_matches():
    exact = directions(50)
    disturbed, _ = replace_with_outliers(generator(1), exact, 0.6, model="shuffled")
    assert rows_of(disturbed) == rows_of(exact)
    with pytest.raises(ValueError, match="one single match cannot be shuffled"):
        replace_with_outliers(generator(), exact[:1], 1.0, model="shuffled")


def test_the_authors_outliers_are_fewer_than_they_say_and_may_be_antipodes():
    exact = directions(20_000)
    disturbed, inliers = replace_with_outliers(generator(), exact, 0.5, model="authors")
    # Drawn with replacement, a row is missed with probability exp(-1/2).
    assert np.mean(~inliers) == pytest.approx(1 - np.exp(-0.5), abs=0.005)
    wrong = rows_of(disturbed[~inliers])
    assert wrong <= rows_of(exact) | rows_of(-exact)
    assert len(wrong & rows_of(-exact)) / len(wrong) == pytest.approx(0.5, abs=0.03)


def test_unknown_models_and_shares_are_named():
    with pytest.raises(ValueError, match="outlier_model must be one of uniform, shuffled, authors"):
        replace_with_outliers(generator(), directions(3), 0.5, model="wild")
    with pytest.raises(ValueError, match="outlier_ratio must be in .* got 50; 0.2 is 20 %"):
        replace_with_outliers(generator(), directions(3), 50)


def test_matches_of_given_landmarks_are_exact_without_noise():
    rng = generator()
    points, pose = rng.uniform(-3, 3, (100, 3)), sample_relative_pose(rng)
    scene = scene_from_points(rng, points, pose)
    points2 = points @ pose.rotation.T + pose.translation
    for bearings, truth in ((scene.bearings1, points), (scene.bearings2, points2)):
        lengths = np.linalg.norm(truth, axis=1, keepdims=True)
        np.testing.assert_allclose(bearings * lengths, truth, atol=1e-12)
    assert scene.points is points and scene.cam2_from_cam1 is pose and scene.inlier_mask.all()


def test_noise_on_bearings_ignores_the_range_and_noise_on_points_does_not():
    rng = generator()
    points = np.concatenate([directions(4000), 10 * directions(4000, 1)])
    pose = sample_relative_pose(rng, max_translation_m=0.0)
    near, far = {}, {}
    for noise in ("bearings", "points"):
        scene = scene_from_points(rng, points, pose, kappa=5000, noise=noise)
        across = np.linalg.norm(np.cross(scene.bearings2, points @ pose.rotation.T), axis=1)
        sines = across / np.linalg.norm(points, axis=1)
        near[noise], far[noise] = sines[:4000].mean(), sines[4000:].mean()
        np.testing.assert_array_equal(
            scene.bearings1, scene_from_points(rng, points, pose).bearings1
        )
    assert near["bearings"] == pytest.approx(far["bearings"], rel=0.05)
    assert near["points"] == pytest.approx(10 * far["points"], rel=0.05)


def test_noise_in_both_views_and_an_outlier_model_can_be_asked_for():
    rng = generator()
    points, pose = 5 * directions(300), sample_relative_pose(rng)
    scene = scene_from_points(
        rng, points, pose, kappa=500, noise_in_both_views=True,
        outlier_ratio=0.2, outlier_model="shuffled",
    )  # fmt: skip
    assert np.linalg.norm(scene.bearings1 - points / 5, axis=1).mean() > 0.02
    assert np.sum(~scene.inlier_mask) == 60
    shuffled = two_view_scene(3, outlier_ratio=0.2, outlier_model="shuffled")
    assert rows_of(shuffled.bearings2) == rows_of(two_view_scene(3).bearings2)


def test_wrong_landmarks_and_noise_are_named():
    pose = sample_relative_pose(generator())
    with pytest.raises(ValueError, match=r"points must have shape \(N, 3\), got \(3,\)"):
        scene_from_points(generator(), np.ones(3), pose)
    with pytest.raises(ValueError, match="noise must be 'bearings' or 'points', got 'pixels'"):
        scene_from_points(generator(), np.ones((2, 3)), pose, noise="pixels")
