# SPDX-License-Identifier: BSD-3-Clause
"""What the noise of the bearings adds to what a pose's covariance is made of."""

import numpy as np
import pytest

from epi360 import estimate_relative_pose, translation_error_deg
from epi360._core import internals
from epi360.epipolar.residuals import residual_jacobians, tangent_basis
from epi360.estimation.covariance import FREE_RAD, bounded_inverse, errors_in_variables
from epi360.poses import Pose
from epi360.synthetic import two_view_scene

SCALE = np.radians(1.5)
KAPPA, NOISE_RAD = 500.0, 1e-4
NUM_OK = 55


def scene_of(layout, seed, num_matches=300, kappa=None):
    return two_view_scene(seed, num_matches=num_matches, layout=layout, kappa=kappa)


def unit(pose):
    return Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation))


def core_covariance(scene, pose, residual="sampson"):
    entries = internals.errors_in_variables(
        scene.bearings1, scene.bearings2, pose.rotation, pose.translation, SCALE, residual
    )
    return entries.reshape(5, 5)


@pytest.mark.parametrize("residual", ["sampson", "angular", "paper"])
@pytest.mark.parametrize("layout", ["room", "cone", "plane"])
@pytest.mark.parametrize("seed", range(3))
def test_the_core_equals_the_formula(seed, layout, residual):
    scene = scene_of(layout, seed)
    pose = unit(scene.cam2_from_cam1)
    expected = errors_in_variables(pose, scene.bearings1, scene.bearings2, SCALE, residual)
    found = core_covariance(scene, pose, residual)
    # The basis of the direction of translation is free: compare what does not depend on it.
    np.testing.assert_allclose(found[:3, :3], expected[:3, :3], rtol=1e-3, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.eigvalsh(found), np.linalg.eigvalsh(expected), rtol=1e-3, atol=1e-12
    )


@pytest.mark.parametrize("layout", ["room", "cone", "plane"])
@pytest.mark.parametrize("seed", range(3))
def test_noise_in_the_derivatives_never_makes_a_pose_surer(seed, layout):
    scene = scene_of(layout, seed)
    pose = unit(scene.cam2_from_cam1)
    J = residual_jacobians(pose, scene.bearings1, scene.bearings2)
    more = core_covariance(scene, pose) - bounded_inverse(J.T @ J / SCALE**2)
    assert np.linalg.eigvalsh(more).min() > -1e-9


def test_a_match_at_one_epipole_takes_nothing_off():
    """Its residual is zero whatever it is matched with, and its derivatives have no limit."""
    scene = scene_of("room", 0)
    pose = unit(scene.cam2_from_cam1)
    epipole = pose.rotation.T @ pose.translation
    without = core_covariance(scene, pose)
    b1 = np.vstack([scene.bearings1, epipole])
    b2 = np.vstack([scene.bearings2, [[0.0, 0.6, 0.8]]])
    entries = internals.errors_in_variables(b1, b2, pose.rotation, pose.translation, SCALE)
    assert np.trace(entries.reshape(5, 5)) == pytest.approx(np.trace(without), rel=0.1)


def test_pixels_of_one_size_are_as_noisy_as_bearings():
    scene = two_view_scene(0, num_matches=200, noise_deg=1.0, noise_in_both_views=True)
    jacobians = [
        np.stack([tangent_basis(b) for b in view]) for view in (scene.bearings1, scene.bearings2)
    ]
    bearings, pixels = (
        estimate_relative_pose(scene.bearings1, scene.bearings2, residual=name, **more).covariance
        for name, more in (
            ("sampson", {}),
            ("tangent_sampson", {"jacobians1": jacobians[0], "jacobians2": jacobians[1]}),
        )
    )
    np.testing.assert_allclose(pixels, bearings, rtol=1e-2, atol=1e-7)


@pytest.mark.parametrize("num", [3, 4])
def test_noisy_copies_of_a_few_points_leave_something_free(num):
    """Each copy seems to be a point of its own, though together they say no more than one does."""
    rng = np.random.default_rng(num)
    points = rng.normal(size=(num, 3))[np.arange(200) % num] * 3.0
    pose = Pose(np.eye(3), np.array([0.6, 0.0, 0.8]))
    b1, b2 = (noisy(rng, x) for x in (points, points + pose.translation))
    free = np.linalg.eigvalsh(errors_in_variables(pose, b1, b2, NOISE_RAD))[-(5 - num) :]
    assert (free > (0.3 * FREE_RAD) ** 2).all()
    J = residual_jacobians(pose, b1, b2)
    claimed = np.linalg.eigvalsh(np.linalg.inv(J.T @ J / NOISE_RAD**2))[-1]
    assert claimed < np.radians(15.0) ** 2  # what the derivatives alone would say


def noisy(rng, points):
    bearings = points / np.linalg.norm(points, axis=1, keepdims=True)
    bearings = bearings + rng.normal(0.0, NOISE_RAD, bearings.shape)
    return bearings / np.linalg.norm(bearings, axis=1, keepdims=True)


def test_a_narrow_cone_comes_with_the_uncertainty_that_it_has():
    """The rotation and the translation look alike in it, and so do their noises: they cancel."""
    errors, sigmas, num_ok = [], [], 0
    for seed in range(60):
        scene = scene_of("cone", seed, num_matches=400, kappa=KAPPA)
        result = estimate_relative_pose(scene.bearings1, scene.bearings2)
        num_ok += result.status == "ok"
        if result.success:
            errors.append(translation_error_deg(result.cam2_from_cam1, scene.cam2_from_cam1))
            sigmas.append(np.degrees(np.sqrt(np.trace(result.covariance[3:, 3:]))))
    assert num_ok >= NUM_OK
    ratio = np.median(np.divide(errors, sigmas))
    assert 0.5 < ratio < 1.2
