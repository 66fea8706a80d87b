# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from walked_room import CAMERA, NUM_FRAMES, elsewhere, error_share, frames, turned

from epi360 import Equirectangular, Odometry, OdometryOptions, Pose, rotation_error_deg
from epi360.odometry.pictures import PictureWatch
from epi360.odometry.similarity import Similarity
from epi360.odometry.turning import rotation_between

# One pixel of these frames is 0.7 degrees and the nearest wall two metres away. Measured 0.2 % and
# less; the frames of real cameras are at least twice as wide.
SMALL_ERROR = 0.01


def tracked(images, **options):
    odometry = Odometry(CAMERA, **options)
    for image in images:
        odometry.add_frame(image)
    odometry.finish()
    return odometry


def statuses(odometry):
    return [result.status for result in odometry.results()]


def test_every_frame_of_a_walk_has_a_pose_near_the_truth():
    odometry = tracked(frames())
    trajectory = odometry.trajectory()
    assert trajectory.indices.tolist() == list(range(NUM_FRAMES))
    assert error_share(trajectory.positions, trajectory.indices) < SMALL_ERROR
    assert len(odometry.key_frames()) > 1
    assert len(odometry.points().positions) > 100


def test_points_are_seen_where_they_are():
    odometry = tracked(frames())
    points, key_frames = odometry.points(), odometry.key_frames()
    errors = []
    for row, number, pixel in zip(
        points.point_index, points.key_frame_index, points.pixels, strict=True
    ):
        pose = key_frames[number].cam_from_world
        ray = pose.rotation @ points.positions[row] + pose.translation
        seen = CAMERA.bearings_from_pixels(pixel[None])[0]
        errors.append(np.arccos(np.clip(ray @ seen / np.linalg.norm(ray), -1, 1)))
    assert np.median(np.degrees(errors)) < 0.2  # 0.3 pixels


def seen_errors_rad(key_frames, positions):
    """Angle between each bearing of the key frames and the landmark that it shows."""
    errors = []
    for each in key_frames:
        rays = positions(each.ids) @ each.rotation.T + each.translation
        across = np.linalg.norm(np.cross(each.bearings, rays), axis=1)
        errors.append(np.arctan2(across, np.einsum("ni,ni->n", each.bearings, rays)))
    return errors


def test_adjusting_the_whole_map_never_raises_its_own_cost():
    odometry = Odometry(CAMERA)
    for image in frames():
        odometry.add_frame(image)
    segment = odometry._segments[1]
    scale_rad = 2.0 * segment.noise.sigma_rad  # of Cauchy's loss
    used = [each.is_used.copy() for each in odometry.key_frames()]
    before = seen_errors_rad(odometry.key_frames(), segment.map.positions_of)
    odometry.finish()
    after = seen_errors_rad(odometry.key_frames(), segment.map.positions_of)
    costs = np.zeros(2)
    for rows, *pair in zip(used, before, after, strict=True):
        known = rows & np.isfinite(pair).all(axis=0)
        costs += [np.log1p((errors[known] / scale_rad) ** 2).sum() for errors in pair]
    assert costs[1] < costs[0]


def test_frames_that_waited_have_their_poses_afterwards():
    odometry = Odometry(CAMERA)
    first = [odometry.add_frame(image) for image in frames()]
    assert first[0].status == "waiting"
    assert np.isnan(first[0].cam_from_world.translation).all()
    after = odometry.results()[0]
    assert after.status == "tracked"
    assert np.isfinite(after.cam_from_world.translation).all()


def test_same_frames_give_the_same_trajectory():
    one, other = (tracked(frames()[:8]).trajectory() for _ in range(2))
    np.testing.assert_array_equal(one.positions, other.positions)


def test_camera_that_only_turns_is_said_to_turn_and_has_no_trajectory():
    odometry = tracked([turned(frames()[0], 3 * index) for index in range(10)])
    assert set(statuses(odometry)[1:]) == {"turning"}
    assert len(odometry.trajectory().indices) == 0
    assert "only turned" in odometry.results()[-1].message


def test_camera_that_stands_still_is_said_to_be_static():
    rng = np.random.default_rng(0)
    image = frames()[0].astype(int)
    noisy = [
        np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8) for _ in range(6)
    ]
    odometry = tracked(noisy)
    assert set(statuses(odometry)[1:]) == {"static"}
    assert len(odometry.key_frames()) == 0


def test_turning_on_the_spot_keeps_place_and_scale():
    seen = frames()
    turning = [turned(seen[7], 4 * index) for index in range(1, 8)]
    back = [turned(seen[7], 4 * index) for index in range(6, 0, -1)]
    odometry = tracked([*seen[:8], *turning, *back, *seen[8:]])
    trajectory = odometry.trajectory()
    count = len(turning) + len(back)
    assert statuses(odometry).count("tracked") == NUM_FRAMES + count
    walked = [*range(8), *range(8 + count, NUM_FRAMES + count)]
    assert error_share(trajectory.positions[walked], list(range(NUM_FRAMES))) < SMALL_ERROR
    step = np.linalg.norm(np.diff(trajectory.positions[:8], axis=0), axis=1).mean()
    moved = np.linalg.norm(trajectory.positions[8 : 8 + count] - trajectory.positions[7], axis=1)
    assert moved.max() < 0.1 * step
    turn = rotation_error_deg(trajectory.cam_from_world[7], trajectory.cam_from_world[14])
    assert turn == pytest.approx(7 * 4 * 360 / CAMERA.width, abs=0.2)


@pytest.mark.parametrize("length", [1, 4])
def test_black_frames_are_lost_by_number_and_the_others_are_tracked(length):
    images = list(frames())
    for index in range(8, 8 + length):
        images[index] = np.zeros_like(images[0])
    odometry = tracked(images)
    found = odometry.results()
    lost = [result.index for result in found if result.status == "lost"]
    assert lost == list(range(8, 8 + length))
    assert all(f"frame {index}: is blank" in found[index].message for index in lost)
    trajectory = odometry.trajectory()
    assert error_share(trajectory.positions, trajectory.indices) < SMALL_ERROR


def test_frames_that_cannot_be_read_are_counted_and_named():
    odometry = Odometry(CAMERA)
    for index, image in enumerate(frames()[:10]):
        if index == 6:
            odometry.skip_frame("cannot be read: it is cut off")
        else:
            odometry.add_frame(image)
    found = odometry.results()
    assert (found[6].status, found[6].index) == ("lost", 6)
    assert found[6].message == "frame 6: cannot be read: it is cut off"
    assert [result.status for result in found].count("tracked") == 9


def test_a_picture_that_changes_very_slowly_is_not_frozen_for_ever():
    camera = Equirectangular(512, 256)
    watch = PictureWatch(camera, camera, None)
    rows, columns = np.mgrid[:256, :512]
    pictures = [
        128 + 80 * np.sin(0.1 * (columns + 0.004 * step)) * np.cos(0.1 * rows) for step in range(40)
    ]
    verdicts = [watch.verdict(picture.round().astype(np.uint8)) for picture in pictures]
    assert verdicts[1] == "frozen"
    assert 2 < verdicts.count("good") < 40


def test_a_calibration_file_is_no_camera():
    with pytest.raises(ValueError, match=r"camera must be a camera, got 'a.yaml'; load_camera"):
        Odometry("a.yaml")


def test_frozen_picture_is_named_and_has_the_pose_of_the_one_before():
    images = list(frames()[:10])
    images[6:6] = [images[5]] * 3
    odometry = tracked(images)
    found = odometry.results()
    assert "frame 7: repeats the picture of frame 6" in found[7].message
    positions = odometry.trajectory().positions
    assert len(positions) == len(images)
    np.testing.assert_allclose(positions[6:9], positions[[5, 5, 5]], atol=1e-12)


def test_a_picture_is_not_said_to_repeat_a_frame_that_shows_none():
    odometry = Odometry(CAMERA)
    for image in frames()[:6]:
        odometry.add_frame(image)
    odometry.skip_frame("cannot be read")
    odometry.add_frame(np.zeros_like(frames()[0]))
    repeated = odometry.add_frame(frames()[5])
    assert repeated.message == "frame 8: repeats the picture of frame 5"
    found = odometry.results()
    assert [each.status for each in found[5:]] == ["tracked", "lost", "lost", "tracked"]
    poses = [found[index].cam_from_world.matrix() for index in (8, 5)]
    np.testing.assert_allclose(*poses, atol=1e-12)


@pytest.mark.parametrize("after", [1, 2])
def test_frozen_picture_at_the_start_is_no_key_frame_and_has_the_pose_of_the_one_before(after):
    images = list(frames()[:10])
    images[after:after] = [images[after - 1]] * 4
    odometry = tracked(images)
    assert statuses(odometry) == ["tracked"] * len(images)
    repeats = set(range(after, after + 4))
    assert not repeats & {each.index for each in odometry.key_frames()}
    positions = odometry.trajectory().positions
    np.testing.assert_allclose(positions[after : after + 4], positions[[after - 1] * 4], atol=1e-12)
    walked = [index for index in range(len(images)) if index not in repeats]
    assert error_share(positions[walked], range(10)) < SMALL_ERROR


@pytest.mark.parametrize("stamp", [0.1, float("nan"), None])
def test_time_stamps_always_grow(stamp):
    odometry = Odometry(CAMERA)
    for index, image in enumerate(frames()[:8]):
        odometry.add_frame(image, stamp if index == 5 else 0.1 * index)
    stamps = [result.timestamp_s for result in odometry.results()]
    assert (np.diff(stamps) > 0).all()
    assert "time stamp" in odometry.results()[5].message
    assert stamps[5] == pytest.approx(0.5)


def test_frames_of_another_size_are_resized_and_those_of_another_shape_are_lost():
    images = list(frames()[:10])
    images[6] = images[6][::2, ::2]
    images[8] = images[8][:, :300]
    odometry = tracked(images)
    found = odometry.results()
    assert found[6].status == "tracked" and "was resized" in found[6].message
    assert found[8].status == "lost" and "frame 8: is 300x256" in found[8].message
    assert statuses(odometry).count("tracked") == 9


def test_cut_to_another_place_begins_another_map():
    odometry = tracked([*frames(), *elsewhere()[:6]])
    assert odometry.num_segments == 2
    assert statuses(odometry)[:NUM_FRAMES] == ["tracked"] * NUM_FRAMES
    assert "tracked" not in statuses(odometry)[NUM_FRAMES:]
    assert "map 2" in odometry.results()[-1].message


def test_after_a_cut_there_and_back_the_first_map_goes_on():
    odometry = tracked([*frames()[:10], *elsewhere()[:4], *frames()[10:]])
    found = odometry.results()
    assert [result.status for result in found[14:]] == ["tracked"] * 6
    trajectory = odometry.trajectory()
    indices = [index if index < 10 else index - 4 for index in trajectory.indices]
    assert error_share(trajectory.positions, indices) < SMALL_ERROR


def test_masked_pixels_give_no_points():
    mask = np.ones((256, 512), bool)
    mask[:, 200:320] = False
    for odometry in (tracked(frames()[:8], mask=mask), Odometry(CAMERA)):
        if not odometry.key_frames():
            for image in frames()[:8]:
                odometry.add_frame(image, mask=mask)
        columns = odometry.points().pixels[:, 0]
        assert len(columns) > 0
        assert not ((columns > 201) & (columns < 319)).any()


def test_wide_frames_are_tracked_smaller_and_keep_their_pixels():
    wide = [np.repeat(np.repeat(image, 2, axis=0), 2, axis=1) for image in frames()[:8]]
    odometry = Odometry(Equirectangular(1024, 512), options=OdometryOptions(max_width=512))
    for image in wide:
        odometry.add_frame(image)
    trajectory, points = odometry.trajectory(), odometry.points()
    assert error_share(trajectory.positions, trajectory.indices) < SMALL_ERROR
    assert points.pixels[:, 0].max() > 600


def test_frames_follow_their_key_frames():
    odometry = tracked(frames()[:10])
    before = odometry.trajectory()
    turn = Pose(np.diag([-1.0, -1.0, 1.0]), np.array([1.0, 2.0, 3.0]))
    poses = [each.cam_from_world @ turn.inverse() for each in odometry.key_frames()]
    points = odometry.points().positions @ turn.rotation.T + turn.translation
    odometry.move_map(poses, points)
    expected = before.positions @ turn.rotation.T + turn.translation
    np.testing.assert_allclose(odometry.trajectory().positions, expected, atol=1e-9)
    np.testing.assert_allclose(odometry.points().positions, points, atol=1e-12)


def test_nothing_but_key_frames_may_be_moved():
    odometry = tracked(frames()[:6])
    with pytest.raises(ValueError, match="there must be"):
        odometry.move_map([], np.zeros((0, 3)))


def test_few_points_that_agree_are_enough():
    odometry = Odometry(CAMERA, options=OdometryOptions(max_points=70))
    part = np.zeros((CAMERA.height, CAMERA.width), bool)
    part[:, :180] = True
    results = [
        odometry.add_frame(image, mask=part if index >= 6 else None)
        for index, image in enumerate(frames()[:10])
    ]
    assert [result.status for result in results[6:]] == ["tracked"] * 4
    assert max(result.num_inliers for result in results[6:]) < 25
    assert error_share(odometry.trajectory().positions, range(10)) < SMALL_ERROR


@pytest.mark.parametrize(
    ("name", "value"),
    [("max_points", 0), ("min_survival", 1.0), ("window", 2), ("min_inliers", 3)],
)
def test_options_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        OdometryOptions(**{name: value})


def test_rotation_between_sees_through_things_that_move():
    rng = np.random.default_rng(3)
    bearings = rng.normal(size=(200, 3))
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    turn = rotation_between(np.eye(3), np.eye(3)[[1, 2, 0]])[0]
    seen = bearings @ turn.T
    seen[:50] = rng.permutation(seen[:50])
    rotation, left = rotation_between(bearings, seen)
    np.testing.assert_allclose(rotation, turn, atol=1e-6)
    assert np.median(left) < 1e-6


def test_frames_keep_their_distance_in_the_unit_of_their_key_frame():
    odometry = tracked(frames()[:10])
    segment = odometry._segments[1]
    index = segment.last_key_frame.index + 1
    shift = np.array([0.1, 0.2, 0.3])

    def offset():
        key_pose = segment.last_key_frame.cam_from_world
        return (segment.pose_of(index) @ key_pose.inverse()).translation

    def grow(factor):
        key_frame, smaller = (
            segment.last_key_frame,
            Similarity(1.0 / factor, np.eye(3), np.zeros(3)),
        )
        key_frame.move(smaller @ Similarity.from_pose(key_frame.cam_from_world))

    grow(2.0)
    step = Pose(np.eye(3), shift)
    segment.add_frame(index, step @ segment.last_key_frame.cam_from_world, 50)
    np.testing.assert_allclose(offset(), shift, atol=1e-12)
    grow(3.0)
    np.testing.assert_allclose(offset(), 3.0 * shift, atol=1e-12)


def test_the_mask_of_a_frame_is_checked_as_any_mask(tmp_path):
    odometry = Odometry(CAMERA)
    with pytest.raises(ValueError, match="mask must have the size of its image, 512x256, got 3x3"):
        odometry.add_frame(frames()[0], mask=np.ones((3, 3), bool))
    with pytest.raises(FileNotFoundError, match="nothing.png does not exist"):
        odometry.add_frame(frames()[0], mask=tmp_path / "nothing.png")
    half = np.zeros((256, 512), np.uint8)
    half[:, :256] = 255
    for image in frames()[:4]:
        odometry.add_frame(image, mask=half)
    columns = odometry.points().pixels[:, 0]
    assert len(columns) and columns.max() < 257
    odometry.add_frame(frames()[4], mask=np.zeros((256, 512), bool))  # nothing is left of it
    assert odometry.results()[-1].status == "lost"
