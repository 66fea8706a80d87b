# SPDX-License-Identifier: BSD-3-Clause
"""The eight-point RANSAC of Table 4."""

import numpy as np
import pytest

from epi360.epipolar import essential_from_pose, paper_residuals
from epi360.synthetic import two_view_scene
from epi360_paper.paper_ransac import MAX_ITERATIONS, essential_residuals, paper_ransac

RESIDUALS = ("paper", "solarte2021")


def problem(ratio=0.3, num=400, noise_deg=0.05, seed=0):
    return two_view_scene(
        seed, num_matches=num, outlier_ratio=ratio, noise_deg=noise_deg, baseline_m=1.0
    )


def true_essential(scene):
    return essential_from_pose(scene.cam2_from_cam1)


def test_eq_13_is_that_of_the_epipolar_room_without_its_sign():
    scene = problem()
    ours = essential_residuals(true_essential(scene), scene.bearings1, scene.bearings2, "paper")
    theirs = paper_residuals(true_essential(scene), scene.bearings1, scene.bearings2)
    np.testing.assert_allclose(ours, np.abs(theirs), atol=1e-12)


def test_the_authors_residual_divides_by_the_norms_of_whole_arrays():
    scene = problem(num=50)
    E, b1, b2 = true_essential(scene), scene.bearings1, scene.bearings2
    products = np.abs(np.einsum("ni,ij,nj->n", b2, E, b1))
    expected = products / (np.linalg.norm(b2) * np.linalg.norm(b1 @ E.T))
    np.testing.assert_allclose(essential_residuals(E, b1, b2, "solarte2021"), expected, atol=1e-15)


@pytest.mark.parametrize("residual", RESIDUALS)
def test_many_matrices_at_once_are_each_of_them(residual):
    scene = problem(num=30)
    many = np.random.default_rng(0).normal(size=(4, 3, 3))
    at_once = essential_residuals(many, scene.bearings1, scene.bearings2, residual)
    for E, row in zip(many, at_once, strict=True):
        alone = essential_residuals(E, scene.bearings1, scene.bearings2, residual)
        np.testing.assert_allclose(row, alone, rtol=1e-12)


@pytest.mark.parametrize("residual", RESIDUALS)
@pytest.mark.parametrize("num_iterations", [None, 500])
def test_it_keeps_the_inliers_and_few_outliers(residual, num_iterations):
    scene = problem()
    # 0.6 deg, a dozen times the noise: a sample of eight near matches turns far ones by that much.
    threshold = np.radians(0.6) / (1 if residual == "paper" else 400)
    result = paper_ransac(
        scene.bearings1,
        scene.bearings2,
        threshold,
        np.random.default_rng(0),
        residual=residual,
        num_iterations=num_iterations,
    )
    kept = result.inlier_mask
    assert kept[scene.inlier_mask].mean() > 0.9
    # A random direction is within 0.6 deg of a plane in 1 % of cases.
    assert kept[~scene.inlier_mask].mean() < 0.05
    if num_iterations is not None:
        assert result.num_iterations == num_iterations


def test_it_stops_when_a_good_sample_was_drawn_with_99_percent_confidence():
    clean, half = (
        paper_ransac(
            scene.bearings1, scene.bearings2, 0.02, np.random.default_rng(0), residual="paper"
        )
        for scene in (problem(ratio=0.0), problem(ratio=0.5))
    )
    assert clean.num_iterations < 10
    # log(0.01) / log(1 - 0.5^8) = 1177 where only the true half is found.
    assert 300 < half.num_iterations <= MAX_ITERATIONS


def test_the_printed_iterations_are_those_of_two_inlier_shares():
    """590 and 66 of Table 4 are the rule's numbers for 54.5 % and 71.4 % of inliers."""
    from epi360_paper.paper_ransac import _samples_needed

    assert _samples_needed(0.545) == pytest.approx(590, abs=5)
    assert _samples_needed(0.714) == pytest.approx(66, abs=1)
    assert _samples_needed(0.5) == MAX_ITERATIONS
    assert (_samples_needed(1.0), _samples_needed(0.0)) == (1, MAX_ITERATIONS)


def test_the_same_generator_keeps_the_same_matches():
    scene = problem()
    masks = [
        paper_ransac(
            scene.bearings1, scene.bearings2, 1e-4, np.random.default_rng(3), num_iterations=300
        ).inlier_mask
        for _ in range(2)
    ]
    np.testing.assert_array_equal(*masks)


def test_too_few_matches_are_refused():
    with pytest.raises(ValueError, match="8 matches or more, got 7"):
        paper_ransac(np.eye(3)[[0] * 7], np.eye(3)[[0] * 7], 0.1, np.random.default_rng(0))
