# SPDX-License-Identifier: BSD-3-Clause
"""Trajectories: timestamp tx ty tz qx qy qz qw of world_from_cam."""

import warnings

import numpy as np
import pytest

from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.interop.tum import (
    names_path,
    read_tum_trajectory,
    write_tum_names,
    write_tum_trajectory,
)
from epi360.poses import Pose, rotation_from_vector

HALF = 0.7071067811865476


@pytest.fixture
def trajectory(tmp_path):
    def write(text):
        path = tmp_path / "trajectory.txt"
        path.write_text(text)
        return path

    return write


def test_a_row_is_the_pose_of_the_camera_in_the_world(trajectory):
    """A camera at (1, 2, 3), turned by 90 degrees about z: its x axis is the world's y axis."""
    path = trajectory(
        f"# timestamp tx ty tz qx qy qz qw\n1305031102.175304 1 2 3 0 0 {HALF} {HALF}\n"
    )
    (image,) = read_tum_trajectory(path).images
    world_from_cam = image.cam_from_world.inverse()
    np.testing.assert_allclose(world_from_cam.translation, [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(world_from_cam.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    assert (image.name, image.timestamp_s) == ("1305031102.175304", 1305031102.175304)
    assert image.camera is None


def test_written_numbers_are_those_of_the_hand_made_row(tmp_path):
    rotation = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    cam_from_world = Pose(rotation, np.array([1.0, 2, 3])).inverse()
    path = tmp_path / "poses.tum"
    write_tum_trajectory(
        path, Reconstruction({}, (PosedImage("a", None, cam_from_world, 1305031102.175304),))
    )
    header, row = path.read_text().splitlines()
    assert header == "# timestamp tx ty tz qx qy qz qw"
    assert row.startswith("1305031102.175304 ")
    np.testing.assert_allclose(
        [float(word) for word in row.split()[1:]], [1, 2, 3, 0, 0, HALF, HALF], atol=1e-12
    )


@pytest.mark.parametrize("stamps", [(3.5, 0.25, 1e9), (3.5, None, 1e9), (None, None, None)])
def test_rows_have_the_times_or_all_of_them_the_index(tmp_path, stamps):
    rng = np.random.default_rng(1)
    images = tuple(
        PosedImage(
            f"{index}.jpg",
            None,
            Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)),
            stamp,
        )
        for index, stamp in enumerate(stamps)
    )
    path = tmp_path / "poses.txt"
    write_tum_trajectory(path, Reconstruction({}, images))
    after = read_tum_trajectory(path).images
    expected = [0, 1, 2] if None in stamps else sorted(stamps)
    assert [image.timestamp_s for image in after] == expected
    written = images if None in stamps else sorted(images, key=lambda image: image.timestamp_s)
    for one, other in zip(written, after, strict=True):
        np.testing.assert_allclose(
            one.cam_from_world.matrix(), other.cam_from_world.matrix(), atol=1e-12
        )


def test_an_image_without_pose_is_not_written(tmp_path):
    with pytest.raises(ValueError, match=r"image lost.jpg has no pose"):
        write_tum_trajectory(
            tmp_path / "t.txt", Reconstruction({}, (PosedImage("lost.jpg", None, Pose.nan()),))
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no rows"),
        ("# nothing\n", "has no rows"),
        ("0 1 2 3 0 0 0\n", "row 1 of .* must hold 8 values"),
        ("0 1 2 3 0 0 0 1\n1 1 2 nan 0 0 0 1\n", "row 2 of .* must hold the numbers tx,ty,tz"),
        ("0 1 2 3 0 0 0 2\n", "must hold a unit quaternion"),
        ("0 0 0 0 0 0 0 1\n0 1 0 0 0 0 0 1\n", "the time 0 is there twice"),
    ],
)
def test_a_bad_row_is_named_with_file_and_line(trajectory, text, message):
    path = trajectory(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_tum_trajectory(path)
    assert str(path) in str(caught.value)


def test_two_images_of_one_time_are_no_trajectory(tmp_path):
    pose = Pose(np.eye(3), np.zeros(3))
    images = tuple(PosedImage(name, None, pose, 5.0) for name in ("left.jpg", "right.jpg"))
    with pytest.raises(ValueError, match=r"left.jpg and right.jpg have the same time stamp"):
        write_tum_trajectory(tmp_path / "a.tum", Reconstruction({}, images))
    assert not list(tmp_path.iterdir())


def write_shots(path, names, stamps):
    """Write images whose x is their place in the list, and return what is read again."""
    images = tuple(
        PosedImage(name, None, Pose(np.eye(3), [float(index), 0, 0]), stamp)
        for index, (name, stamp) in enumerate(zip(names, stamps, strict=True))
    )
    write_tum_trajectory(path, Reconstruction({}, images))
    return read_tum_trajectory(path).images


def test_rows_without_times_are_in_the_order_of_the_names(tmp_path):
    """OpenSfM's shots are in any order; other programs take row k for frame k."""
    names = ["b/frame10.jpg", "frame2.jpg", "b/frame9.jpg", "frame10.jpg"]
    after = write_shots(tmp_path / "poses.tum", names, [None] * 4)
    assert [image.cam_from_world.translation[0] for image in after] == [2, 0, 1, 3]
    assert [image.timestamp_s for image in after] == [0, 1, 2, 3]


def test_rows_with_times_are_in_the_order_of_the_times(tmp_path):
    after = write_shots(tmp_path / "poses.tum", ["a.jpg", "b.jpg", "c.jpg"], [0.5, 20.0, 3.0])
    assert [image.timestamp_s for image in after] == [0.5, 3.0, 20.0]
    assert [image.cam_from_world.translation[0] for image in after] == [0, 2, 1]


def test_a_frame_that_is_missing_among_rows_without_times_is_warned_of(tmp_path):
    names = ["1.png", "2.png", "4.png", "5.png"]
    with pytest.warns(UserWarning, match="between 2.png and 4.png: row k is not frame k"):
        write_shots(tmp_path / "poses.tum", names, [None] * 4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_shots(tmp_path / "timed.tum", names, [1.0, 2.0, 4.0, 5.0])
        write_shots(tmp_path / "even.tum", ["5.png", "10.png", "15.png"], [None] * 3)


def fps_shots(path, names, fps, stamps=None):
    """Times and names of what is written for images whose x is their place in the list."""
    images = tuple(
        PosedImage(name, None, Pose(np.eye(3), [float(index), 0, 0]), stamp)
        for index, (name, stamp) in enumerate(
            zip(names, stamps or [None] * len(names), strict=True)
        )
    )
    reconstruction = Reconstruction({}, images)
    write_tum_trajectory(path, reconstruction, fps=fps)
    write_tum_names(names_path(path), reconstruction, fps=fps)
    rows = [line.split(" ", 1) for line in names_path(path).read_text("utf-8").splitlines()[1:]]
    assert [row[0] for row in rows] == [image.name for image in read_tum_trajectory(path).images]
    return [(float(time), name) for time, name in rows]


def test_times_come_from_the_frames_a_second_where_images_have_none(tmp_path):
    """Without them one frame that the map left out would shift all later rows by a frame."""
    path = tmp_path / "poses.tum"
    assert names_path(path).name == "poses_names.txt"
    names = ["10.png", "1 b.png", "2.png"]
    assert fps_shots(path, names, 4) == [(0, "1 b.png"), (0.25, "2.png"), (0.5, "10.png")]
    names = ["f_0002.png", "f_0004.png", "f_0003.png", "f_0007.png"]
    times = [time for time, _ in fps_shots(path, names, 4)]
    assert times == [0, 0.25, 0.5, 1.25]
    every_tenth = ["30.jpg", "10.jpg", "20.jpg", "50.jpg"]
    assert [time for time, _ in fps_shots(path, every_tenth, 2)] == [0, 0.5, 1, 2]
    known = fps_shots(path, ["b", "a"], 2, [7.5, 9.0])
    assert known == [(7.5, "b"), (9, "a")]


def test_the_names_beside_a_trajectory_without_times_have_its_row_numbers(tmp_path):
    assert fps_shots(tmp_path / "p.txt", ["x/2.jpg", "x/1.jpg"], None) == [
        (0, "x/1.jpg"),
        (1, "x/2.jpg"),
    ]
    assert (tmp_path / "p_names.txt").read_text() == "# timestamp filename\n0 x/1.jpg\n1 x/2.jpg\n"


@pytest.mark.parametrize("fps", [0, -1, float("nan"), float("inf")])
def test_frames_a_second_must_be_positive(tmp_path, fps):
    with pytest.raises(ValueError, match="fps must be positive"):
        fps_shots(tmp_path / "p.txt", ["a", "b"], fps)
    assert not list(tmp_path.iterdir())
