# SPDX-License-Identifier: BSD-3-Clause
"""When a pair is looked at again, and which answer stays."""

from dataclasses import replace

import numpy as np
import pytest

import epi360
from epi360.second_look import has_hope, is_precise, is_settled, prior_is_better
from epi360.synthetic import two_view_scene


@pytest.fixture(scope="module")
def result():
    scene = two_view_scene(1, num_matches=400)
    return epi360.estimate_relative_pose(scene.bearings1, scene.bearings2)


def with_sigmas(result, rotation_deg, direction_deg):
    """The result with these sigmas over all axes."""
    variances = [rotation_deg**2 / 3] * 3 + [direction_deg**2 / 2] * 2
    return replace(result, covariance=np.radians(1.0) ** 2 * np.diag(variances))


def test_only_a_pose_and_a_pure_rotation_are_settled():
    statuses = ("ok", "pure_rotation", "planar_ambiguous", "too_few_inliers", "too_few_matches")
    assert [status for status in statuses if is_settled(status)] == ["ok", "pure_rotation"]


def test_a_pose_with_a_warning_is_not_settled():
    assert not is_settled("ok", ("most inliers are on one side",))


def test_more_key_points_are_hopeless_where_the_stronger_ones_leave_no_evidence():
    assert not has_hope("too_few_inliers", 0.01)
    assert has_hope("too_few_inliers", 0.2)
    assert has_hope("too_few_inliers", np.nan)  # nobody has said how probable it is
    assert has_hope("concentrated_inliers", 0.01) and has_hope("too_few_matches", 0.0)


def test_a_pose_is_precise_below_a_tenth_and_three_tenths_of_a_degree(result):
    assert is_precise(with_sigmas(result, 0.24, 0.74))
    assert not is_precise(with_sigmas(result, 0.26, 0.74))
    assert not is_precise(with_sigmas(result, 0.24, 0.76))


def test_a_pure_rotation_needs_no_precise_direction(result):
    turned = replace(with_sigmas(result, 0.24, 90.0), status="pure_rotation")
    assert is_precise(turned)
    assert not is_precise(with_sigmas(turned, 0.26, 90.0))


def test_a_warning_or_a_failure_is_never_precise(result):
    sharp = with_sigmas(result, 0.01, 0.01)
    assert is_precise(sharp)
    assert not is_precise(replace(sharp, warnings=("something",)))
    assert not is_precise(replace(sharp, status="planar_ambiguous"))


def test_what_is_known_beforehand_adds_poses_and_takes_only_those_that_contradict_it():
    assert prior_is_better("ok", contradicts_prior=False)
    assert not prior_is_better("pure_rotation", contradicts_prior=False)
    for status in ("ok", "too_few_inliers", "planar_ambiguous"):
        assert prior_is_better(status, contradicts_prior=True)
