# SPDX-License-Identifier: BSD-3-Clause
"""Clouds that drift together are no near things that the camera passes."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from drifting_clouds import STEP, TURN, meadow

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.estimation import estimate_relative_pose
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.sky_motion import with_ground_motion
from epi360.poses import rotation_error_deg, translation_error_deg

PANORAMA = Equirectangular(2000, 1000)
ESTIMATE = partial(estimate_relative_pose, options=IMAGE_OPTIONS, max_noise_deg=0.3)


def told(bearings, cameras=(PANORAMA, PANORAMA)):
    given = ESTIMATE(*bearings)
    return given, with_ground_motion(given, bearings, cameras, ESTIMATE)


@pytest.mark.parametrize("seed", range(3))
def test_the_ground_is_asked_where_the_sky_alone_agrees(seed):
    given, answer = told(meadow(seed=seed))
    assert translation_error_deg(given.cam2_from_cam1, STEP) > 20.0  # the wind
    poses = [answer.cam2_from_cam1, *answer.alternatives]  # those of a plane are two
    assert min(translation_error_deg(each, STEP) for each in poses) < 2.0
    assert rotation_error_deg(poses[0], STEP) < 2.0 or answer.status == "planar_ambiguous"
    assert "matches in the sky agree with a motion of their own" in answer.warnings[-1]
    assert not any("missing" in warning for warning in answer.warnings)
    assert 300 < np.isfinite(answer.residuals_rad[:400]).sum()
    assert np.isnan(answer.residuals_rad[400:]).all()
    assert len(answer.inlier_mask) == len(given.inlier_mask)
    assert not answer.inlier_mask[400:].any()


def test_a_tripod_below_drifting_clouds_has_not_moved():
    given, answer = told(meadow(TURN, num_ground=850))
    assert given.status == "ok"
    assert answer.status == "pure_rotation"
    assert rotation_error_deg(answer.cam2_from_cam1, STEP) < 0.1


def test_views_are_told_in_either_order():
    first, second = meadow(TURN, num_ground=850)
    assert told((second, first))[1].status == "pure_rotation"


def test_a_pose_stays_where_other_things_agree_with_it():
    """A room: much of what has parallax is below the horizon."""
    given, answer = told(meadow(num_sky=0, num_things=500))
    assert given.success and answer is given
    given, answer = told(meadow(num_ground=30))  # too few to ask
    assert answer is given


def test_lenses_and_bare_answers_are_left_alone():
    lens = KannalaBrandt(800, 800, 250.0, 250.0, 400.0, 400.0)
    bearings = meadow()
    given = ESTIMATE(*bearings)
    assert with_ground_motion(given, bearings, (lens, lens), ESTIMATE) is given
    refused = dataclasses.replace(given, status="too_few_inliers")
    assert with_ground_motion(refused, bearings, (PANORAMA, PANORAMA), ESTIMATE) is refused


def test_missing_matches_are_neither_sky_nor_ground():
    bearings = meadow()
    bearings[0][::7] = np.nan
    _, answer = told(bearings)
    assert "in the sky" in answer.warnings[-1]
