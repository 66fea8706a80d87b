# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP's cameras.txt."""

import numpy as np
import pytest

from epi360.cameras import (
    Equirectangular,
    ExtendedUnified,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
    load_camera,
    load_cameras,
)

COLMAP = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 12
1 EQUIRECTANGULAR 1024 512 1024 512
2 SIMPLE_PINHOLE 640 480 300 320 240
3 PINHOLE 640 480 300.5 301 320 240
7 OPENCV_FISHEYE 1000 900 230 231 500 450 0.03 -0.01 3e-3 -0.0005
8 SIMPLE_RADIAL 640 480 300 320 240 -0.1
9 RADIAL 640 480 300 320 240 -0.1 0.01
10 OPENCV 640 480 300 301 320 240 -0.1 0.01 0.001 -0.002
11 SIMPLE_RADIAL_FISHEYE 640 480 300 320 240 -0.1
12 RADIAL_FISHEYE 640 480 300 320 240 -0.1 0.01
13 SIMPLE_FISHEYE 640 480 300 320 240
14 FISHEYE 640 480 300 301 320 240
15 EUCM 640 480 300 301 320 240 0.6 1.1
"""
FOCUS, UNEVEN = (640, 480, 300, 300, 320, 240), (640, 480, 300, 301, 320, 240)
CAMERAS = {
    "1": Equirectangular(1024, 512),
    "2": Pinhole(*FOCUS),
    "3": Pinhole(640, 480, 300.5, 301, 320, 240),
    "7": KannalaBrandt(1000, 900, 230, 231, 500, 450, 0.03, -0.01, 0.003, -0.0005),
    "8": UnifiedCamera(*FOCUS, 0, -0.1),
    "9": UnifiedCamera(*FOCUS, 0, -0.1, 0.01),
    "10": UnifiedCamera(*UNEVEN, 0, -0.1, 0.01, 0.001, -0.002),
    "11": KannalaBrandt(*FOCUS, -0.1),
    "12": KannalaBrandt(*FOCUS, -0.1, 0.01),
    "13": KannalaBrandt(*FOCUS),
    "14": KannalaBrandt(*UNEVEN),
    "15": ExtendedUnified(*UNEVEN, 0.6, 1.1),
}


def test_cameras_stay_as_they_are(written):
    assert load_cameras(written(COLMAP, "cameras.txt")) == CAMERAS


def test_colmap_itself_writes_what_we_read_and_sees_the_same_pixels(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    reconstruction = pycolmap.Reconstruction()
    for line in COLMAP.splitlines()[3:]:
        number, model, width, height, *params = line.split()
        if not hasattr(pycolmap.CameraModelId, model):
            continue  # an older COLMAP
        reconstruction.add_camera(
            pycolmap.Camera(
                model=model,
                width=int(width),
                height=int(height),
                params=[float(value) for value in params],
                camera_id=int(number),
            )
        )
    reconstruction.write_text(tmp_path)
    cameras = load_cameras(tmp_path / "cameras.txt")
    assert len(cameras) > 8 and cameras == {name: CAMERAS[name] for name in cameras}
    x, y = np.random.default_rng(0).uniform(-0.6, 0.6, (2, 500))
    bearings = np.column_stack([x, y, np.ones(500)])
    for name, camera in cameras.items():
        pixels = reconstruction.cameras[int(name)].img_from_cam(bearings)
        np.testing.assert_allclose(camera.pixels_from_bearings(bearings), pixels, atol=1e-9)


@pytest.mark.parametrize(
    "line",
    [
        "1 SPHERICAL 1024 512 1024 512",
        "1 SPHERE 1024 512 1 512 256",
        "1 SPHERICAL 1024 512 1 512 256",
    ],
)
def test_other_names_of_the_panorama_are_known(line, written):
    assert load_camera(written(line)) == Equirectangular(1024, 512)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 FULL_OPENCV 64 48 30 30 32 24 0 0 0 0 0 0 0 0", "model 'FULL_OPENCV' is not supported"),
        ("1 FOV 640 480 300 300 320 240 1", "supported: EQUIRECTANGULAR, .*OPENCV_FISHEYE, EUCM"),
        ("1 PINHOLE 640 480 300 320 240", "camera 1: PINHOLE parameters must be 4 numbers"),
        ("1 OPENCV 640 480 300 300 320 240 0 0 0", "OPENCV parameters must be 8 numbers"),
        ("1 SIMPLE_RADIAL 640 480 300 320 240", "SIMPLE_RADIAL parameters must be 4 numbers"),
        ("1 PINHOLE 640 480 300 a 320 240", "fy must be a finite number, got 'a'"),
        ("1 EQUIRECTANGULAR 1024 512", "EQUIRECTANGULAR parameters must be 2 numbers"),
        ("1 EQUIRECTANGULAR 1024 512 1000 500", "must be the image size"),
        ("1 SPHERE 1024 512 1 500 256", "centre in the image centre"),
        ("1 PINHOLE 0 480 300 300 320 240", "width must be a positive integer"),
        (f"1 PINHOLE {10**400} 480 300 300 320 240", "width must be at most 10000000 pixels"),
        (f"1 PINHOLE 640 480 300 300 320 {10**400}", "cy must be a finite number"),
        ("1 EQUIRECTANGULAR 8 4 8 4\n1 EQUIRECTANGULAR 8 4 8 4", "camera 1 is there twice"),
        ("1 EQUIRECTANGULAR 8 4 8 4\nhello", "expected 'CAMERA_ID MODEL"),
        ("1 EQUIRECTANGULAR 8 4 8 4\n2 PINHOLE 64", "expected 'CAMERA_ID MODEL"),
    ],
)  # fmt: skip
def test_lines_that_cannot_be_used_say_why(line, message, written):
    with pytest.raises(ValueError, match=message) as raised:
        load_cameras(written(line, "cameras.txt"))
    assert "cameras.txt: " in str(raised.value) and "\n" not in str(raised.value)
