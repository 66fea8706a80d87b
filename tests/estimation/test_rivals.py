# SPDX-License-Identifier: BSD-3-Clause
"""Matches that two poses explain equally well: near by they are one answer, far apart they are two.

The second half of the matches is the first one in a mirror that stands between the two poses. So
both poses have the same likelihood, whatever the noise.
"""

import numpy as np
import pytest

from epi360 import estimate_relative_pose
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg

MIRROR = np.diag([-1.0, 1.0, 1.0])


def mirrored_problem(turn_deg, shift_deg, seed=0):
    """Two poses that differ by a turn about y and a shift along x, and matches of both."""
    rng = np.random.default_rng(seed)
    shift = np.radians(shift_deg) / 2.0
    one = Pose(
        rotation_from_vector([0.0, np.radians(turn_deg) / 2.0, 0.0]),
        np.array([np.sin(shift), 0.0, np.cos(shift)]),
    )
    other = Pose(MIRROR @ one.rotation @ MIRROR, MIRROR @ one.translation)
    directions = rng.normal(size=(120, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * rng.uniform(2.0, 6.0, (120, 1))
    seen = points @ one.rotation.T + one.translation
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    views = [each + 1e-3 * rng.normal(size=each.shape) for each in (directions, seen)]
    return one, other, *(np.concatenate([each, each @ MIRROR]) for each in views)


def sigmas_deg(result):
    return np.degrees(np.sqrt(np.diag(result.covariance)))


@pytest.mark.parametrize("seed", range(3))
def test_two_poses_near_by_are_one_answer_whose_uncertainty_holds_both(seed):
    one, other, b1, b2 = mirrored_problem(5.0, 0.0, seed)
    result = estimate_relative_pose(b1, b2)
    assert result.status == "ok" and result.alternatives == ()
    assert result.probability > 0.99
    errors = [rotation_error_deg(result.cam2_from_cam1, each) for each in (one, other)]
    assert min(errors) < 0.2
    # Half of the probability, or nearly so, lies 5 degrees away, about y.
    sigmas = sigmas_deg(result)
    assert 5.0 * np.sqrt(0.3) < sigmas[1] < 5.0 * np.sqrt(0.55)
    assert np.delete(sigmas, 1).max() < 0.3
    assert max(errors) < 2.0 * sigmas[1]


def test_the_uncertainty_of_the_direction_holds_both_poses_too():
    one, other, b1, b2 = mirrored_problem(4.0, 6.0)
    result = estimate_relative_pose(b1, b2)
    assert result.status == "ok"
    apart = translation_error_deg(one, other)
    assert apart == pytest.approx(6.0)
    direction = np.sqrt(np.trace(result.covariance[3:, 3:]))
    assert np.degrees(direction) == pytest.approx(6.0 * np.sqrt(0.5), abs=0.3)
    # The two tangents at t: what is uncertain lies along x.
    along = result.translation_basis.T @ [1.0, 0.0, 0.0]
    assert along @ result.covariance[3:, 3:] @ along > 0.95 * direction**2


@pytest.mark.parametrize(("turn_deg", "shift_deg"), [(0.0, 6.0), (2.5, 0.0), (2.0, 7.5)])
def test_the_uncertainty_holds_poses_that_are_nearer_too(turn_deg, shift_deg):
    _, _, b1, b2 = mirrored_problem(turn_deg, shift_deg)
    result = estimate_relative_pose(b1, b2)
    assert result.status == "ok"
    blocks = (result.covariance[:3, :3], result.covariance[3:, 3:])
    sigmas = [np.degrees(np.sqrt(np.trace(block))) for block in blocks]
    np.testing.assert_allclose(sigmas, np.sqrt(0.5) * np.array([turn_deg, shift_deg]), atol=0.5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("turn_deg", "shift_deg"), [(12.0, 0.0), (4.0, 14.0), (40.0, 30.0)])
def test_two_poses_far_apart_are_ambiguous(turn_deg, shift_deg, seed):
    one, other, b1, b2 = mirrored_problem(turn_deg, shift_deg, seed)
    result = estimate_relative_pose(b1, b2)
    assert result.status == "planar_ambiguous" and len(result.alternatives) == 1
    answers = (result.cam2_from_cam1, result.alternatives[0])
    for truth in (one, other):
        assert min(rotation_error_deg(each, truth) for each in answers) < 0.3
        assert min(translation_error_deg(each, truth) for each in answers) < 1.0
    assert sigmas_deg(result).max() < 0.3


def test_a_pose_that_moved_after_it_was_found_is_as_likely_as_its_mirror():
    _, _, b1, b2 = mirrored_problem(12.0, 10.0, 26)
    assert estimate_relative_pose(b1, b2, seed=26).status == "planar_ambiguous"


def test_fewer_matches_that_weigh_as_much_are_a_rival():
    _, _, b1, b2 = mirrored_problem(20.0, 0.0)
    half = len(b1) // 2
    twice = np.r_[np.arange(half), np.arange(half), np.arange(half, 2 * half)]
    weights = np.r_[np.ones(2 * half), np.full(half, 2.0)]
    moved = 1e-9 * np.random.default_rng(0).normal(size=b1[twice].shape)  # or they are copies
    result = estimate_relative_pose(b1[twice] + moved, b2[twice], weights=weights)
    assert result.status == "planar_ambiguous"


def test_a_pose_near_by_that_the_matches_reject_adds_nothing():
    _, _, b1, b2 = mirrored_problem(5.0, 0.0)
    fewer = slice(0, len(b1) - 60)  # half of the mirrored matches
    result = estimate_relative_pose(b1[fewer], b2[fewer])
    assert result.status == "ok"
    assert sigmas_deg(result).max() < 0.3
