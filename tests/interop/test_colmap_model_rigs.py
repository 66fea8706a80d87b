# SPDX-License-Identifier: BSD-3-Clause
"""Rigs and frames of sparse models: COLMAP's own, through our reader and writer and back."""

from dataclasses import replace

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.cli import main
from epi360.interop import PosedImage, Reconstruction
from epi360.interop.colmap_model import read_colmap_model, write_colmap_model
from epi360.interop.convert import lost
from epi360.poses import Pose, rotation_from_vector

pycolmap = pytest.importorskip("pycolmap")

KINDS = pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
FRONT = Pose(rotation_from_vector([0, 0.2, 0]), [0.1, 0, 0])
BACK = Pose(rotation_from_vector([0, 3.0, 0]), [0, 0, 0.2])
TOP = Pose(rotation_from_vector([1.5, 0, 0]), [0, -0.3, 0])
RIG = {"front": FRONT, "back": BACK, "top": TOP}


@pytest.fixture
def theirs(tmp_path):
    """Model of COLMAP: rigs of several cameras, the reference not the first, other ids."""

    def theirs(text=False, **options):
        dataset = pycolmap.SyntheticDatasetOptions()
        dataset.num_points3D = 20
        for name, value in options.items():
            setattr(dataset, name, value)
        model = pycolmap.synthesize_dataset(dataset)
        folder = tmp_path / "theirs"
        folder.mkdir()
        (model.write_text if text else model.write_binary)(folder)
        return model, folder

    return theirs


def reconstruction(moments=3):
    """Three cameras on a rig, given in another order than the rig's, and a fourth one alone."""
    cameras = dict.fromkeys(("back", "alone", "top", "front"), Equirectangular(100, 50))
    rng = np.random.default_rng(0)
    images = []
    for moment in range(moments):
        rig_from_world = Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
        images += [
            PosedImage(f"{name}/{moment}.jpg", name, pose @ rig_from_world, frame=f"at {moment} s")
            for name, pose in RIG.items()
        ]
    images.append(PosedImage("alone.jpg", "alone", FRONT, frame="at 0 s"))
    return Reconstruction(cameras, tuple(images), cam_from_rig=RIG)


def assert_poses(folder, expected):
    """COLMAP's poses, from the frames and rigs, are those of the images."""
    model = pycolmap.Reconstruction(folder)
    assert model.num_reg_images() == len(expected.images)
    poses = {image.name: image.cam_from_world().matrix() for image in model.images.values()}
    for image in expected.images:
        pose = image.cam_from_world.matrix()[:3]
        np.testing.assert_allclose(poses[image.name], pose, rtol=0, atol=1e-9)
    return model


@KINDS
@pytest.mark.parametrize("num_rigs", [1, 2])
def test_a_rig_of_colmap_comes_back(theirs, tmp_path, capsys, text, num_rigs):
    model, source = theirs(
        text, num_rigs=num_rigs, num_cameras_per_rig=2, num_frames_per_rig=20 // num_rigs
    )
    target = tmp_path / "ours"
    assert main(["convert", str(source), str(target)]) == 0
    assert "not kept" not in capsys.readouterr().out
    again = pycolmap.Reconstruction(target)
    assert again.num_rigs() == num_rigs
    assert again.num_frames() == again.num_reg_frames() == 20
    assert again.num_reg_images() == 40
    for rig_id, rig in model.rigs.items():
        found = again.rigs[rig_id]
        assert found.ref_sensor_id == rig.ref_sensor_id
        assert set(found.non_ref_sensors) == set(rig.non_ref_sensors)
        for sensor, pose in rig.non_ref_sensors.items():
            found_pose = found.sensor_from_rig(sensor).matrix()
            np.testing.assert_allclose(found_pose, pose.matrix(), rtol=0, atol=1e-9)
    for image_id, image in model.images.items():
        assert again.images[image_id].name == image.name
        assert again.images[image_id].frame_id == image.frame_id
        pose = image.cam_from_world().matrix()
        found_pose = again.images[image_id].cam_from_world().matrix()
        np.testing.assert_allclose(found_pose, pose, rtol=0, atol=1e-9)


@KINDS
def test_what_is_read_of_a_rig_is_what_colmap_has(theirs, text):
    model, folder = theirs(text, num_rigs=1, num_cameras_per_rig=3, num_frames_per_rig=2)
    found = read_colmap_model(folder)
    assert list(found.cam_from_rig) == ["1", "2", "3"]
    np.testing.assert_array_equal(found.cam_from_rig["1"].matrix(), np.eye(4))
    for sensor, pose in model.rigs[1].non_ref_sensors.items():
        found_pose = found.cam_from_rig[str(sensor.id)].matrix()[:3]
        np.testing.assert_allclose(found_pose, pose.matrix(), rtol=0, atol=1e-12)
    assert [image.frame for image in found.images] == ["1"] * 3 + ["2"] * 3


@KINDS
def test_cameras_alone_are_no_rig(theirs, text):
    _, folder = theirs(text, num_rigs=2, num_cameras_per_rig=1, num_frames_per_rig=2)
    found = read_colmap_model(folder)
    assert not found.cam_from_rig and {image.frame for image in found.images} == {None}


@KINDS
def test_colmap_reads_our_rig_beside_a_camera_alone(tmp_path, text):
    given = reconstruction()
    write_colmap_model(tmp_path, given, text=text)
    model = assert_poses(tmp_path, given)
    assert model.num_rigs() == 2 and model.num_frames() == 4
    (rig,) = (rig for rig in model.rigs.values() if rig.num_sensors() == 3)
    assert rig.ref_sensor_id.id == 4  # front, the first of the rig, is the fourth camera
    back_from_front = rig.sensor_from_rig(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, 1))
    expected = (BACK @ FRONT.inverse()).matrix()[:3]
    np.testing.assert_allclose(back_from_front.matrix(), expected, rtol=0, atol=1e-12)
    assert not lost(given, "colmap")


@KINDS
@pytest.mark.parametrize("camera", ["front", "top"])
def test_an_image_that_was_moved_keeps_its_pose(tmp_path, camera, text):
    given = reconstruction()
    moved = tuple(
        replace(image, cam_from_world=TOP @ image.cam_from_world)
        if image.name == f"{camera}/1.jpg"
        else image
        for image in given.images
    )
    given = replace(given, images=moved)
    write_colmap_model(tmp_path, given, text=text)
    model = assert_poses(tmp_path, given)
    assert model.num_rigs() == 2 and model.num_frames() == 5
    counts = sorted(frame.num_data_ids() for frame in model.frames.values())
    assert counts == [1, 1, 2, 3, 3]
    assert lost(given, "colmap") == ["parts of rigs"]


def test_a_rig_that_no_frame_fits_is_left_out_and_said(tmp_path):
    given = reconstruction()
    wrong = dict(zip(RIG, (TOP, FRONT, BACK), strict=True))
    given = replace(given, cam_from_rig=wrong)
    write_colmap_model(tmp_path, given)
    model = assert_poses(tmp_path, given)
    assert model.num_rigs() == 4 and model.num_frames() == 10
    assert lost(given, "colmap-text") == ["parts of rigs"]


@KINDS
def test_poses_far_from_the_origin_fit_their_rig(tmp_path, text):
    given = reconstruction()
    far = Pose(np.eye(3), [5e5, 5e6, 100.0])  # UTM, in metres
    images = tuple(
        replace(image, cam_from_world=image.cam_from_world @ far) for image in given.images
    )
    write_colmap_model(tmp_path, replace(given, images=images), text=text)
    assert pycolmap.Reconstruction(tmp_path).num_frames() == 4


def test_ids_of_frames_are_kept_and_those_of_others_are_free(tmp_path):
    given = reconstruction()
    names = {"at 0 s": "7", "at 1 s": "2", "at 2 s": "later"}
    images = tuple(replace(image, frame=names[image.frame]) for image in given.images)
    write_colmap_model(tmp_path / "a", replace(given, images=images))
    again = read_colmap_model(tmp_path / "a")
    assert [image.frame for image in again.images[::3]] == ["7", "2", "1", None]
    write_colmap_model(tmp_path / "b", again, text=True)
    found = [image.frame for image in read_colmap_model(tmp_path / "b").images]
    assert found == [image.frame for image in again.images]
    assert sorted(pycolmap.Reconstruction(tmp_path / "b").frames) == [1, 2, 3, 7]


def test_an_image_without_its_neighbours_is_still_of_the_rig(tmp_path):
    given = reconstruction()
    given = replace(given, images=given.images[2:])  # of the first frame only top is there
    write_colmap_model(tmp_path, given)
    model = assert_poses(tmp_path, given)
    assert model.num_rigs() == 2 and model.num_frames() == 4 and not lost(given, "colmap")


def test_rigs_whose_cameras_share_no_frame_are_said(tmp_path):
    given = reconstruction()
    given = replace(given, images=given.images[::4])  # one image a moment
    write_colmap_model(tmp_path, given)
    assert assert_poses(tmp_path, given).num_rigs() == 4
    assert lost(given, "colmap") == ["parts of rigs"]


@pytest.mark.parametrize("name", ["nerfstudio", "opensfm", "tum"])
def test_formats_without_rigs_say_so(name):
    given = reconstruction()
    assert "rigs" in lost(given, name)
    assert "rigs" not in lost(replace(given, cam_from_rig={}), name)


def test_a_frame_with_two_images_of_one_camera_is_refused(tmp_path):
    given = reconstruction()
    images = tuple(replace(image, frame="same") for image in given.images)
    with pytest.raises(ValueError, match="frame 'same' must have one image a camera"):
        write_colmap_model(tmp_path / "model", replace(given, images=images))
    assert not list(tmp_path.iterdir())


def test_a_sensor_that_is_no_camera_or_has_no_pose_is_passed_over(tmp_path):
    write_colmap_model(tmp_path, reconstruction(), text=True)
    path = tmp_path / "rigs.txt"
    rigs = path.read_text("utf-8")
    assert "1 3 CAMERA 4" in rigs
    path.write_text(rigs.replace("1 3 CAMERA 4", "1 5 CAMERA 4 IMU 1 0 CAMERA 2 0"), "utf-8")
    assert set(read_colmap_model(tmp_path).cam_from_rig) == {"4", "1", "3"}


@pytest.mark.parametrize("name", ["rigs", "frames"])
@pytest.mark.parametrize("share", [0, 0.3, 0.99])
def test_truncated_rigs_are_one_clear_error(tmp_path, name, share):
    write_colmap_model(tmp_path, reconstruction())
    path = tmp_path / f"{name}.bin"
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ValueError, match=f"{name}.bin cannot be used: .*truncated") as raised:
        read_colmap_model(tmp_path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("rigs", "1 2 CAMERA 1 CAMERA 2 1 1 0 0\n", "rigs.txt cannot be used: a line is truncated"),
        ("rigs", "1 2 CAMERA 1 CAMERA 2 1 0 0 0 0 0 0 0\n", "camera 2 must have a pose on its rig"),
        ("rigs", "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0 nan 0\n", "camera 2 must have a pose"),
        ("rigs", "1 2 SONAR 1 CAMERA 2 0\n", "rigs.txt cannot be used: .*'SONAR'"),
        ("rigs", 2 * "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0 0 0\n", "camera 1 must be on one rig"),
        ("frames", "1 1 1 0 0 0 0 0 0 2 CAMERA 1 1\n", "frames.txt cannot be used: a line is"),
    ],
)
def test_damaged_rigs_are_one_clear_error(tmp_path, name, content, message):
    write_colmap_model(tmp_path, reconstruction(), text=True)
    (tmp_path / f"{name}.txt").write_text(content, "utf-8")
    with pytest.raises(ValueError, match=message) as raised:
        read_colmap_model(tmp_path)
    assert str(tmp_path) in str(raised.value) and "\n" not in str(raised.value)
