# SPDX-License-Identifier: BSD-3-Clause
"""Pictures through a lens that is taken for another one."""

import numpy as np
import pytest

import epi360
from epi360.cameras import KannalaBrandt
from epi360.estimation.calibration_doubt import CALIBRATION_QUESTION
from epi360.estimation.result import ImagePairResult, pose_sigmas_deg
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

pytestmark = pytest.mark.slow  # renders


def lens(focal):
    return KannalaBrandt(480, 480, focal, focal, 240.0, 240.0)


def at(x, z, yaw_deg):
    return Pose(rotation_from_vector([0.0, np.radians(yaw_deg), 0.0]), np.array([x, -1.5, z]))


def taken(*places):
    """Pictures of a room through a lens, and the true pose."""
    room = furnished_room(1)
    pictures = [room.render(lens(150.0), place).image for place in places]
    return pictures, places[1].inverse() @ places[0]


def answers(pictures, focal):
    return epi360.relative_pose_of_images(*pictures, camera1=lens(focal), camera2=lens(focal))


def test_a_step_through_a_lens_that_is_taken_for_a_wider_one_carries_a_doubt():
    pictures, truth = taken(at(0.1, -0.35, 0.0), at(0.5, 0.1, 20.0))
    good, doubted = answers(pictures, 150.0), answers(pictures, 142.0)
    assert good.success and not any(CALIBRATION_QUESTION in each for each in good.warnings)
    assert doubted.success and isinstance(doubted, ImagePairResult)
    (warning,) = (each for each in doubted.warnings if CALIBRATION_QUESTION in each)
    assert "angles from the axis of both images are" in warning and "smaller" in warning
    change = float(warning.split("images are ")[1].split("%")[0])
    assert change == pytest.approx(5.3, abs=1.5)
    errors = [
        epi360.rotation_error_deg(doubted.cam2_from_cam1, truth),
        epi360.translation_error_deg(doubted.cam2_from_cam1, truth),
    ]
    assert max(errors) > 0.5 and (np.array(errors) < 3.0 * np.array(pose_sigmas_deg(doubted))).all()


def test_a_turn_through_a_lens_that_is_taken_for_another_one_is_a_turn():
    pictures, truth = taken(at(0.1, -0.35, 0.0), at(0.1, -0.35, 35.0))
    for focal in (150.0, 142.0, 158.0):
        result = answers(pictures, focal)
        assert result.status == "pure_rotation" and isinstance(result, ImagePairResult)
        assert len(result.keypoints1) == result.num_matches
        (first, second), ray = result.cameras, [[300.0, 240.0]]
        assert first is second or first == second
        np.testing.assert_allclose(
            first.bearings_from_pixels(ray), lens(150.0).bearings_from_pixels(ray), atol=0.01
        )
        agreeing = np.abs(result.residuals_rad[result.inlier_mask])
        assert (agreeing <= np.radians(result.inlier_threshold_deg)).all()
        assert epi360.rotation_error_deg(result.cam2_from_cam1, truth) < (
            0.1 if focal == 150.0 else 2.5
        )
