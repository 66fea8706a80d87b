# SPDX-License-Identifier: BSD-3-Clause
"""The paper's estimators by name: laws, hand-made truth and the orders that are measured."""

import numpy as np
import pytest
from noisy_problems import errors_deg, unit_pose

from epi360.epipolar import SkCost, eight_point, essential_from_pose, paper_residuals
from epi360.estimation import PAPER_METHODS, paper_pose_reference
from epi360.poses import rotation_from_vector
from epi360.synthetic import two_view_scene

WEIGHTED = ("gsm_w_xi", "gsm_w_sk", "gsm_irls_xi", "gsm_irls_sk")


def assert_same_pose(a, b, atol):
    np.testing.assert_allclose(a.rotation, b.rotation, atol=atol)
    np.testing.assert_allclose(a.translation, b.translation, atol=atol)


def median_errors(methods, num_scenes, **options):
    """Rotation and translation error of each method in the paper's unit, 1e-3 pi."""
    found = {method: [] for method in methods}
    for seed in range(num_scenes):
        scene = two_view_scene(seed, num_matches=200, kappa=500, **options)
        for method in methods:
            pose = paper_pose_reference(scene.bearings1, scene.bearings2, method)
            found[method].append(np.array(errors_deg(pose, unit_pose(scene))) / 0.18)
    return {method: np.median(errors, axis=0) for method, errors in found.items()}


def test_the_names_are_those_of_the_paper():
    assert PAPER_METHODS == (
        "8pa", "8pa_isotropic", "8pa_non_isotropic", "8pa_isotropic_non_isotropic", "opt_sk",
        "gsm", "gsm_w_xi", "gsm_w_sk", "gsm_irls_xi", "gsm_irls_sk",
        "gsm_w_xi_t", "gsm_w_sk_t", "gsm_irls_xi_t", "gsm_irls_sk_t",
    )  # fmt: skip


@pytest.mark.parametrize("method", PAPER_METHODS)
@pytest.mark.parametrize("layout", ["room", "behind", "cone"])
def test_exact_matches_give_the_exact_pose(method, layout):
    scene = two_view_scene(1, num_matches=40, layout=layout)
    b1 = scene.bearings1.copy()
    b1[3] = np.nan
    for sk_search in ("line", "lm") if "sk" in method else ("line",):
        found = paper_pose_reference(b1, scene.bearings2, method, sk_search)
        # Amplified by sigma_1 / sigma_8 of the normalised domain.
        assert_same_pose(found, unit_pose(scene), atol=1e-8)


@pytest.mark.parametrize("method", ["gsm", *WEIGHTED, *(f"{name}_t" for name in WEIGHTED)])
def test_the_gold_standard_is_the_same_over_se3(method):
    apart = []
    for seed in range(5):
        scene = two_view_scene(seed, num_matches=60, kappa=500, outlier_ratio=0.1)
        a, b = (
            paper_pose_reference(scene.bearings1, scene.bearings2, method, parameterization=name)
            for name in ("manifold", "se3")
        )
        apart.append(max(errors_deg(a, b)))
    # Another path may end in another minimum, so not the largest; reweighting creeps at its end.
    assert np.median(apart) < 1e-3


@pytest.mark.parametrize("method", ["8pa", "8pa_non_isotropic", "gsm", "gsm_w_xi", "gsm_irls_xi_t"])
def test_methods_without_a_frame_of_their_own_follow_turned_cameras(method):
    turn1, turn2 = rotation_from_vector([0.3, -2.0, 0.5]), rotation_from_vector([1.0, 1.0, -0.4])
    for seed in range(3):
        scene = two_view_scene(seed, num_matches=80, kappa=2000)
        before = paper_pose_reference(scene.bearings1, scene.bearings2, method)
        after = paper_pose_reference(scene.bearings1 @ turn1.T, scene.bearings2 @ turn2.T, method)
        np.testing.assert_allclose(
            after.rotation, turn2 @ before.rotation @ turn1.T, atol=1e-6
        )  # two iterations of the gold standard stop within 1e-7 of each other
        np.testing.assert_allclose(after.translation, turn2 @ before.translation, atol=1e-6)


def test_opt_sk_does_not_follow_a_turn_of_both_cameras():
    turn = rotation_from_vector([1.2, 0.5, -0.4])
    apart = []
    for seed in range(5):
        scene = two_view_scene(seed, num_matches=80, kappa=500, outlier_ratio=0.2)
        before = paper_pose_reference(scene.bearings1, scene.bearings2, "opt_sk")
        after = paper_pose_reference(scene.bearings1 @ turn.T, scene.bearings2 @ turn.T, "opt_sk")
        apart.append(np.abs(after.translation - turn @ before.translation).max())
    assert np.median(apart) > 1e-2


@pytest.mark.parametrize("method", ["8pa", "8pa_non_isotropic"])
def test_swapped_views_give_the_inverse_pose(method):
    for seed in range(5):
        scene = two_view_scene(seed, num_matches=80, kappa=2000)
        forward = paper_pose_reference(scene.bearings1, scene.bearings2, method)
        back = paper_pose_reference(scene.bearings2, scene.bearings1, method)
        assert_same_pose(back.inverse(), forward, atol=1e-9)


def test_opt_sk_lowers_the_sum_of_residuals_of_the_8pa():
    for seed in range(20):
        scene = two_view_scene(seed, num_matches=100, kappa=500, outlier_ratio=0.2)
        b1, b2 = scene.bearings1, scene.bearings2
        plain, searched = (
            np.abs(paper_residuals(eight_point(b1, b2, name).E, b1, b2)).sum()
            for name in ("none", "sk")
        )
        assert searched <= plain * (1.0 + 1e-12)


def test_the_gold_standard_lowers_the_squares_of_the_8pa_pose():
    for seed in range(10):
        scene = two_view_scene(seed, num_matches=100, kappa=500, outlier_ratio=0.1)
        b1, b2 = scene.bearings1, scene.bearings2
        before, after = (
            paper_residuals(essential_from_pose(paper_pose_reference(b1, b2, name)), b1, b2)
            for name in ("8pa", "gsm")
        )
        assert after @ after < before @ before


def test_orders_of_the_paper_that_hold_with_a_fifth_of_outliers():
    methods = ("8pa", "8pa_isotropic", "opt_sk", "gsm", "gsm_w_xi", "gsm_w_sk", "gsm_irls_sk")
    found = median_errors(methods, 30, baseline_m=1.5, outlier_ratio=0.2)
    rotation = {method: errors[0] for method, errors in found.items()}
    # Measured over 200: 8pa 33.0, isotropic 42.7, opt_sk 30.6, gsm 15.5, w_xi 7.1, w_sk 6.8, irls
    # 5.2; in translation 38.5, 63.4, 33.0, 35.4, 15.6, 14.4 and 9.7.
    assert rotation["8pa_isotropic"] > 1.1 * rotation["8pa"]
    assert rotation["opt_sk"] < rotation["8pa"]
    assert rotation["gsm"] < 0.8 * rotation["opt_sk"]
    assert rotation["gsm_w_sk"] < 0.6 * rotation["gsm"]
    assert rotation["gsm_w_sk"] < 1.1 * rotation["gsm_w_xi"]
    assert rotation["gsm_irls_sk"] < 0.9 * rotation["gsm_w_sk"]
    translation = {method: errors[1] for method, errors in found.items()}
    assert translation["gsm_w_sk"] < 0.6 * translation["gsm"]
    assert translation["opt_sk"] < translation["8pa"]


def test_on_clustered_points_whitening_beats_sk_and_sk_beats_the_8pa():
    methods = ("8pa", "8pa_non_isotropic", "opt_sk")
    found = median_errors(methods, 40, layout="cone")
    # Measured over 200: 36/77, 15/15 and 19/22.
    assert (found["opt_sk"] < 0.8 * found["8pa"]).all()
    assert (found["8pa_non_isotropic"] < 0.9 * found["opt_sk"]).all()


def test_on_clean_spread_points_no_normalisation_helps():
    methods = ("8pa", "opt_sk", "8pa_non_isotropic", "gsm")
    found = median_errors(methods, 30, baseline_m=1.0)
    for method in ("opt_sk", "8pa_non_isotropic"):
        assert (found[method] > 0.8 * found["8pa"]).all()
    assert found["gsm"][0] < found["8pa"][0]


def test_wrong_input_is_refused_by_name():
    scene = two_view_scene(0, num_matches=20)
    b1, b2 = scene.bearings1, scene.bearings2
    with pytest.raises(ValueError, match="method must be one of 8pa, .* got '5pa'"):
        paper_pose_reference(b1, b2, "5pa")
    with pytest.raises(ValueError, match="sk_search must be one of line, lm, got 'grid'"):
        paper_pose_reference(b1, b2, "8pa", "grid")
    with pytest.raises(ValueError, match="parameterization must be manifold or se3, got 'so3'"):
        paper_pose_reference(b1, b2, "8pa", parameterization="so3")
    b1 = b1[:9].copy()
    b1[:2] = np.nan
    with pytest.raises(ValueError, match="needs at least 8 matches, got 7"):
        paper_pose_reference(b1, b2[:9], "gsm_w_sk")


def test_the_search_by_lm_is_close_to_the_line():
    for seed in range(5):
        scene = two_view_scene(seed, num_matches=100, kappa=500)
        cost = SkCost(scene.bearings1, scene.bearings2)
        line, lm = (
            eight_point(scene.bearings1, scene.bearings2, "sk", sk_search=search)
            for search in ("line", "lm")
        )
        # On clean data neither search misses the minimum.
        assert cost(lm.S, lm.K) == pytest.approx(cost(line.S, line.K), rel=0.014)
