# SPDX-License-Identifier: BSD-3-Clause
"""Poses between known ones, and 16-bit pictures on 8 bits: laws of the data set readers."""

import cv2
import numpy as np
import pytest

from epi360.poses import Pose, rotation_error_deg, rotation_from_vector
from epi360_paper.datasets import intensities, trajectories

BEFORE = Pose(rotation_from_vector([0.1, -0.4, 0.2]), np.array([1.0, 2.0, 3.0]))
TURN = rotation_from_vector([0.0, np.radians(80.0), 0.0])
AFTER = Pose(BEFORE.rotation @ TURN, np.array([2.0, 0.0, 3.0]))


@pytest.mark.parametrize(("share", "expected"), [(0.0, BEFORE), (1.0, AFTER)])
def test_the_ends_of_an_interpolation_are_the_known_poses(share, expected):
    found = trajectories.interpolate_pose(BEFORE, AFTER, share)
    np.testing.assert_allclose(found.matrix(), expected.matrix(), atol=1e-12)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
def test_a_pose_between_turns_and_moves_in_proportion(share):
    found = trajectories.interpolate_pose(BEFORE, AFTER, share)
    assert rotation_error_deg(found, BEFORE) == pytest.approx(80.0 * share, abs=1e-9)
    assert rotation_error_deg(found, AFTER) == pytest.approx(80.0 * (1 - share), abs=1e-9)
    np.testing.assert_allclose(found.translation, (1 + share, 2 - 2 * share, 3.0), atol=1e-12)


def test_backwards_in_time_is_the_same_way():
    there = trajectories.interpolate_pose(BEFORE, AFTER, 0.3)
    back = trajectories.interpolate_pose(AFTER, BEFORE, 0.7)
    np.testing.assert_allclose(there.matrix(), back.matrix(), atol=1e-12)


def test_times_outside_and_in_gaps_have_no_pose_and_known_times_theirs():
    known = np.array([0, 10, 100], np.int64) + 10**18  # nanoseconds do not fit into a float
    poses = [BEFORE, AFTER, BEFORE]
    wanted = np.array([-1, 0, 5, 10, 50, 100, 101], np.int64) + 10**18
    found = trajectories.poses_at_times(known, poses, wanted, max_gap_ns=20)
    assert [pose is None for pose in found] == [True, False, False, False, True, False, True]
    assert (found[1], found[3], found[5]) == (BEFORE, AFTER, BEFORE)
    halfway = trajectories.interpolate_pose(BEFORE, AFTER, 0.5)
    np.testing.assert_allclose(found[2].matrix(), halfway.matrix(), atol=1e-12)


def written(path, picture):
    assert cv2.imwrite(str(path), picture)
    return path


@pytest.fixture
def ramp(tmp_path):
    """16-bit grey values 0, 100, 200, ..., 25500 in one row of pixels, in all three channels."""
    values = 100 * np.arange(256, dtype=np.uint16)
    return written(tmp_path / "ramp.png", np.repeat(values, 3).reshape(1, 256, 3))


def test_levels_become_black_and_white_with_the_square_root_between_them(ramp):
    picture = intensities.eight_bit_image(ramp, (500.0, 10_500.0))
    assert picture.dtype == np.uint8 and picture.shape == (1, 256, 3)
    grey = picture[0, :, 0].astype(int)
    assert (grey[:6] == 0).all() and (grey[105:] == 255).all()
    assert grey[30] == round(255 * np.sqrt(0.25))  # 3,000 is a quarter of the way
    assert (np.diff(grey) >= 0).all()


def test_eight_bit_pictures_keep_their_values_and_ask_for_no_levels(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (8, 16, 3), dtype=np.uint8)
    path = written(tmp_path / "a.png", picture)
    assert intensities.intensity_levels([path]) is None
    found = intensities.eight_bit_image(path, (0.0, 1.0))
    np.testing.assert_array_equal(found, picture[:, :, ::-1])  # OpenCV writes blue first


def test_levels_leave_out_the_rim_the_darkest_and_the_brightest(tmp_path):
    rng = np.random.default_rng(1)
    picture = np.zeros((100, 200), np.uint16)
    picture[:, 100:] = rng.integers(1000, 2001, (100, 100))  # half of it is black rim
    picture[0, 100] = 60_000  # a lamp
    black, white = intensities.intensity_levels([written(tmp_path / "a.png", picture)])
    assert black == pytest.approx(1010, abs=5)
    assert white == pytest.approx(1995, abs=5)


def test_black_pictures_have_no_levels(tmp_path):
    path = written(tmp_path / "a.png", np.zeros((8, 16), np.uint16))
    with pytest.raises(ValueError, match="got black images only"):
        intensities.intensity_levels([path])


def test_brightness_is_a_mean_in_the_unit_of_the_file_under_the_mask(ramp):
    assert intensities.mean_brightness(ramp) == pytest.approx(12_750, abs=1)
    first_half = np.zeros((1, 256), bool)
    first_half[0, :128] = True
    assert intensities.mean_brightness(ramp, first_half) == pytest.approx(6350, abs=1)
