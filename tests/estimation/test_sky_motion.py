# SPDX-License-Identifier: BSD-3-Clause
"""Clouds that drift together are no near things that the camera passes."""

import dataclasses
from functools import partial

import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.estimation import estimate_relative_pose
from epi360.estimation.sky_motion import with_ground_motion
from epi360.poses import Pose, rotation_error_deg, rotation_from_vector, translation_error_deg
from epi360.two_view import IMAGE_OPTIONS

PANORAMA = Equirectangular(2000, 1000)
NOISE = 0.0005
STEP, WIND = np.array([0.5, 0.0, 0.3]), np.array([-40.0, 0.0, 60.0])
TRUTH = Pose(rotation_from_vector([0.02, 0.4, -0.01]), STEP)
ESTIMATE = partial(estimate_relative_pose, options=IMAGE_OPTIONS, max_noise_deg=0.3)


def seen(points, pose, rng):
    """Bearings of the points from both views, with noise."""
    both = points, points @ pose.rotation.T + pose.translation
    unit = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in both)
    noisy = [each + NOISE * rng.normal(size=each.shape) for each in unit]
    return [each / np.linalg.norm(each, axis=1, keepdims=True) for each in noisy]


def meadow(step=TRUTH, num_ground=400, num_sky=900, num_things=0, seed=0):
    """A meadow 1.6 m below the camera and clouds 500 m above it, which drift."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform([-8.0, 1.6, -8.0], [8.0, 1.6, 8.0], (num_ground, 3))
    clouds = rng.uniform([-1500.0, -500.0, -1500.0], [1500.0, -500.0, 1500.0], (num_sky, 3))
    things = rng.uniform([-6.0, -2.0, -6.0], [6.0, 1.2, 6.0], (num_things, 3))
    drifting = Pose(step.rotation, step.rotation @ WIND + step.translation)
    parts = [seen(ground, step, rng), seen(clouds, drifting, rng), seen(things, step, rng)]
    return [np.concatenate(each) for each in zip(*parts, strict=True)]


def told(bearings, cameras=(PANORAMA, PANORAMA)):
    given = ESTIMATE(*bearings)
    return given, with_ground_motion(given, bearings, cameras, ESTIMATE)


@pytest.mark.parametrize("seed", range(3))
def test_the_ground_is_asked_where_the_sky_alone_agrees(seed):
    given, answer = told(meadow(seed=seed))
    assert translation_error_deg(given.cam2_from_cam1, TRUTH) > 20.0  # the wind
    poses = [answer.cam2_from_cam1, *answer.alternatives]  # those of a plane are two
    assert min(translation_error_deg(each, TRUTH) for each in poses) < 2.0
    assert rotation_error_deg(poses[0], TRUTH) < 2.0 or answer.status == "planar_ambiguous"
    assert "matches in the sky agree with a motion of their own" in answer.warnings[-1]
    assert answer.alternatives[-1] is given.cam2_from_cam1
    assert len(answer.inlier_mask) == len(given.inlier_mask)
    assert not answer.inlier_mask[400:].any()


def test_a_tripod_below_drifting_clouds_has_not_moved():
    given, answer = told(meadow(Pose(TRUTH.rotation, np.zeros(3)), num_ground=850))
    assert given.status == "ok"
    assert answer.status == "pure_rotation"
    assert rotation_error_deg(answer.cam2_from_cam1, TRUTH) < 0.1


def test_views_are_told_in_either_order():
    first, second = meadow(Pose(TRUTH.rotation, np.zeros(3)), num_ground=850)
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
