# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from exact_matches import disturbed, exact_matches

from epi360 import Pose, stability
from epi360.epipolar import essential_from_pose, observation_matrix
from epi360.poses import rotation_from_vector

NAMES = ["none", "isotropic", "non_isotropic", "isotropic+non_isotropic", "sk", (2.0, 0.5)]


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def noisy(seed, num_matches=60, layout="sphere"):
    b1, b2, pose, _ = exact_matches(seed, num_matches, layout)
    return b1, unit(disturbed(b2, 1.0 + 3.0 * (seed % 3), seed)), pose


def test_singular_values_are_those_of_the_observation_matrix():
    b1, b2, _ = noisy(0)
    found = stability(b1, b2)
    s = np.linalg.svd(observation_matrix(b1, b2), compute_uv=False)
    np.testing.assert_allclose(found.singular_values, s, atol=1e-12)
    np.testing.assert_allclose(found.sigma_8, s[7], atol=1e-12)
    np.testing.assert_allclose(found.sigma_8_over_sigma_1, s[7] / s[0], atol=1e-12)
    np.testing.assert_allclose(found.sigma_9_over_sigma_8, s[8] / s[7], atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_both_sides_of_eq_10_are_equal(name):
    for seed in range(5):
        b1, b2, _ = noisy(seed, 30)
        found = stability(b1, b2, name)
        np.testing.assert_allclose(found.internal_angle_sum, found.gram_norm_squared, rtol=1e-10)


def test_eq_10_on_the_sphere_is_the_sum_over_internal_angles_as_printed():
    b1, b2, _ = noisy(2, 25)
    found = stability(b1, b2)
    beta1, beta2 = found.internal_angles_rad()
    assert beta1.shape == beta2.shape == (25, 25)
    printed = (np.cos(beta1) ** 2 * np.cos(beta2) ** 2).sum()
    np.testing.assert_allclose(found.internal_angle_sum, printed, rtol=1e-12)
    A = observation_matrix(b1, b2)
    np.testing.assert_allclose(printed, np.linalg.norm(A @ A.T) ** 2, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("layout", ["sphere", "cone", "room"])
def test_the_bound_of_eq_11_holds_with_and_without_noise(name, layout):
    for seed in range(20):
        num_matches = (8, 9, 12, 60)[seed % 4]
        b1, b2, _ = noisy(seed, num_matches, layout)
        exact = exact_matches(seed, num_matches, layout)
        for found in (stability(b1, b2, name), stability(exact.b1, exact.b2, name)):
            assert 0.0 < found.sigma_8 <= found.sigma_8_bound * (1.0 + 1e-12)


def test_the_bound_of_eq_11_by_hand():
    # All nine products of axes: A is the unit matrix, n = 9, |A A^T|^2 = 9, sigma_8 = 1. The root
    # of 8 * 9 - 81 is no number, which the bound takes as zero: sqrt(9 / 8).
    found = stability(np.repeat(np.eye(3), 3, axis=0), np.tile(np.eye(3), (3, 1)))
    assert (found.sigma_8, found.gram_norm_squared) == (1.0, 9.0)
    np.testing.assert_allclose(found.sigma_8_bound, np.sqrt(9.0 / 8.0), atol=1e-12)


@pytest.mark.parametrize("name", ["none", "non_isotropic", (1.0, 0.4)])
def test_the_bound_of_eq_12_holds_for_the_angle_between_dlt_and_truth(name):
    ratios = []
    for seed in range(40):
        exact = exact_matches(seed, 60)
        b1, b2, pose = noisy(seed)
        found = stability(b1, b2, name)
        bound = found.essential_error_bound(exact.b1, exact.b2)
        N1, N2 = found.normalizer1, found.normalizer2
        truth = np.linalg.inv(N2).T @ essential_from_pose(pose) @ np.linalg.inv(N1)
        A = observation_matrix(b1, b2) @ np.kron(N2, N1).T
        estimate = np.linalg.svd(A)[2][8]
        cosine = estimate @ truth.ravel() / np.linalg.norm(truth)
        sine = np.sqrt(max(1.0 - cosine**2, 0.0))
        assert sine <= bound
        ratios.append(sine / bound)
    assert np.median(ratios) < 0.3  # it holds, and it is loose


def test_without_noise_the_bound_of_eq_12_is_zero():
    b1, b2, _, _ = exact_matches(0, 30)
    assert stability(b1, b2, "isotropic").essential_error_bound(b1, b2) < 1e-12


def test_scaling_s_and_k_scales_sigma_8_and_nothing_that_matters():
    b1, b2, _ = noisy(1)
    once, twice = stability(b1, b2, (1.0, 0.5)), stability(b1, b2, (2.0, 1.0))
    np.testing.assert_allclose(twice.sigma_8, 4.0 * once.sigma_8, rtol=1e-12)
    for name in ("sigma_8_over_sigma_1", "sigma_9_over_sigma_8", "mean_alpha_rad"):
        np.testing.assert_allclose(getattr(twice, name), getattr(once, name), rtol=1e-10)


def test_three_kinds_of_parallax_by_hand():
    # Camera 2 is turned by 90 degrees about z: x goes to y. Bearings that do not move at all have
    # alpha = 90 degrees from the turn alone.
    turn = rotation_from_vector([0.0, 0.0, np.pi / 2])
    b1 = np.tile([[1.0, 0.0, 0.0]], (8, 1))
    b2 = b1 @ turn.T
    b2[4:] = rotation_from_vector([0.0, 0.3, 0.0]) @ [0.0, 1.0, 0.0]  # about y: stays
    b2[4:] = [np.sin(0.3), np.cos(0.3), 0.0]
    found = stability(b1, b2, cam2_from_cam1=Pose(turn, [1.0, 0.0, 0.0]))
    np.testing.assert_allclose(found.alpha_rad, [np.pi / 2] * 4 + [np.pi / 2 - 0.3] * 4)
    np.testing.assert_allclose(found.parallax_rad, [0.0] * 4 + [0.3] * 4, atol=1e-12)
    np.testing.assert_allclose(found.mean_parallax_rad, 0.15, atol=1e-12)
    np.testing.assert_allclose(found.normalized_parallax_rad, found.parallax_rad, atol=1e-12)


def test_parallax_in_the_normalised_domain_by_hand():
    # From the z axis by 45 degrees: after K = 2 the direction is (1, 0, 2).
    b1 = np.tile([[0.0, 0.0, 1.0]], (8, 1))
    b2 = np.tile([[1.0, 0.0, 1.0]], (8, 1))
    found = stability(b1, b2, (1.0, 2.0), Pose(np.eye(3), [1.0, 0.0, 0.0]))
    np.testing.assert_allclose(found.parallax_rad, np.pi / 4)
    np.testing.assert_allclose(found.normalized_parallax_rad, np.arctan(0.5))
    np.testing.assert_allclose(found.mean_alpha_rad, np.arctan(0.5))


def test_without_a_pose_there_is_no_parallax_and_missing_rows_stay_missing():
    b1, b2, pose = noisy(4)
    b1[7], b2[9, 1] = np.nan, np.nan
    found = stability(b1, b2)
    assert found.num_matches == 58
    assert np.isnan(found.parallax_rad).all() and np.isnan(found.mean_parallax_rad)
    known = stability(b1, b2, cam2_from_cam1=pose)
    for angles in (found.alpha_rad, known.parallax_rad, known.normalized_parallax_rad):
        np.testing.assert_array_equal(np.flatnonzero(np.isnan(angles)), [7, 9])
    assert 0.0 < known.mean_parallax_rad < np.pi


def test_mean_internal_angles_do_not_depend_on_the_blocks_they_are_summed_in(monkeypatch):
    b1, b2, _ = noisy(0, 50)
    beta1, beta2 = stability(b1, b2).internal_angles_rad()
    pairs = np.triu_indices(50, 1)
    expected = beta1[pairs].mean(), beta2[pairs].mean()
    monkeypatch.setitem(stability.__globals__, "_BLOCK", 7)
    found = stability(b1, b2)
    np.testing.assert_allclose(found.mean_internal_angles_rad, expected, rtol=1e-12)
    np.testing.assert_allclose(found.internal_angle_sum, found.gram_norm_squared, rtol=1e-10)


def test_a_wide_view_is_more_stable_than_a_narrow_one():
    wide = [stability(*exact_matches(s, 100)[:2]).sigma_8_over_sigma_1 for s in range(10)]
    narrow = [stability(*exact_matches(s, 100, "cone")[:2]).sigma_8_over_sigma_1 for s in range(10)]
    assert np.median(wide) > 3.0 * np.median(narrow)  # measured: 0.29 and 0.03


def test_wrong_input_is_refused_by_name():
    b1, b2, _ = noisy(0, 12)
    with pytest.raises(ValueError, match="stability needs at least 8 matches, got 7"):
        stability(b1[:7], b2[:7])
    with pytest.raises(ValueError, match="normalization must be one of none"):
        stability(b1, b2, "s_k")
    with pytest.raises(ValueError, match=r"must have the 12 rows of stability\(\), got 11"):
        stability(b1, b2).essential_error_bound(b1[1:], b2[1:])
    missing = b1.copy()
    missing[3] = np.nan
    with pytest.raises(ValueError, match="true bearings must not be NaN"):
        stability(b1, b2).essential_error_bound(missing, b2)
