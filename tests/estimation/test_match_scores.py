# SPDX-License-Identifier: BSD-3-Clause
"""Scores make the search shorter where they are good, and do no harm where they are useless."""

import numpy as np
import pytest
from noisy_problems import errors_deg, noisy_scene, unit_pose

from epi360 import estimate_relative_pose


def scores_of(kind, scene, seed):
    """Scores of every match: of right and wrong ones two standard deviations apart if "good"."""
    rng = np.random.default_rng(1000 + seed)
    noise, right = rng.normal(size=len(scene.inlier_mask)), scene.inlier_mask
    return {
        "none": None,
        "good": noise + 2.0 * right,
        "random": noise,
        "constant": np.zeros(len(right)),
        "by place": scene.bearings1[:, 0],
        "reversed": noise - 2.0 * right,
    }[kind]


def outcomes(kind, num_matches, outliers, seeds):
    """Return shares of right and of wrong answers, and the median number of samples."""
    right, wrong, iterations = 0, 0, []
    for seed in seeds:
        scene = noisy_scene(seed, 0.15, outliers, num_matches=num_matches)
        scores = scores_of(kind, scene, seed)
        result = estimate_relative_pose(scene.bearings1, scene.bearings2, match_scores=scores)
        near = result.success and max(errors_deg(result.cam2_from_cam1, unit_pose(scene))) < 2.0
        right, wrong = right + near, wrong + (result.success and not near)
        iterations.append(result.num_iterations)
    return right / len(seeds), wrong / len(seeds), np.median(iterations)


@pytest.mark.parametrize("outliers", [0.85, 0.9])
def test_good_scores_find_more_with_fewer_samples(outliers):
    right, _, iterations = outcomes("none", 300, outliers, range(12))
    scored_right, _, scored_iterations = outcomes("good", 300, outliers, range(12))
    assert scored_right > right
    assert scored_iterations < 0.6 * iterations


def test_good_scores_save_most_samples_where_the_pose_is_found_anyway():
    right, wrong, iterations = outcomes("none", 300, 0.6, range(15))
    assert (right, wrong) == (1.0, 0.0)
    right, wrong, scored_iterations = outcomes("good", 300, 0.6, range(15))
    assert (right, wrong) == (1.0, 0.0)
    assert scored_iterations < 0.2 * iterations


@pytest.mark.parametrize("kind", ["random", "constant", "by place"])
@pytest.mark.parametrize(("num_matches", "outliers"), [(300, 0.7), (100, 0.3), (2000, 0.5)])
def test_useless_scores_do_no_harm(kind, num_matches, outliers):
    seeds = range(12)
    expected, _, iterations = outcomes("none", num_matches, outliers, seeds)
    right, wrong, scored_iterations = outcomes(kind, num_matches, outliers, seeds)
    assert right >= expected - 1 / len(seeds)
    assert wrong <= 1 / len(seeds)
    assert scored_iterations < 2.0 * iterations


def test_scores_that_are_upside_down_cost_samples_but_no_answers():
    right, wrong, _ = outcomes("reversed", 300, 0.5, range(24))
    assert (right, wrong) == (1.0, 0.0)


def test_a_few_matches_with_scores_upside_down_are_no_reason_to_stop_early():
    right, wrong, _ = outcomes("reversed", 100, 0.3, range(60))
    assert (right, wrong) == (1.0, 0.0)


def test_many_matches_with_scores_upside_down_are_searched_as_well():
    right, wrong, _ = outcomes("reversed", 1200, 0.7, range(6))
    assert (right, wrong) == (1.0, 0.0)


@pytest.mark.parametrize("seed", range(8))
def test_scores_that_favour_another_motion_do_not_hide_that_of_most_matches(seed):
    most, other = noisy_scene(seed, 0.05, 0.4), noisy_scene(100 + seed, 0.05, 0.0)
    b1, b2 = (
        np.concatenate([getattr(most, name), getattr(other, name)[:50]])
        for name in ("bearings1", "bearings2")
    )
    scores = np.random.default_rng(seed).normal(np.arange(len(b1)) >= len(most.bearings1))
    result = estimate_relative_pose(b1, b2, match_scores=scores)
    assert result.success
    assert max(errors_deg(result.cam2_from_cam1, most.cam2_from_cam1)) < 1.0


def test_scores_do_not_weigh_the_answer():
    scene = noisy_scene(0, 0.2, 0.3)
    plain = estimate_relative_pose(scene.bearings1, scene.bearings2)
    scores = scores_of("good", scene, 0)
    scored = estimate_relative_pose(scene.bearings1, scene.bearings2, match_scores=scores)
    # Both searches end in the same optimum, each to a ten-thousandth of its standard deviation.
    assert max(errors_deg(scored.cam2_from_cam1, plain.cam2_from_cam1)) < 1e-3
    np.testing.assert_array_equal(scored.inlier_mask, plain.inlier_mask)


def test_only_the_order_of_the_scores_matters():
    scene = noisy_scene(1, 0.2, 0.5)
    scores = scores_of("good", scene, 1)
    first = estimate_relative_pose(scene.bearings1, scene.bearings2, match_scores=scores)
    for same in (1e-3 * scores - 7.0, np.exp(scores), np.argsort(np.argsort(scores))):
        again = estimate_relative_pose(scene.bearings1, scene.bearings2, match_scores=same)
        np.testing.assert_array_equal(again.cam2_from_cam1.matrix(), first.cam2_from_cam1.matrix())
        assert again.num_iterations == first.num_iterations


def test_infinite_scores_are_the_first_and_the_last():
    scene = noisy_scene(2, 0.2, 0.5)
    scores = np.where(scene.inlier_mask, np.inf, -np.inf)
    result = estimate_relative_pose(scene.bearings1, scene.bearings2, match_scores=scores)
    finite = estimate_relative_pose(
        scene.bearings1, scene.bearings2, match_scores=scene.inlier_mask
    )
    assert result.success and result.num_iterations == finite.num_iterations


def test_matches_with_nan_scores_are_missing():
    scene = noisy_scene(3, 0.2, 0.4)
    scores = scores_of("good", scene, 3)
    scores[[0, 9, 50]] = np.nan
    result = estimate_relative_pose(scene.bearings1, scene.bearings2, match_scores=scores)
    kept = ~np.isnan(scores)
    without = estimate_relative_pose(
        scene.bearings1[kept], scene.bearings2[kept], match_scores=scores[kept]
    )
    np.testing.assert_array_equal(result.cam2_from_cam1.matrix(), without.cam2_from_cam1.matrix())
    assert np.isnan(result.residuals_rad[~kept]).all() and not result.inlier_mask[~kept].any()
    assert result.warnings[0].startswith("3 of 200 matches are missing")
    none_left = estimate_relative_pose(
        scene.bearings1, scene.bearings2, match_scores=np.full(200, np.nan)
    )
    assert none_left.status == "too_few_matches"
    assert none_left.warnings[0].startswith("200 of 200 matches are missing")


@pytest.mark.parametrize("num_matches", range(9))
def test_a_handful_of_matches_may_have_scores(num_matches):
    scene = noisy_scene(4, 0.2, num_matches=max(num_matches, 1))
    arrays = scene.bearings1[:num_matches], scene.bearings2[:num_matches]
    result = estimate_relative_pose(*arrays, match_scores=np.arange(num_matches))
    assert result.num_matches == num_matches
    # Five or six matches fit some pose whatever they are; seven or eight may prove one.
    if num_matches < 5:
        assert result.status == "too_few_matches"
    elif num_matches < 7:
        assert result.status == "too_few_inliers"
    else:
        assert result.status in ("ok", "too_few_inliers", "planar_ambiguous")
    assert result.success == bool(np.isfinite(result.cam2_from_cam1.translation).all())


def test_eight_matches_with_scores_prove_a_pose_that_is_right():
    errors = []
    for seed in range(60):
        scene = noisy_scene(seed, 0.2, num_matches=8)
        result = estimate_relative_pose(
            scene.bearings1, scene.bearings2, match_scores=np.arange(8.0)
        )
        if result.success:
            errors.append(max(errors_deg(result.cam2_from_cam1, unit_pose(scene))))
    assert len(errors) >= 30  # of 60; measured 39
    assert np.median(errors) < 2.0 and max(errors) < 10.0  # measured: 0.9 and 5.7


@pytest.mark.parametrize(
    ("scores", "message"),
    [
        (np.ones(199), r"match_scores must have shape \(200,\), got \(199,\)"),
        (np.ones((200, 1)), r"match_scores must have shape \(200,\), got \(200, 1\)"),
        (1.0, r"match_scores must have shape \(200,\), got \(\)"),
    ],
)
def test_scores_of_wrong_shape_are_refused(scores, message):
    scene = noisy_scene(0)
    with pytest.raises(ValueError, match=message):
        estimate_relative_pose(scene.bearings1, scene.bearings2, match_scores=scores)
