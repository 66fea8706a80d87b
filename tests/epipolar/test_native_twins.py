# SPDX-License-Identifier: BSD-3-Clause
"""The compiled core equals its NumPy twins: closed forms to 1e-9 (design, section 1)."""

import numpy as np
import pytest
from exact_matches import any_pose, disturbed, exact_matches

from epi360 import Equirectangular, _core
from epi360.epipolar import (
    RESIDUALS,
    eight_point,
    essential_from_pose,
    pose_from_essential,
    pose_residuals,
    residual_jacobians,
    tangent_basis,
)
from epi360.poses import Pose, rotation_from_vector

CAMERA = Equirectangular(1024, 512)
# Around the block length of the core's loops, and one alone.
SIZES = [1, 7, 31, 32, 33, 100]


def unit(vectors):
    return np.ascontiguousarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def noisy_matches(seed, num_matches=40, noise_deg=1.0, layout="room"):
    b1, b2, pose, _ = exact_matches(seed, num_matches, layout)
    return b1, unit(disturbed(b2, noise_deg, seed)), pose


def camera_jacobians(bearings):
    return CAMERA.bearing_jacobians(CAMERA.pixels_from_bearings(bearings))


def native_residuals(b1, b2, pose, kind, jacobians1=None, jacobians2=None):
    return _core.residuals(b1, b2, pose.rotation, pose.translation, kind, jacobians1, jacobians2)


def moved(pose, change):
    t = pose.translation + tangent_basis(pose.translation) @ change[3:]
    return Pose(rotation_from_vector(change[:3]) @ pose.rotation, t / np.linalg.norm(t))


@pytest.mark.parametrize("kind", ["paper", "angular", "sampson"])
@pytest.mark.parametrize("num_matches", SIZES)
def test_native_residuals_and_jacobians_equal_the_twin(kind, num_matches):
    for seed in range(5):
        b1, b2, pose = noisy_matches(seed, num_matches)
        for tried in (pose, any_pose(seed)):
            values, jacobians = native_residuals(b1, b2, tried, kind)
            np.testing.assert_allclose(values, pose_residuals(tried, b1, b2, kind), atol=1e-9)
            np.testing.assert_allclose(
                jacobians, residual_jacobians(tried, b1, b2, kind), atol=1e-9
            )


@pytest.mark.parametrize("num_matches", SIZES)
def test_native_tangent_sampson_equals_the_twin_in_pixels(num_matches):
    for seed in range(5):
        b1, b2, pose = noisy_matches(seed, num_matches)
        J1, J2 = camera_jacobians(b1), camera_jacobians(b2)
        values, _ = native_residuals(b1, b2, pose, "tangent_sampson", J1, J2)
        expected = pose_residuals(pose, b1, b2, "tangent_sampson", J1, J2)
        np.testing.assert_allclose(values, expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_native_jacobians_of_tangent_sampson_equal_central_differences(seed):
    b1, b2, pose = noisy_matches(seed)
    # A radian a pixel at the equator, so that the numbers are of the size of the other residuals.
    J1, J2 = (1024 / (2 * np.pi) * camera_jacobians(b) for b in (b1, b2))
    _, analytic = native_residuals(b1, b2, pose, "tangent_sampson", J1, J2)

    def after(change):
        return pose_residuals(moved(pose, change), b1, b2, "tangent_sampson", J1, J2)

    numeric = np.stack([(after(1e-6 * e) - after(-1e-6 * e)) / 2e-6 for e in np.eye(5)], axis=1)
    np.testing.assert_allclose(analytic, numeric, atol=1e-6)


@pytest.mark.parametrize("kind", RESIDUALS)
def test_native_residuals_of_no_matches_are_empty(kind):
    none, J = np.empty((0, 3)), np.empty((0, 3, 2))
    values, jacobians = native_residuals(none, none, any_pose(0), kind, J, J)
    assert values.shape == (0,) and jacobians.shape == (0, 5)


@pytest.mark.parametrize("seed", range(20))
def test_native_eight_point_equals_the_twin_up_to_sign(seed):
    b1, b2, _ = noisy_matches(seed, 9 + 4 * seed)
    weights = None if seed % 2 else np.random.default_rng(seed).uniform(0.1, 1.0, len(b1))
    native = _core.eight_point(b1, b2, weights)
    twin = eight_point(b1, b2, weights=weights).E
    np.testing.assert_allclose(np.sign((native * twin).sum()) * native, twin, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("layout", ["room", "sphere", "behind"])
def test_native_pose_from_essential_equals_the_twin(seed, layout):
    b1, b2, pose = noisy_matches(seed, layout=layout)
    E = (-1.0) ** seed * (1.0 + seed) * essential_from_pose(pose)
    R, t = _core.pose_from_essential(E, b1, b2)
    twin = pose_from_essential(E, b1, b2)
    np.testing.assert_allclose(R, twin.rotation, atol=1e-9)
    np.testing.assert_allclose(t, twin.translation, atol=1e-9)


def five_matches(seed):
    """Five exact matches of any pose: the points are anywhere around both cameras."""
    rng, pose = np.random.default_rng(seed), any_pose(seed)
    points = rng.normal(size=(5, 3)) * rng.uniform(1.0, 6.0, (5, 1))
    return unit(points), unit(points @ pose.rotation.T + pose.translation), pose


def nearest(solutions, E):
    return min(min(np.abs(s - E).max(), np.abs(s + E).max()) for s in solutions)


def test_the_true_matrix_is_among_the_five_point_solutions():
    distances = []
    for seed in range(200):
        b1, b2, pose = five_matches(seed)
        distances.append(nearest(_core.five_point(b1, b2), essential_from_pose(pose)))
    # Double roots lose half of the digits: of 10,000 problems 17 are over 1e-6, none of these 200.
    assert np.max(distances) < 1e-6
    assert np.median(distances) < 1e-11


def test_every_five_point_solution_is_an_essential_matrix_that_fits_the_five_matches():
    for seed in range(200):
        b1, b2, _ = five_matches(seed)
        solutions = _core.five_point(b1, b2)
        assert 1 <= len(solutions) <= 10
        for E in solutions:
            np.testing.assert_allclose(np.linalg.norm(E), np.sqrt(2.0), atol=1e-12)
            np.testing.assert_allclose(np.einsum("ni,ij,nj->n", b2, E, b1), 0.0, atol=1e-12)
            # Demazure's ten cubics: det E = 0 and 2 E E^T E = tr(E E^T) E. See above for 1e-6.
            np.testing.assert_allclose(np.linalg.det(E), 0.0, atol=1e-6)
            np.testing.assert_allclose(2 * E @ E.T @ E, np.trace(E @ E.T) * E, atol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_five_point_takes_bearings_of_any_length(seed):
    b1, b2, pose = five_matches(seed)
    lengths = np.random.default_rng(seed).uniform(0.1, 10.0, (5, 1))
    solutions = _core.five_point(lengths * b1, b2 / lengths)
    assert nearest(solutions, essential_from_pose(pose)) < 1e-6


@pytest.mark.parametrize("seed", range(20))
def test_five_point_takes_points_behind_both_cameras(seed):
    b1, b2, pose, _ = exact_matches(seed, 5, "behind")
    assert (b1[:, 2] < 0.0).all() and (b2[:, 2] < 0.0).all()
    assert nearest(_core.five_point(b1, b2), essential_from_pose(pose)) < 1e-6


def test_five_point_refuses_another_number_of_matches():
    b1, b2, _, _ = exact_matches(0, 6)
    with pytest.raises(ValueError, match="five matches are needed"):
        _core.five_point(b1, b2)
