# SPDX-License-Identifier: BSD-3-Clause
"""The orderings of Robust 360-8PA that are true, and those that are not, on synthetic problems.

Each bound is for the geometric mean, over 400 problems, of the ratio of two methods' errors on the
same problem. Beside it stand the means for the seeds used here and for 400 others. Bounds lie three
standard errors or more from both, so that rounding on another machine does not cross them, and a
method that lost its advantage does.
"""

from functools import cache

import numpy as np
import pytest

from epi360.estimation import paper_pose
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.synthetic import two_view_scene

NUM_PROBLEMS = 400
# Section 5.1: 200 landmarks, von Mises-Fisher noise of 3.2 deg in view 2.
SITUATIONS = {
    "outliers": {"layout": "room", "outlier_ratio": 0.2},
    "clean": {"layout": "room"},
    "clustered": {"layout": "cone", "cone_half_angle_deg": 30.0},
}


@cache
def scenes(situation):
    options = SITUATIONS[situation]
    return [two_view_scene(seed, kappa=500.0, **options) for seed in range(NUM_PROBLEMS)]


@cache
def errors_deg(situation, method):
    """Rotation and translation error of each problem, shape (N, 2)."""
    errors = []
    for scene in scenes(situation):
        pose = paper_pose(scene.bearings1, scene.bearings2, method=method)
        truth = scene.cam2_from_cam1
        errors.append((rotation_error_deg(pose, truth), translation_error_deg(pose, truth)))
    return np.array(errors)


def ratios(situation, method, other):
    """Geometric means of the ratios of errors, rotation and translation."""
    quotients = errors_deg(situation, method) / errors_deg(situation, other)
    return np.exp(np.log(quotients).mean(axis=0))


@pytest.mark.parametrize(
    ("better", "worse", "rotation", "translation"),
    [
        # "increase the camera pose accuracy about 20 %": measured .912 .899 and .820 .796
        ("opt_sk", "8pa", 0.97, 0.91),
        # the gold standard method refines the rotation (.500 .490), hardly t (.928 .923)
        ("gsm", "8pa", 0.60, 1.03),
        # constant weights, by the 8-PA's pose: .585 .556 and .673 .638
        ("gsm_w_xi", "gsm", 0.70, 0.80),
        # ... and by E(S*, K*): .534 .508 and .563 .538
        ("gsm_w_sk", "gsm", 0.65, 0.68),
        # "our normalization reduces the effect of outliers": .913 .914 and .836 .843
        ("gsm_w_sk", "gsm_w_xi", 0.99, 0.93),
        # weights that follow the residuals: .649 .723 and .474 .508; .701 .773 and .540 .557
        ("gsm_irls_xi", "gsm_w_xi", 0.82, 0.62),
        ("gsm_irls_sk", "gsm_w_sk", 0.86, 0.68),
        # isotropic normalisation harms: .897 .896 and .686 .677
        ("8pa", "8pa_isotropic", 0.99, 0.80),
        # ... and (a) + (b) harms t, not R: 1.074 1.050 and .812 .817
        ("8pa", "8pa_isotropic_non_isotropic", 1.25, 0.93),
    ],
)
def test_with_a_fifth_of_outliers_a_method_is_more_accurate(better, worse, rotation, translation):
    measured = ratios("outliers", better, worse)
    assert measured[0] < rotation
    assert measured[1] < translation


def test_no_method_of_the_paper_beats_gaussian_irls_with_outliers_by_more_than_a_tie():
    best = errors_deg("outliers", "gsm_irls_sk")
    for method in ("8pa", "opt_sk", "gsm", "gsm_w_xi", "gsm_w_sk", "gsm_w_sk_t"):
        assert np.median(best[:, 0]) < np.median(errors_deg("outliers", method)[:, 0])
        assert np.median(best[:, 1]) < np.median(errors_deg("outliers", method)[:, 1])
    # Student t with its scale estimated is as good: .96 .98 and 1.00 1.01. Differences under 10 %
    # are ties.
    assert (ratios("outliers", "gsm_irls_sk_t", "gsm_irls_sk") > 0.88).all()


def test_student_t_weights_are_not_useless_once_their_scale_is_estimated():
    # Table 2 has 9.18 against 9.10 of plain GSM; here .368 .383 and .306 .301.
    assert (ratios("outliers", "gsm_irls_sk_t", "gsm") < 0.5).all()


def test_on_clean_spread_points_sk_gains_nothing():
    # Measured 1.012 .982 and 1.042 1.008; a gain of 10 % would be .9.
    assert (ratios("clean", "opt_sk", "8pa") > (0.94, 0.93)).all()


def test_on_clean_spread_points_robust_weights_cost_a_little():
    # Measured 1.129 1.127 and 1.124 1.103: what is thrown away carries information.
    cost = ratios("clean", "gsm_w_sk", "gsm")
    assert (cost > (1.05, 1.01)).all()
    assert (cost < 1.25).all()


def test_on_clustered_points_sk_is_far_better_than_8pa_and_whitening_better_still():
    # Measured .503 .528 and .281 .322.
    assert (ratios("clustered", "opt_sk", "8pa") < (0.62, 0.45)).all()
    # Measured .82 .83 and .78 .79: against Table 1, which has it worse than the 8-PA.
    assert (ratios("clustered", "8pa_non_isotropic", "opt_sk") < 0.92).all()


def test_on_clustered_points_weights_by_the_8pa_pose_harm():
    # Its pose is so wrong that its residuals say nothing: measured 2.15 2.00 and 2.48 2.36.
    assert (ratios("clustered", "gsm_w_xi", "gsm") > 1.6).all()
