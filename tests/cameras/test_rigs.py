# SPDX-License-Identifier: BSD-3-Clause
"""Where the cameras of a rig sit, in every format that says so.

The rig of most tests: camera 2 is turned to the right by 90 degrees about the vertical, so that
what is to the right of camera 1 is in front of it, and stands one metre to the right of camera 1.
"""

import copy
import json

import numpy as np
import pytest

from epi360.cameras import Equirectangular, Pinhole, Rig, load_cameras, load_rig
from epi360.poses import Pose

RIGHT_TURN = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]  # x2 = -z1, z2 = x1
HALF = np.sqrt(0.5)
WXYZ = [HALF, 0, -HALF, 0]  # of that turn
PINHOLE = {
    "model": "Pinhole",
    "width": 640,
    "height": 480,
    "fx": 300,
    "fy": 300,
    "cx": 320,
    "cy": 240,
}
OWN = {
    "cameras": {
        "front": PINHOLE,
        "right": {**PINHOLE, "cam_from_rig": {"rotation": RIGHT_TURN, "translation": [0, 0, -1]}},
    }
}
KALIBR = """
cam0:
  camera_model: pinhole
  intrinsics: [300, 300, 319.5, 239.5]
  resolution: [640, 480]{}
cam1:
  camera_model: pinhole
  intrinsics: [300, 300, 319.5, 239.5]
  resolution: [640, 480]{}
"""
CHAIN = "\n  T_cn_cnm1: [[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, -1], [0, 0, 0, 1]]"
# The IMU looks along the axes of camera 1, half a metre below it (y is down).
IMU0 = "\n  T_cam_imu: [[1, 0, 0, 0], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]]"
IMU1 = "\n  T_cam_imu: [[0, 0, -1, 0], [0, 1, 0, 0.5], [1, 0, 0, -1], [0, 0, 0, 1]]"
INTRINSICS = {"fx": 300, "fy": 300, "cx": 319.5, "cy": 239.5}
BASALT = {
    "value0": {
        "T_imu_cam": [
            # The same IMU; camera 1 is above it, camera 2 above it and a metre to the right.
            {"px": 0, "py": -0.5, "pz": 0, "qx": 0, "qy": 0, "qz": 0, "qw": 1},
            {"px": 1, "py": -0.5, "pz": 0, "qx": 0, "qy": HALF, "qz": 0, "qw": HALF},
        ],
        "intrinsics": [{"camera_type": "pinhole", "intrinsics": INTRINSICS}] * 2,
        "resolution": [[640, 480], [640, 480]],
    }
}
COLMAP_PINHOLE = {
    "camera_model_name": "PINHOLE",
    "camera_params": [300, 300, 320, 240],
    "width": 640,
    "height": 480,
}
COLMAP = [
    {
        "cameras": [
            {"image_prefix": "rig/front/", "ref_sensor": True, **COLMAP_PINHOLE},
            {
                "image_prefix": "rig/right/",
                "cam_from_rig_rotation": WXYZ,
                "cam_from_rig_translation": [0, 0, -1],
                **COLMAP_PINHOLE,
            },
        ]
    }
]
FORMS = {
    "ours": OWN,
    "kalibr, chain": KALIBR.format("", CHAIN),
    "kalibr, chain beside imu": KALIBR.format(IMU0, CHAIN),
    "kalibr, imu": KALIBR.format(IMU0, IMU1),
    "basalt": BASALT,
    "colmap": COLMAP,
}


def own_with(cam_from_rig, camera="right"):
    document = copy.deepcopy(OWN)
    document["cameras"][camera]["cam_from_rig"] = cam_from_rig
    return document


def colmap_with(index, **keys):
    document = copy.deepcopy(COLMAP)
    document[0]["cameras"][index].update(keys)
    return document


@pytest.mark.parametrize("form", FORMS)
def test_a_point_on_the_axis_of_camera_2_is_right_of_camera_1(form, written):
    rig = load_rig(written(FORMS[form]))
    first, second = rig.cam_from_rig.values()
    np.testing.assert_array_equal(first.matrix(), np.eye(4))
    center_of_2 = second.inverse().translation
    np.testing.assert_allclose(center_of_2, [1, 0, 0], atol=1e-12)
    point_on_axis_of_2 = second.inverse().rotation @ [0, 0, 3] + center_of_2
    np.testing.assert_allclose(point_on_axis_of_2, [4, 0, 0], atol=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_load_cameras_reads_the_same_cameras(form, written):
    path = written(FORMS[form])
    assert load_rig(path).cameras == load_cameras(path)
    assert set(load_cameras(path).values()) == {Pinhole(640, 480, 300, 300, 320, 240)}


def test_cameras_are_called_as_in_the_file(written):
    names = {form: list(load_rig(written(FORMS[form])).cameras) for form in FORMS}
    assert names["ours"] == ["front", "right"]
    assert names["kalibr, imu"] == names["basalt"] == ["cam0", "cam1"]
    assert names["colmap"] == ["rig/front", "rig/right"]


def test_a_quaternion_of_a_few_digits_is_a_rotation_as_well(written):
    exact = load_rig(written(OWN)).cam_from_rig["right"]
    pose = {"quaternion_wxyz": [0.7071, 0, -0.7071, 0], "translation": [0, 0, -1]}
    read = load_rig(written(own_with(pose))).cam_from_rig["right"]
    np.testing.assert_allclose(read.matrix(), exact.matrix(), atol=1e-12)


def test_poses_in_any_frame_become_those_in_the_frame_of_the_first_camera(written):
    document = own_with({"quaternion_wxyz": [1, 0, 0, 0], "translation": [0, 0, 2]}, camera="front")
    right = load_rig(written(document)).cam_from_rig["right"]
    # The first camera is 2 m behind the frame of the file.
    np.testing.assert_allclose(right.inverse().translation, [1, 0, 2], atol=1e-12)


def test_the_reference_camera_of_colmap_need_not_be_the_first(written):
    document = copy.deepcopy(COLMAP)
    document[0]["cameras"].reverse()
    rig = load_rig(written(document))
    assert list(rig.cameras) == ["rig/right", "rig/front"]
    right_from_front = load_rig(written(COLMAP)).cam_from_rig["rig/right"]
    np.testing.assert_allclose(
        rig.cam_from_rig["rig/front"].matrix(), right_from_front.inverse().matrix(), atol=1e-12
    )


def test_a_chain_of_three_cameras_is_followed(written):
    two_ahead = "\n  T_cn_cnm1: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -2], [0, 0, 0, 1]]"
    third = KALIBR.format("", two_ahead).split("cam1:")[1]
    cam2 = load_rig(written(f"{KALIBR.format('', CHAIN)}cam2:{third}")).cam_from_rig["cam2"]
    # Two metres in front of camera 2, which looks to the right.
    np.testing.assert_allclose(cam2.inverse().translation, [3, 0, 0], atol=1e-12)
    np.testing.assert_allclose(cam2.rotation, RIGHT_TURN, atol=1e-12)


def test_a_panorama_on_a_colmap_rig_has_its_size_in_its_parameters(written):
    document = copy.deepcopy(COLMAP)
    for camera in document[0]["cameras"]:
        camera |= {"camera_model_name": "EQUIRECTANGULAR", "camera_params": [1024, 512]}
        del camera["width"], camera["height"]
    cameras = load_rig(written(json.dumps(document, indent="\t"))).cameras
    assert cameras["rig/right"] == Equirectangular(1024, 512)


def test_colmap_reads_the_poses_of_its_file_as_we_do(written):
    pycolmap = pytest.importorskip("pycolmap")
    path = written(COLMAP, "rig_config.json")
    (theirs,) = pycolmap.read_rig_config(path)
    ours = load_rig(path).cam_from_rig["rig/right"]
    np.testing.assert_allclose(
        theirs.cameras[1].cam_from_rig.matrix(), ours.matrix()[:3], atol=1e-12
    )


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (PINHOLE, "no camera has a cam_from_rig"),
        ({"cameras": {"a": PINHOLE, "b": PINHOLE}}, "no camera has a cam_from_rig"),
        (KALIBR.format("", ""), "camera cam1 has neither T_cn_cnm1 nor a T_cam_imu like cam0"),
        (KALIBR.format(IMU0, ""), "camera cam1 has neither T_cn_cnm1 nor a T_cam_imu like cam0"),
        (KALIBR.format("", IMU1), "camera cam1 has neither T_cn_cnm1 nor a T_cam_imu like cam0"),
        ("1 PINHOLE 640 480 300 300 320 240", "does not say where cameras sit on a rig; load_rig"),
        (
            {"value0": {k: v for k, v in BASALT["value0"].items() if k != "T_imu_cam"}},
            "missing keys: T_imu_cam",
        ),
    ],
)
def test_a_file_without_poses_says_what_is_missing(document, message, written):
    path = written(document)
    with pytest.raises(ValueError, match=message):
        load_rig(path)
    assert load_cameras(path)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (own_with([1, 2, 3]), "camera right: cam_from_rig must have translation and rotation, or"),
        (own_with({"translation": [0, 0, 1]}), "cam_from_rig must have translation and rotation"),
        (own_with({"rotation": RIGHT_TURN}), "cam_from_rig must have translation and rotation"),
        (
            own_with({"rotation": RIGHT_TURN[:2], "translation": [0, 0, 1]}),
            "rotation must be 3 rows of 3 numbers",
        ),
        (
            own_with({"rotation": [[0, 0, 1], [0, 1, 0], [1, 0, 0]], "translation": [0, 0, 1]}),
            "camera right: rotation must have determinant",
        ),
        (
            own_with({"quaternion_wxyz": [1, 1, 0, 0], "translation": [0, 0, 1]}),
            r"quaternion_wxyz must have length 1, got \[1.0, 1.0, 0.0, 0.0\] of length 1.41421",
        ),
        (
            own_with({"quaternion_wxyz": [0, 0, 0, 0], "translation": [0, 0, 1]}),
            "quaternion_wxyz must have length 1",
        ),
        (
            own_with({"quaternion_wxyz": WXYZ, "translation": [0, 0, float("nan")]}),
            "camera right: the pose on the rig must be finite",
        ),
        (
            {"cameras": {**OWN["cameras"], "left": PINHOLE}},
            "cameras without cam_from_rig: left",
        ),
        (
            {"value0": {**BASALT["value0"], "T_imu_cam": BASALT["value0"]["T_imu_cam"][:1]}},
            "T_imu_cam must list the poses of 2 cameras",
        ),
        (
            {"value0": {**BASALT["value0"], "T_imu_cam": [{"px": 1}, {"px": 1}]}},
            "camera cam0: missing keys: qw, qx, qy, qz, py, pz",
        ),
        (COLMAP * 2, "expected one rig, got 2"),
        ([{"cameras": {}}], "cameras must be a list"),
        (colmap_with(1, image_prefix="rig/front/"), "must have an image_prefix of its own"),
        (colmap_with(0, ref_sensor=False), "rig/front: missing keys: cam_from_rig_rotation, cam_f"),
        (colmap_with(1, cam_from_rig_rotation=[2, 0, 0, 0]), "rotation must have length 1, got"),
        (colmap_with(1, cam_from_rig_translation=[0, 0]), "translation must be 3 numbers"),
        (colmap_with(1, width=None), "rig/right: missing keys: width, height; COLMAP's file does"),
        (colmap_with(1, camera_params="1"), "rig/right: camera_params must be a list"),
        (colmap_with(1, camera_model_name="FOV"), "COLMAP model 'FOV' is not supported"),
    ],
)
def test_a_rig_that_cannot_be_used_says_why(document, message, written):
    with pytest.raises(ValueError, match=message) as raised:
        load_rig(written(document, "rig.yaml"))
    assert "calibration file" in str(raised.value) and "\n" not in str(raised.value)


def test_a_missing_file_is_named():
    with pytest.raises(FileNotFoundError, match="nowhere.yaml does not exist"):
        load_rig("nowhere.yaml")


def test_a_rig_needs_a_pose_for_each_camera():
    camera = Pinhole(640, 480, 300, 300, 320, 240)
    pose = Pose(np.eye(3), np.zeros(3))
    with pytest.raises(ValueError, match="must have the cameras a, b, got a"):
        Rig({"a": camera, "b": camera}, {"a": pose})
