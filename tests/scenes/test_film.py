# SPDX-License-Identifier: BSD-3-Clause
"""What a real camera adds to rendered pictures, and paths that return to their start."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import handheld_path, scene
from epi360_scenes.film import BAND_PX, Effects, Film, _gains, pose_at
from epi360_scenes.people import People

CAMERA = Equirectangular(width=96, height=48)


@pytest.fixture(scope="module")
def room():
    return scene("living_room")


@pytest.fixture(scope="module")
def path(room):
    return handheld_path(room, 30, max_turn_deg=6.0)


def film(room, path, **effects):
    return Film(room, CAMERA, path, Effects(**effects))


def test_without_effects_a_frame_is_the_picture_of_its_pose(room, path):
    plain = room.render(CAMERA, path[3])
    frame = film(room, path).frame(3)
    np.testing.assert_array_equal(frame.image, plain.image)
    np.testing.assert_array_equal(frame.depth, plain.depth)


def test_blur_mixes_the_light_around_the_pose_of_the_frame(room, path):
    turning = [
        path[0] @ Pose(rotation_from_vector([0, 0.35 * k, 0]), np.zeros(3)) for k in range(4)
    ]
    sharp, blurred = (film(room, turning, motion_blur=count).frame(2) for count in (1, 5))
    np.testing.assert_array_equal(blurred.depth, sharp.depth)

    def gradient(image):
        return np.abs(np.diff(image.astype(float), axis=1)).mean()

    assert gradient(blurred.image) < 0.8 * gradient(sharp.image)
    assert blurred.image.mean() == pytest.approx(sharp.image.mean(), abs=2.0)
    still = film(room, [path[0]] * 3)
    mixed = film(room, [path[0]] * 3, motion_blur=3)
    difference = still.frame(1).image.astype(int) - mixed.frame(1).image
    assert np.abs(difference).max() <= 1


def test_rows_of_a_rolling_shutter_are_those_of_their_own_poses(room, path):
    rolling = film(room, path, rolling_shutter_ms=20.0).frame(9)
    for top in range(0, CAMERA.height, BAND_PX):
        time = 9 + 0.6 * ((top + BAND_PX / 2) / CAMERA.height - 0.5)
        band = room.render(CAMERA, pose_at(path, time))
        rows = slice(top, top + BAND_PX)
        np.testing.assert_array_equal(rolling.image[rows], band.image[rows])
        np.testing.assert_array_equal(rolling.depth[rows], band.depth[rows])


def test_exposure_changes_smoothly_by_so_many_stops(room, path):
    changing = Film(room, CAMERA, path * 10, Effects(exposure_change=2.0))
    gains = changing._gains
    assert 1.3 < np.log2(gains.max() / gains.min()) <= 2.0
    assert np.abs(np.diff(np.log2(gains))).max() < 0.25
    darkest, brightest = int(np.argmin(gains)), int(np.argmax(gains))
    still = Film(room, CAMERA, [path[0]] * 300, Effects(exposure_change=2.0))
    assert still.frame(darkest).image.mean() < 0.8 * still.frame(brightest).image.mean()


def test_people_walk_and_keep_away_from_the_camera(room, path):
    people = People(room, path, 3, seed=0, step_m=0.04)
    for person in range(3):
        places = np.array([people.place(person, time) for time in np.arange(0, 29, 0.5)])
        camera = np.array([pose_at(path, time).translation for time in np.arange(0, 29, 0.5)])
        assert np.linalg.norm(places - camera[:, [0, 2]], axis=1).min() > 0.799
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        assert steps.sum() > 0.3 and steps.max() < 0.2


def test_people_change_a_small_part_of_the_picture_and_move_in_it(room, path):
    still = [path[0]] * 30
    empty = film(room, still).frame(0).image
    people = film(room, still, moving_people=2)
    first, last = people.frame(0), people.frame(29)
    for frame in (first, last):
        share = (np.abs(frame.image.astype(int) - empty).max(axis=2) > 8).mean()
        assert 0.002 < share < 0.3
    assert (np.abs(first.image.astype(int) - last.image).max(axis=2) > 8).mean() > 0.002


def test_a_pose_between_two_is_half_of_the_way_and_of_the_turn():
    poses = [
        Pose(np.eye(3), np.zeros(3)),
        Pose(rotation_from_vector([0, 0.4, 0]), np.array([1.0, 2.0, 4.0])),
    ]
    middle = pose_at(poses, 0.5)
    np.testing.assert_allclose(middle.rotation, rotation_from_vector([0, 0.2, 0]), atol=1e-12)
    np.testing.assert_allclose(middle.translation, [0.5, 1.0, 2.0])
    assert pose_at(poses, -0.3) is poses[0]
    np.testing.assert_allclose(pose_at(poses, 1.7).translation, poses[1].translation)


@pytest.mark.parametrize("num_frames", [200, 600])
def test_a_loop_returns_to_its_start_in_steps_that_are_small(room, num_frames):
    poses = handheld_path(room, num_frames, 2, loop=True)
    assert len(poses) == num_frames
    np.testing.assert_allclose(poses[-1].matrix(), poses[0].matrix(), atol=1e-9)
    positions = np.array([pose.translation for pose in poses])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert steps.max() <= 0.04 + 1e-9 and steps.sum() > 0.5 * 0.04 * num_frames
    assert room.distances(positions).min() >= 0.34
    turns = [a.rotation.T @ b.rotation for a, b in zip(poses[:-1], poses[1:], strict=True)]
    assert max(np.degrees(np.arccos(min(1.0, (np.trace(t) - 1) / 2))) for t in turns) <= 2.001
    # It is a loop of its own, not a way there and the same way back.
    assert np.linalg.norm(positions - positions[0], axis=1).max() > 1.0


def test_a_loop_of_too_few_frames_is_refused(room):
    with pytest.raises(ValueError, match="num_frames must be more for a loop"):
        handheld_path(room, 5, loop=True)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"moving_people": -1}, "moving_people must be 0 or more"),
        ({"exposure_change": 9.0}, "exposure_change must be 0 to 8 stops"),
        ({"motion_blur": 2}, "motion_blur must be odd"),
        ({"moving_people": 10**6}, "moving_people must be at most 100"),
        ({"motion_blur": 100_001}, "motion_blur must be at most 99"),
        ({"rolling_shutter_ms": 40.0}, "rolling_shutter_ms must be 0 to 33.3"),
    ],
)
def test_effects_out_of_range_are_refused(effects, message):
    with pytest.raises(ValueError, match=message):
        Effects(**effects)


@pytest.mark.parametrize(("num_frames", "least"), [(10, 0.0), (300, 1.0)])
def test_the_exposure_changes_by_no_more_than_asked_for(num_frames, least):
    for seed in range(20):
        gains = _gains(num_frames, 2.0, seed)
        assert least < np.log2(gains.max() / gains.min()) <= 2.0
