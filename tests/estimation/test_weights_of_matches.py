# SPDX-License-Identifier: BSD-3-Clause
"""What the weights of matches mean to the robust estimator and to refinement."""

import numpy as np
import pytest
from noisy_problems import noisy_scene

from epi360 import estimate_relative_pose, refine_pose, rotation_error_deg, translation_error_deg


def two_groups(seed):
    """200 matches with few outliers, then 200 of another scene."""
    first, second = (noisy_scene(s, 0.2, 0.3, num_matches=200) for s in (seed, seed + 100))
    b1 = np.vstack([first.bearings1, second.bearings1])
    b2 = np.vstack([first.bearings2, second.bearings2])
    return first, b1, b2


def assert_same_pose(a, b, limit_deg):
    assert rotation_error_deg(a, b) < limit_deg
    assert translation_error_deg(a, b) < limit_deg


@pytest.mark.parametrize("unit", [1e-300, 1e-150, 1e150, 1e300])
def test_the_unit_of_the_weights_does_not_matter_to_the_estimator(unit):
    scene = noisy_scene(1, 0.2, 0.4, num_matches=200)
    weights = np.random.default_rng(0).uniform(0.1, 1.0, size=200)
    expected = estimate_relative_pose(scene.bearings1, scene.bearings2, weights=weights)
    found = estimate_relative_pose(scene.bearings1, scene.bearings2, weights=weights * unit)
    assert found.status == expected.status == "ok"
    assert_same_pose(found.cam2_from_cam1, expected.cam2_from_cam1, 1e-6)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("loss", ["squared", "huber", "mixture"])
@pytest.mark.parametrize("unit", [1e-300, 1e300])
def test_the_unit_of_the_weights_does_not_matter_to_refinement(loss, unit):
    scene = noisy_scene(1, 0.2, 0.0, num_matches=200)
    weights = np.random.default_rng(0).uniform(0.1, 1.0, size=200)
    arguments = scene.bearings1, scene.bearings2, scene.cam2_from_cam1
    expected = refine_pose(*arguments, loss=loss, weights=weights)
    found = refine_pose(*arguments, loss=loss, weights=weights * unit)
    assert_same_pose(found.pose, expected.pose, 1e-6)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-6)
    assert found.cost == pytest.approx(expected.cost * unit, rel=1e-6)


@pytest.mark.parametrize("little", [1e-12, 1e-4])
@pytest.mark.parametrize("seed", range(4))
def test_matches_that_weigh_next_to_nothing_leave_what_the_others_say(seed, little):
    first, b1, b2 = two_groups(seed)
    alone = estimate_relative_pose(first.bearings1, first.bearings2)
    weights = np.repeat([1.0, little], 200)
    found = estimate_relative_pose(b1, b2, weights=weights)
    assert found.status == alone.status == "ok"
    sigma_deg = np.degrees(np.sqrt(np.trace(alone.covariance)))
    assert_same_pose(found.cam2_from_cam1, alone.cam2_from_cam1, 0.3 * sigma_deg)
    assert found.noise_deg == pytest.approx(alone.noise_deg, rel=0.03)
    ratio = np.trace(found.covariance) / np.trace(alone.covariance)
    assert 0.9 < ratio < 1.1


def test_a_weight_of_two_is_not_the_evidence_of_two_matches():
    scene = noisy_scene(2, 0.2, 0.3, num_matches=100)
    b1, b2 = scene.bearings1, scene.bearings2
    once = estimate_relative_pose(b1, b2)
    heavy = estimate_relative_pose(b1, b2, weights=np.full(100, 2.0))
    np.testing.assert_array_equal(heavy.covariance, once.covariance)
    # Half of the matches weigh three times as much: together they say as much as 80.
    uneven = estimate_relative_pose(b1, b2, weights=np.tile([1.0, 3.0], 50))
    assert np.trace(uneven.covariance) > 1.05 * np.trace(once.covariance)


@pytest.mark.parametrize("seed", range(3))
def test_random_matches_prove_nothing_however_they_are_weighed(seed):
    rng = np.random.default_rng(seed)
    b1, b2 = rng.normal(size=(2, 300, 3))
    weights = 10.0 ** rng.uniform(-5.0, 0.0, size=300)
    assert not estimate_relative_pose(b1, b2, weights=weights).success


def test_one_match_that_outweighs_all_others_proves_nothing():
    scene = noisy_scene(3, 0.2, 0.3, num_matches=100)
    weights = np.ones(100)
    weights[0] = 1e5
    result = estimate_relative_pose(scene.bearings1, scene.bearings2, weights=weights)
    assert not result.success


@pytest.mark.parametrize("loss", ["squared", "huber", "cauchy", "geman_mcclure", "mixture"])
@pytest.mark.parametrize("residual", ["sampson", "solarte2021"])
def test_uneven_weights_widen_the_covariance_as_fewer_matches_do(loss, residual):
    if residual == "solarte2021" and loss == "mixture":
        pytest.skip("the mixture is not one of its losses")
    even, uneven = [], []
    for seed in range(30):
        scene = noisy_scene(seed, 0.2, 0.0, num_matches=200)
        # A tenth of the matches weighs a hundred times as much: about 22 say as much as all.
        weights = np.where(np.random.default_rng(seed).random(200) < 0.1, 100.0, 1.0)
        arguments = scene.bearings1, scene.bearings2, scene.cam2_from_cam1, residual, loss
        even.append(np.trace(refine_pose(*arguments).covariance))
        uneven.append(np.trace(refine_pose(*arguments, weights=weights).covariance))
    assert 5.0 < np.median(uneven) / np.median(even) < 16.0
