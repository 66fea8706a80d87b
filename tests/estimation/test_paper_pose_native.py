# SPDX-License-Identifier: BSD-3-Clause
"""The paper's estimators in the core equal their NumPy twins: closed forms to 1e-9, iterative ones
to 1e-9 in cost and 1e-6 rad in pose in 99 % of random problems.

The twins take 1 to 50 ms a problem: the six closed forms share a thousand problems, the iterative
methods see fewer. ``EPI360_TWIN_PROBLEMS=1000`` gives each of them a thousand (20 minutes).
"""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest

import epi360
from epi360 import _core, epipolar
from epi360.epipolar import SkCost, essential_from_pose, paper_residuals, search_sk
from epi360.estimation import PAPER_METHODS, paper_pose, paper_pose_reference, residual_weights
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.synthetic import two_view_scene

CLOSED = [
    ("none", "unit"),
    ("isotropic", "unit"),
    ("non_isotropic", "unit"),
    ("isotropic+non_isotropic", "unit"),
    ((1.0, 1.7), "unit"),
    ("none", "taubin"),
]
ITERATIVE = [name for name in PAPER_METHODS if name.startswith("gsm")]
FULL_RUN = os.environ.get("EPI360_TWIN_PROBLEMS")
NUM_CLOSED, NUM_SEARCHES, NUM_GOLD = (int(FULL_RUN or default) for default in (170, 200, 6))


@cache
def problem(seed):
    """8 to 400 matches, up to half of them outliers, noise from none to 3.2 degrees."""
    rng = np.random.default_rng(seed)
    scene = two_view_scene(
        seed,
        num_matches=int(rng.integers(8, 401)),
        layout=("room", "cone", "sphere")[seed % 3],
        outlier_ratio=rng.uniform(0.0, 0.5),
        noise_deg=float(rng.choice([0.0, 0.05, 0.5, 3.2])),
        noise_in_both_views=bool(seed % 2),
    )
    return scene.bearings1, scene.bearings2


def difference_up_to_sign(E, expected):
    return min(np.abs(E - expected).max(), np.abs(E + expected).max())


def pose_difference_rad(a, b):
    return np.radians(max(rotation_error_deg(a, b), translation_error_deg(a, b)))


@pytest.mark.parametrize(("normalization", "constraint"), CLOSED)
def test_native_eight_point_equals_the_twin(normalization, constraint):
    first = NUM_CLOSED * CLOSED.index((normalization, constraint))
    for seed in range(first, first + NUM_CLOSED):
        b1, b2 = problem(seed)
        native = epi360.eight_point(b1, b2, normalization, constraint)
        twin = epipolar.eight_point(b1, b2, normalization, constraint)
        # The core works on A^T A, which keeps (sigma_1 / sigma_8)^2 roundings: 1e-12 here.
        assert difference_up_to_sign(native.E, twin.E) < 1e-9
        assert (native.S, native.K) == (twin.S, twin.K)
        np.testing.assert_allclose(native.normalizer1, twin.normalizer1, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(native.normalizer2, twin.normalizer2, rtol=1e-9, atol=1e-9)


def test_native_line_search_equals_the_twin():
    costs, poses = [], []
    for seed in range(NUM_SEARCHES):
        b1, b2 = problem(seed)
        _, K, cost, count = _core.search_sk(b1, b2, "line")
        _, twin_K, twin_cost, twin_count = search_sk(b1, b2)
        costs.append(abs(cost - twin_cost) / (twin_cost + 1e-9 * len(b1)))
        E = SkCost(b1, b2).essential(1.0, twin_K)
        twin = epi360.pose_from_essential(E, b1, b2)
        poses.append(pose_difference_rad(paper_pose(b1, b2, "opt_sk"), twin))
        if cost > 1e-9 * len(b1):  # without noise all K are equally good, and rounding chooses
            assert count == twin_count
    assert np.mean(np.array(costs) < 1e-9) >= 0.99
    assert np.mean(np.array(poses) < 1e-6) >= 0.99


def test_native_lm_search_is_as_near_to_the_twin_as_the_twin_to_itself_on_shuffled_matches():
    native, shuffled = [], []
    for seed in range(40):
        b1, b2 = problem(seed)
        order = np.random.default_rng(seed).permutation(len(b1))
        cost = search_sk(b1, b2, "lm")[2]
        native.append(abs(_core.search_sk(b1, b2, "lm")[2] - cost) / (cost + 1e-9 * len(b1)))
        again = search_sk(b1[order], b2[order], "lm")[2]
        shuffled.append(abs(again - cost) / (cost + 1e-9 * len(b1)))
    # Forward differences over 1e-6 turn the last bit of a sum into 1e-10 of a step, and the steps
    # multiply it: of 300 problems 74 % agree to 1e-9 and 98 % to 1e-6; shuffled 75 % and 99 %.
    assert np.mean(np.array(native) < 1e-6) >= 0.9
    assert np.median(native) < max(1e-9, 10.0 * np.median(shuffled))


@pytest.mark.parametrize("parameterization", ["manifold", "se3"])
@pytest.mark.parametrize("method", ITERATIVE)
def test_native_gold_standard_equals_the_twin(method, parameterization):
    if parameterization == "se3" and not FULL_RUN and method.endswith("_t"):
        pytest.skip("the weights do not depend on the parameterization; in the full run")
    costs, poses = [], []
    for seed in range(1000, 1000 + NUM_GOLD):
        b1, b2 = problem(seed)
        native = paper_pose(b1, b2, method, parameterization=parameterization)
        twin = paper_pose_reference(b1, b2, method, parameterization=parameterization)
        poses.append(pose_difference_rad(native, twin))
        costs.append(relative_cost(native, twin, b1, b2, method))
    assert np.mean(np.array(poses) < 1e-6) >= 0.99
    assert np.mean(np.array(costs) < 1e-9) >= 0.99


def relative_cost(native, twin, b1, b2, method):
    """Difference of eq. 15 under the weights of the twin."""
    residuals, ours = (paper_residuals(essential_from_pose(p), b1, b2) for p in (twin, native))
    weights = weights_of(method, residuals, b1, b2)
    cost = weights @ residuals**2
    return abs(weights @ ours**2 - cost) / (cost + 1e-18 * len(b1))


def weights_of(method, last_residuals, b1, b2):
    kind = "student_t" if method.endswith("_t") else "gaussian"
    if method == "gsm":
        return np.ones(len(b1))
    if "irls" in method:
        return residual_weights(last_residuals, kind)
    E = epi360.eight_point(b1, b2, "sk" if "_sk" in method else "none").E
    if "_xi" in method:
        E = essential_from_pose(epi360.pose_from_essential(E, b1, b2))
    return residual_weights(paper_residuals(E, b1, b2), kind)


@pytest.mark.parametrize("method", PAPER_METHODS)
def test_exact_matches_give_the_exact_pose_natively(method):
    for seed in range(5):
        scene = two_view_scene(seed, num_matches=(8, 9, 30, 100, 33)[seed], layout="room")
        truth = scene.cam2_from_cam1
        pose = paper_pose(scene.bearings1, scene.bearings2, method)
        # Eight or nine matches: amplified by sigma_1 / sigma_8, squared for nine.
        np.testing.assert_allclose(pose.rotation, truth.rotation, atol=1e-8)
        t = truth.translation / np.linalg.norm(truth.translation)
        np.testing.assert_allclose(pose.translation, t, atol=1e-8)


@pytest.mark.parametrize("method", ["8pa", "opt_sk", "gsm_w_sk", "gsm_irls_sk_t"])
def test_the_result_is_the_same_to_the_last_bit_on_any_thread(method):
    def matrix(seed):
        return paper_pose(*problem(seed), method).matrix()

    alone = [matrix(seed) for seed in range(24)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(matrix, range(24)))
    np.testing.assert_array_equal(alone, together)


def test_missing_rows_lengths_and_weights_do_what_they_do_in_the_twin():
    b1, b2 = (array.copy() for array in problem(4))
    weights = np.random.default_rng(4).uniform(0.0, 2.0, len(b1))
    b1[3], b2[5, 2], weights[7] = np.nan, np.nan, 0.0
    kept = np.setdiff1d(np.arange(len(b1)), [3, 5])
    pose, same = paper_pose(3.0 * b1, 0.2 * b2), paper_pose(b1[kept], b2[kept])
    np.testing.assert_allclose(pose.matrix(), same.matrix(), atol=1e-9)
    for normalization, constraint in [*CLOSED, ("sk", "unit")]:
        native = epi360.eight_point(b1, b2, normalization, constraint, weights)
        twin = epipolar.eight_point(b1, b2, normalization, constraint, weights)
        assert difference_up_to_sign(native.E, twin.E) < 1e-9
        np.testing.assert_allclose(native.singular_values, twin.singular_values, rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "9pa"}, "method must be one of 8pa, .* got '9pa'"),
        ({"sk_search": "grid"}, "sk_search must be one of line, lm, got 'grid'"),
        ({"parameterization": "euler"}, "parameterization must be manifold or se3, got 'euler'"),
        ({"bearings1": np.ones((20, 2))}, r"bearings1 must have shape \(N, 3\), got \(20, 2\)"),
        ({"bearings2": np.ones((19, 3))}, "same length, got 20 and 19"),
        ({"bearings1": np.full((20, 3), np.nan)}, "at least 8 matches, got 0"),
    ],
)
def test_wrong_input_of_paper_pose_is_refused_by_name(arguments, message):
    bearings = np.random.default_rng(0).normal(size=(2, 20, 3))
    with pytest.raises(ValueError, match=message):
        paper_pose(**{"bearings1": bearings[0], "bearings2": bearings[1], **arguments})


def test_bearings_that_do_not_allow_a_normalization_are_refused_as_in_the_twin():
    angles = np.linspace(0.0, 3.0, 12)
    flat = np.stack([np.cos(angles), np.sin(angles), np.zeros(12)], axis=1)
    full = np.random.default_rng(0).normal(size=(12, 3))
    for module in (epi360, epipolar):
        with pytest.raises(ValueError, match="non_isotropic normalization needs bearings in three"):
            module.eight_point(flat, full, "non_isotropic")
        with pytest.raises(ValueError, match="isotropic normalization needs two directions"):
            module.eight_point(np.ones((12, 3)), full, "isotropic")
        with pytest.raises(ValueError, match="S and K must be finite and not zero"):
            module.eight_point(full, full, (0.0, 1.0))
        with pytest.raises(ValueError, match="constraint must be one of unit, taubin"):
            module.eight_point(full, full, constraint="sphere")
        with pytest.raises(ValueError, match="needs at least 8 matches, got 7"):
            module.eight_point(full[:7], full[:7])
