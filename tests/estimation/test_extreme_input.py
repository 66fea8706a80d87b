# SPDX-License-Identifier: BSD-3-Clause
"""Numbers at the end of what a float holds, and options of odd types."""

import subprocess
import sys
import time

import numpy as np
import pytest
from noisy_problems import noisy_scene

import epi360
from epi360 import (
    Pose,
    RansacOptions,
    eight_point,
    estimate_relative_pose,
    estimate_relative_poses,
    refine_pose,
    residual_weights,
    stability,
)

SCENE = noisy_scene(0, 0.2, 0.3, num_matches=100)
B1, B2 = SCENE.bearings1, SCENE.bearings2
PAIRS = [(B1, B2)] * 2


def estimate(**options):
    return estimate_relative_pose(B1, B2, **options)


def test_an_array_of_one_number_is_that_number():
    options = RansacOptions(max_iterations=np.array(500), min_num_inliers=np.int16(6))
    expected = estimate(seed=3, max_noise_deg=3.0, options=RansacOptions(max_iterations=500))
    found = estimate(seed=np.array(3), max_noise_deg=np.array(3.0), options=options)
    np.testing.assert_array_equal(found.residuals_rad, expected.residuals_rad)
    together = estimate_relative_poses(
        PAIRS,
        seed=np.array(3),
        max_noise_deg=np.array(3.0),
        num_threads=np.array(2),
        options=options,
    )
    for each in together:
        np.testing.assert_array_equal(each.residuals_rad, expected.residuals_rad)


def test_huge_seeds_and_numbers_of_threads_are_fine():
    assert estimate(seed=2**200).success
    assert all(result.success for result in estimate_relative_poses(PAIRS, num_threads=2**80))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_iterations": 2**31 - 1}, "max_iterations must be at most 10000000, got 2147483647"),
        ({"max_iterations": 2**80}, "max_iterations must be at most 10000000, got 1208"),
        ({"max_iterations": np.array([3, 4])}, "max_iterations must be an integer, got array"),
        ({"max_iterations": None}, "max_iterations must be an integer, got None"),
        ({"min_num_inliers": 2**80}, "min_num_inliers must be at least 5"),
        ({"confidence": "high"}, "confidence must be between 0 and 1, got high"),
        ({"confidence": None}, "confidence must be between 0 and 1, got None"),
    ],
)
def test_options_beyond_their_range_are_refused_in_one_sentence(options, message):
    with pytest.raises(ValueError, match=message):
        RansacOptions(**options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 0.5}, "seed must be an integer, got 0.5"),
        ({"seed": np.array([1, 2])}, "seed must be an integer, got array"),
        ({"max_noise_deg": np.array([3.0, 4.0])}, "max_noise_deg must be a positive number"),
        ({"max_noise_deg": 10**400}, "max_noise_deg must be a positive number"),
        ({"inlier_threshold_deg": 10**400}, "inlier_threshold_deg must be"),
    ],
)
def test_odd_values_of_other_options_are_refused_in_one_sentence(options, message):
    with pytest.raises(ValueError, match=message):
        estimate(**options)


def test_many_threads_asked_for_with_a_wrong_type_are_refused():
    with pytest.raises(ValueError, match="num_threads must be a positive integer, got 1.5"):
        estimate_relative_poses(PAIRS, num_threads=1.5)


def panorama_jacobians(bearings):
    east = np.cross(bearings, [0.0, 1.0, 0.0])
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    return np.ascontiguousarray(np.stack([east, np.cross(bearings, east)], axis=2))


@pytest.mark.parametrize("unit", [1e-320, 1e-250, 1e250, 1e307])
def test_the_unit_of_the_jacobians_does_not_matter(unit):
    J1, J2 = panorama_jacobians(B1), panorama_jacobians(B2)
    results = [
        estimate(residual="tangent_sampson", jacobians1=J1 * u, jacobians2=J2 * u)
        for u in (1.0, unit)
    ]
    assert results[0].status == results[1].status == "ok"
    np.testing.assert_allclose(
        results[1].cam2_from_cam1.matrix(),
        results[0].cam2_from_cam1.matrix(),
        atol=1e-3 if unit < 1e-300 else 1e-9,  # subnormal numbers have few digits
    )


def test_jacobians_of_zero_give_no_pose_and_no_infinite_number():
    J = np.zeros((100, 3, 2))
    result = estimate(residual="tangent_sampson", jacobians1=J, jacobians2=J)
    assert not result.success
    assert not np.isinf(result.residuals_rad).any() and not np.isinf(result.covariance).any()


@pytest.mark.parametrize("length", [1e-320, 1e-308, 1e200, 1e308])
@pytest.mark.parametrize("normalization", ["none", "isotropic", "non_isotropic", "sk"])
def test_bearings_of_any_length_make_an_essential_matrix(length, normalization):
    for module in (epi360, epi360.epipolar):
        solution = module.eight_point(B1 * length, B2 * length, normalization)
        assert np.isfinite(solution.E).all()


@pytest.mark.parametrize("unit", [1e-300, 1e300])
def test_the_unit_of_the_weights_does_not_matter_to_the_eight_point_algorithm(unit):
    w = np.random.default_rng(0).uniform(0.5, 1.0, size=100)
    for module in (epi360, epi360.epipolar):
        E, scaled = (module.eight_point(B1, B2, weights=each).E for each in (w, w * unit))
        np.testing.assert_allclose(abs((E * scaled).sum()), 2.0, rtol=1e-9)
    assert np.isfinite(eight_point(B1, B2, "sk", weights=w * unit).E).all()


@pytest.mark.parametrize("kind", ["gaussian", "student_t", "mixture"])
def test_weights_of_tiny_residuals_are_numbers_and_huge_ones_are_refused(kind):
    e = np.random.default_rng(0).normal(size=50)
    for unit in (1e-320, 1e-308, 1e-90, 1e90):
        assert np.isfinite(residual_weights(e * unit, kind)).all()
    with pytest.raises(ValueError, match=r"residuals must be at most 1e\+100, got 2"):
        residual_weights(e * 1e200, kind)


@pytest.mark.parametrize("scale", [1e300, 1e-300, 10**400, 0.0, np.nan, "wide"])
def test_a_scale_that_cannot_be_squared_is_refused(scale):
    with pytest.raises(ValueError, match=r"scale must be a positive number from 1e-30 to 1e\+30"):
        refine_pose(B1, B2, SCENE.cam2_from_cam1, loss="huber", scale=scale)


@pytest.mark.parametrize("max_iterations", [2**80, -1, 1.5, None])
def test_refinement_refuses_odd_numbers_of_iterations(max_iterations):
    with pytest.raises(ValueError, match="max_iterations must be an integer, 0 or more"):
        refine_pose(B1, B2, SCENE.cam2_from_cam1, max_iterations=max_iterations)


@pytest.mark.parametrize("length", [1e-320, 1e-200, 1e200, 1e308])
def test_a_start_of_any_length_has_a_direction(length):
    R, t = SCENE.cam2_from_cam1.rotation, SCENE.cam2_from_cam1.translation
    unit = t / np.abs(t).max()
    expected = refine_pose(B1, B2, Pose(R, t)).pose
    found = refine_pose(B1, B2, Pose(R, unit * length)).pose
    atol = 1e-3 if length < 1e-300 else 1e-8
    np.testing.assert_allclose(found.matrix(), expected.matrix(), atol=atol)


def test_something_that_is_no_pose_is_refused_by_name():
    for function in (refine_pose, epi360.triangulate):
        with pytest.raises(ValueError, match="cam2_from_cam1 must be a Pose, got None"):
            function(B1, B2, None)


def test_equal_bearings_are_as_unstable_as_can_be():
    same = np.tile(B1[:1], (20, 1))
    found = stability(same, same)
    assert found.sigma_8 == pytest.approx(0.0, abs=1e-12)
    assert found.sigma_8_bound == pytest.approx(0.0, abs=1e-6)
    assert np.isfinite(found.mean_internal_angles_rad).all()


def test_a_hundred_thousand_random_matches_are_refused_in_seconds():
    b1, b2 = np.random.default_rng(0).normal(size=(2, 100_000, 3))
    start = time.process_time()
    assert not estimate_relative_pose(b1, b2).success
    assert time.process_time() - start < 5.0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits memory as Linux does")
def test_threads_that_cannot_start_are_done_without():
    program = """
import resource
import numpy as np
from epi360 import estimate_relative_poses
from epi360.synthetic import two_view_scene

scene = two_view_scene(0, noise_deg=0.2)
pairs = [(scene.bearings1, scene.bearings2)] * 100
alone = estimate_relative_poses(pairs[:1], num_threads=1)[0]
pages = int(open("/proc/self/statm").read().split()[0])
limit = pages * resource.getpagesize() + 60 * 2**20  # stacks of seven threads
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
for result in estimate_relative_poses(pairs, num_threads=100):
    np.testing.assert_array_equal(result.residuals_rad, alone.residuals_rad)
print("done")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "done\n", done.stderr
