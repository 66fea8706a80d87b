# SPDX-License-Identifier: BSD-3-Clause
"""Matches that are given several times say no more than once."""

import numpy as np
import pytest
from noisy_problems import noisy_scene
from seen_points import scene

from epi360 import estimate_absolute_pose, estimate_relative_pose
from epi360.cameras import Equirectangular
from epi360.estimation.calibration_doubt import with_calibration_doubt
from epi360.estimation.copies import distinct_rows


def drawn_unevenly(count, seed):
    """Rows of a draw with replacement, and those of them that repeat no earlier one."""
    rng = np.random.default_rng(seed)
    chances = rng.exponential(size=count) ** 2
    drawn = rng.choice(count, 8 * count, p=chances / chances.sum())
    return drawn, drawn[np.sort(np.unique(drawn, return_index=True)[1])]


def assert_same_answer(result, drawn, other, once):
    assert (result.status, result.probability) == (other.status, other.probability)
    np.testing.assert_array_equal(result.covariance, other.covariance)
    assert set(drawn[result.inlier_mask]) == set(once[other.inlier_mask])
    np.testing.assert_array_equal(result.inlier_mask, np.isin(drawn, once[other.inlier_mask]))
    residuals = np.empty(1 + drawn.max())
    residuals[once] = other.residuals_rad
    np.testing.assert_array_equal(result.residuals_rad, residuals[drawn])


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("noise_deg", "outlier_ratio"), [(0.1, 0.3), (0.05, 0.6)])
def test_copies_of_matches_change_nothing(noise_deg, outlier_ratio, seed):
    made = noisy_scene(seed, noise_deg, outlier_ratio)
    drawn, once = drawn_unevenly(len(made.bearings1), seed)
    scores, weights = np.random.default_rng(seed).uniform(0.1, 1.0, (2, len(made.bearings1)))

    def estimate(rows, **more):
        return estimate_relative_pose(made.bearings1[rows], made.bearings2[rows], **more)

    result = estimate(drawn)
    assert result.success and "repeat another one exactly" in result.warnings[0]
    assert_same_answer(result, drawn, estimate(once), once)
    result = estimate(drawn, weights=weights[drawn], match_scores=scores[drawn])
    other = estimate(once, weights=weights[once], match_scores=scores[once])
    assert_same_answer(result, drawn, other, once)


def test_of_copies_the_heaviest_and_the_best_scored_count():
    made = noisy_scene(0, 0.1, 0.3)
    b1, b2 = made.bearings1, made.bearings2
    rng = np.random.default_rng(0)
    light, heavy = np.sort(rng.uniform(0.1, 1.0, (2, len(b1))), axis=0)
    low, high = np.sort(rng.uniform(size=(2, len(b1))), axis=0)
    light[::3] = 1e-9  # next to nothing beside the heaviest
    once = estimate_relative_pose(b1, b2, weights=heavy, match_scores=high)
    for lighter_first in (True, False):
        order = slice(None) if lighter_first else slice(None, None, -1)
        weights, scores = (np.concatenate(each[order]) for each in ([light, heavy], [low, high]))
        twice = np.tile(b1, (2, 1)), np.tile(b2, (2, 1))
        result = estimate_relative_pose(*twice, weights=weights, match_scores=scores)
        np.testing.assert_array_equal(result.covariance, once.covariance)
        np.testing.assert_array_equal(result.inlier_mask, np.tile(once.inlier_mask, 2))


def test_missing_rows_are_counted_beside_the_copies():
    made = noisy_scene(0, 0.1, 0.2)
    gaps = np.full((30, 3), np.nan)
    b1, b2 = (np.concatenate([b, gaps, b]) for b in (made.bearings1, made.bearings2))
    result = estimate_relative_pose(b1, b2)
    assert result.warnings[0].startswith("30 of 430 matches are missing")
    assert result.warnings[1].startswith("200 of 430 matches repeat")
    assert result.num_inliers % 2 == 0 and not result.inlier_mask[200:230].any()


def test_rows_that_share_one_view_are_no_copies():
    made = noisy_scene(0, 0.1)
    b1, b2 = made.bearings1, made.bearings2
    other = estimate_relative_pose(np.tile(b1, (2, 1)), np.concatenate([b2, b2[::-1]]))
    assert not any("repeat" in warning for warning in other.warnings)
    assert 190 <= other.num_inliers < 250


@pytest.mark.parametrize("seed", range(5))
def test_copies_of_points_in_known_places_change_nothing(seed):
    _, points, bearings = scene(seed, num_points=100, outliers=0.3)
    drawn, once = drawn_unevenly(100, seed)
    result = estimate_absolute_pose(bearings[drawn], points[drawn])
    assert result.success and "repeat another one exactly" in result.warnings[0]
    other = estimate_absolute_pose(bearings[once], points[once])
    assert_same_answer(result, drawn, other, once)
    few = estimate_absolute_pose(np.tile(bearings[:2], (9, 1)), np.tile(points[:2], (9, 1)))
    assert few.status == "too_few_matches"
    assert few.warnings[0].startswith("16 of 18 matches repeat another one exactly")


def test_copies_do_not_make_a_camera_doubtful():
    for seed in range(10):
        made = noisy_scene(seed, 0.1, 0.2)
        drawn, once = drawn_unevenly(200, seed)
        told = [doubted(made, rows) for rows in (drawn, once)]
        np.testing.assert_allclose(told[0].covariance, told[1].covariance, rtol=1e-6)
        assert len(told[0].warnings) == 1 + len(told[1].warnings)


def doubted(made, rows):
    bearings = made.bearings1[rows], made.bearings2[rows]
    camera = Equirectangular(1024, 512)
    result = estimate_relative_pose(*bearings)
    return with_calibration_doubt(result, bearings, (camera, camera), estimate_relative_pose).result


def test_the_distinct_rows_is_named_for_each_row():
    a = np.array([[0.0, 1.0], [2.0, 3.0], [-0.0, 1.0], [0.0, 1.0], [2.0, 3.0]])
    b = np.array([[1.0], [1.0], [1.0], [5.0], [1.0]])
    first, own = distinct_rows(a, b)
    np.testing.assert_array_equal(first, [0, 1, 3])
    np.testing.assert_array_equal(own, [0, 1, 0, 2, 1])
    first, own = distinct_rows(np.zeros((0, 3)))
    assert len(first) == len(own) == 0


def test_a_few_copies_are_left():
    a = np.append(np.arange(8.0), [3.0, 5.0])[:, None]
    np.testing.assert_array_equal(distinct_rows(a), np.tile(np.arange(10), (2, 1)))
    np.testing.assert_array_equal(distinct_rows(a[3:])[0], np.arange(5))  # two of seven
    made = noisy_scene(0, 0.1)
    for num_copies, is_told in ((50, False), (70, True)):
        rows = np.append(np.arange(200), np.arange(num_copies))
        result = estimate_relative_pose(made.bearings1[rows], made.bearings2[rows])
        assert any("repeat" in each for each in result.warnings) is is_told
