# SPDX-License-Identifier: BSD-3-Clause
"""Kalibr's camchains: every model that it writes, and where the cameras sit on the IMU."""

import numpy as np
import pytest

from epi360.cameras import (
    DoubleSphere,
    ExtendedUnified,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
    load_camera,
    load_cameras,
    load_kalibr_rig,
)

KALIBR = """
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.0034, 0.0007, -0.002, 0.0002]
  distortion_model: equidistant
  intrinsics: [190.9, 190.8, 254.9, 256.8]
  resolution: [512, 512]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [300, 301, 319.5, 239.5]
  resolution: [640, 480]
"""
CAMERA = """
cam0:
  camera_model: {}
  intrinsics: {}
  distortion_model: {}
  distortion_coeffs: {}
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.1]
  - [0.0, 0.0, 1.0, 0.2]
  - [1.0, 0.0, 0.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  resolution: [512, 500]
"""
SIZE, CENTER = (512, 500), (255.4, 249.0)  # 254.9 and 248.5 in the files
COEFFICIENTS = (-0.1, 0.02, 1e-3, -2e-3)


def test_camchain_gets_the_half_pixel(written):
    assert load_cameras(written(KALIBR, "camchain.yaml")) == {
        "cam0": KannalaBrandt(512, 512, 190.9, 190.8, 255.4, 257.3, 0.0034, 0.0007, -0.002, 0.0002),
        "cam1": Pinhole(640, 480, 300, 301, 320, 240),
    }


@pytest.mark.parametrize(
    ("camera_model", "intrinsics", "distortion_model", "camera"),
    [
        ("pinhole", [200, 201], "none", Pinhole(*SIZE, 200, 201, *CENTER)),
        (
            "pinhole", [200, 201], "radtan",
            UnifiedCamera(*SIZE, 200, 201, *CENTER, 0, *COEFFICIENTS),
        ),
        (
            "pinhole", [200, 201], "equidistant",
            KannalaBrandt(*SIZE, 200, 201, *CENTER, *COEFFICIENTS),
        ),
        ("pinhole", [200, 201], "equi", KannalaBrandt(*SIZE, 200, 201, *CENTER, *COEFFICIENTS)),
        ("omni", [0.9, 200, 201], "none", UnifiedCamera(*SIZE, 200, 201, *CENTER, 0.9)),
        (
            "omni", [0.9, 200, 201], "radtan",
            UnifiedCamera(*SIZE, 200, 201, *CENTER, 0.9, *COEFFICIENTS),
        ),
        ("eucm", [0.6, 1.1, 200, 201], "none", ExtendedUnified(*SIZE, 200, 201, *CENTER, 0.6, 1.1)),
        ("ds", [-0.2, 0.59, 200, 201], "none", DoubleSphere(*SIZE, 200, 201, *CENTER, -0.2, 0.59)),
    ],
)  # fmt: skip
def test_every_model_of_kalibr_is_read(camera_model, intrinsics, distortion_model, camera, written):
    coefficients = [] if distortion_model == "none" else list(COEFFICIENTS)
    text = CAMERA.format(camera_model, [*intrinsics, 254.9, 248.5], distortion_model, coefficients)
    path = written(text, "omni_calib.yaml")
    assert load_camera(path) == camera
    assert load_kalibr_rig(path)["cam0"].camera == camera


def test_rig_says_where_each_camera_sits_on_the_imu(written):
    text = CAMERA.format("omni", [0.9, 200, 201, 254.9, 248.5], "radtan", list(COEFFICIENTS))
    rig = load_kalibr_rig(written(text + KALIBR[KALIBR.index("cam1:") :]))
    cam0_from_imu = rig["cam0"].cam_from_imu
    np.testing.assert_array_equal(cam0_from_imu.rotation, [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    np.testing.assert_array_equal(cam0_from_imu.translation, [0.1, 0.2, 0.3])
    camera, cam1_from_imu = rig["cam1"]  # only T_cn_cnm1: 0.1 m to the left of camera 0
    assert isinstance(camera, Pinhole)
    np.testing.assert_array_equal(cam1_from_imu.rotation, cam0_from_imu.rotation)
    np.testing.assert_allclose(cam1_from_imu.translation, [0, 0.2, 0.3], atol=1e-15)


def test_rig_without_imu_has_no_poses(written):
    rig = load_kalibr_rig(str(written(KALIBR)))
    assert {name: camera.cam_from_imu for name, camera in rig.items()} == {
        "cam0": None,
        "cam1": None,
    }


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("equidistant", "fov", "'fov' is not supported; supported: pinhole-none, .*ds-none"),
        ("camera_model: pinhole", "camera_model: omni", "'omni' with distortion_model 'equi"),
        ("camera_model: pinhole", "camera_model: ds", "'ds' with distortion_model 'equidistant'"),
        ("camera_model: pinhole", "camera_model: [1, 2]", "is not supported; supported"),
        ("resolution: [512, 512]", "size: 512", "camera cam0: missing keys: resolution"),
        ("190.9, 190.8,", "190.9,", r"intrinsics of pinhole must be 4 numbers, got \[190.9, 254"),
        ("190.9, 190.8,", "a, b,", "intrinsics of pinhole must be a number, got 'a'"),
        ("190.9, 190.8,", ".nan, 190.8,", "fx must be a finite number, got nan"),
        ("190.9, 190.8,", "-190.9, 190.8,", "fx must be positive"),
        ("-0.002, 0.0002]", "-0.002]", "distortion_coeffs must be 4 numbers"),
        ("-0.002, 0.0002]", "-0.002, x]", "k4 must be a finite number, got 'x'"),
        ("coeffs: [0.0034, 0.0007, -0.002, 0.0002]", "c: 1", "missing keys: distortion_coeffs"),
        ("distortion_model: equidistant", "", "must be empty without a distortion_model"),
        ("resolution: [512, 512]", "resolution: [512, 0]", "height must be a positive integer"),
        ("resolution: [512, 512]", "resolution: 512", "resolution must be 2 numbers, got 512"),
        ("camera_model: pinhole\n  distortion_coeffs: []", "", "cam1: missing keys: camera_model"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("load", [load_cameras, load_kalibr_rig])
def test_cameras_that_cannot_be_used_say_why(load, before, after, message, written):
    assert before in KALIBR
    with pytest.raises(ValueError, match=message) as raised:
        load(written(KALIBR.replace(before, after), "camchain.yaml"))
    assert "camchain.yaml: camera cam" in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ("omni", "intrinsics of omni must be 5 numbers"),
        ("eucm", "intrinsics of eucm must be 6 numbers"),
        ("ds", "intrinsics of ds must be 6 numbers"),
    ],
)
def test_intrinsics_of_another_length_are_refused(shape, message, written):
    with pytest.raises(ValueError, match=message):
        load_cameras(written(CAMERA.format(shape, [200, 201, 255, 250], "none", [])))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("  - [1.0, 0.0, 0.0, 0.3]\n", "", "T_cam_imu must be 4 rows of 4 numbers"),
        ("0.3]", "]", "a row of T_cam_imu must be 4 numbers"),
        ("0.3]", "far]", "a row of T_cam_imu must be a number, got 'far'"),
        ("[0.0, 0.0, 1.0, 0.2]", "[0.0, 0.0, 0.9, 0.2]", "T_cam_imu must be a rigid transform: r"),
        ("0.0, 1.0]\n  res", "0.0, 2.0]\n  res", "T_cam_imu must be a rigid transform: .*last row"),
    ],
)  # fmt: skip
def test_matrices_that_are_no_rigid_transforms_are_refused(before, after, message, written):
    text = CAMERA.format("pinhole", [200, 201, 255, 250], "none", [])
    assert before in text
    path = written(text.replace(before, after))
    with pytest.raises(ValueError, match=message):
        load_kalibr_rig(path)
    assert load_camera(path).fx == 200  # who does not want the poses is not bothered


def test_rig_of_another_format_is_refused(written):
    with pytest.raises(ValueError, match="must be a Kalibr camchain"):
        load_kalibr_rig(written("1 PINHOLE 640 480 300 300 320 240"))
    with pytest.raises(FileNotFoundError, match="does not exist"):
        load_kalibr_rig("nowhere/camchain.yaml")
