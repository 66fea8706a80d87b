# SPDX-License-Identifier: BSD-3-Clause
import dataclasses
import json

import pytest

from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole, load_camera, load_cameras

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
COLMAP = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 4
1 EQUIRECTANGULAR 1024 512 1024 512
2 SIMPLE_PINHOLE 640 480 300 320 240
3 PINHOLE 640 480 300.5 301 320 240
7 OPENCV_FISHEYE 1000 900 230 231 500 450 0.03 -0.01 3e-3 -0.0005
"""


@pytest.fixture
def written(tmp_path):
    def write(text, name="calibration.txt"):
        path = tmp_path / name
        path.write_text(text if isinstance(text, str) else json.dumps(text), encoding="utf-8")
        return path

    return write


CAMERAS = [
    Equirectangular(1024, 512),
    Equirectangular(300, 200, 90, 60, 150, 20),
    Pinhole(640, 480, 300, 310, 322.5, 238),
    KannalaBrandt(800, 800, 250, 251, 401, 399, 0.03, -0.01, 0.003, -0.0005, max_angle_deg=95),
    KannalaBrandt(800, 800, 250, 251, 401, 399),
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_camera_written_by_its_parameter_names_comes_back(camera, written):
    entry = {"model": type(camera).__name__, **dataclasses.asdict(camera)}
    assert load_cameras(written(entry)) == {"camera": camera}
    text = "".join(f"{key}: {json.dumps(value)}\n" for key, value in entry.items())
    assert load_camera(written(text)) == camera


def test_named_cameras_keep_their_names_and_order(written):
    entries = {
        "right": {"model": "Equirectangular", "width": 1024, "height": 512},
        "left": {"model": "Pinhole", **dataclasses.asdict(CAMERAS[2])},
    }
    cameras = load_cameras(written({"cameras": entries}))
    assert list(cameras.items()) == [("right", CAMERAS[0]), ("left", CAMERAS[2])]


def test_numbers_that_yaml_takes_for_text_are_numbers(written):
    text = "{model: KannalaBrandt, width: 8, height: 8, fx: 2e2, fy: 200, cx: 4, cy: 4, k1: -1e-3}"
    text = text.strip("{}").replace(", ", "\n")
    assert load_camera(written(text)) == KannalaBrandt(8, 8, 200, 200, 4, 4, -1e-3)


def test_kalibr_camchain_gets_the_half_pixel(written):
    assert load_cameras(written(KALIBR, "camchain.yaml")) == {
        "cam0": KannalaBrandt(512, 512, 190.9, 190.8, 255.4, 257.3, 0.0034, 0.0007, -0.002, 0.0002),
        "cam1": Pinhole(640, 480, 300, 301, 320, 240),
    }


def test_colmap_cameras_stay_as_they_are(written):
    assert load_cameras(written(COLMAP, "cameras.txt")) == {
        "1": Equirectangular(1024, 512),
        "2": Pinhole(640, 480, 300, 300, 320, 240),
        "3": Pinhole(640, 480, 300.5, 301, 320, 240),
        "7": KannalaBrandt(1000, 900, 230, 231, 500, 450, 0.03, -0.01, 0.003, -0.0005),
    }


def test_colmap_itself_writes_what_we_read(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    reconstruction = pycolmap.Reconstruction()
    for number, (model, params) in enumerate(
        [
            ("EQUIRECTANGULAR", [1024, 512]),
            ("PINHOLE", [300, 301, 512, 256]),
            ("OPENCV_FISHEYE", [300, 301, 512, 256, 0.1, 0.2, 0.3, 0.4]),
        ]
    ):
        reconstruction.add_camera(
            pycolmap.Camera(
                model=model, width=1024, height=512, params=params, camera_id=number + 1
            )
        )
    reconstruction.write_text(tmp_path)
    assert load_cameras(tmp_path / "cameras.txt") == {
        "1": Equirectangular(1024, 512),
        "2": Pinhole(1024, 512, 300, 301, 512, 256),
        "3": KannalaBrandt(1024, 512, 300, 301, 512, 256, 0.1, 0.2, 0.3, 0.4),
    }


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
        ("1 OPENCV 640 480 300 300 320 240 0 0 0 0", "COLMAP model OPENCV is not supported yet"),
        ("1 SIMPLE_RADIAL 640 480 300 320 240 0", "supported: EQUIRECTANGULAR, .*OPENCV_FISHEYE"),
        ("1 PINHOLE 640 480 300 320 240", "camera 1: PINHOLE parameters must be 4 numbers"),
        ("1 PINHOLE 640 480 300 a 320 240", "fy must be a finite number, got 'a'"),
        ("1 EQUIRECTANGULAR 1024 512", "EQUIRECTANGULAR parameters must be 2 numbers"),
        ("1 EQUIRECTANGULAR 1024 512 1000 500", "must be the image size"),
        ("1 SPHERE 1024 512 1 500 256", "centre in the image centre"),
        ("1 PINHOLE 0 480 300 300 320 240", "width must be a positive integer"),
        ("1 EQUIRECTANGULAR 8 4 8 4\n1 EQUIRECTANGULAR 8 4 8 4", "camera 1 is there twice"),
        ("1 EQUIRECTANGULAR 8 4 8 4\nhello", "expected 'CAMERA_ID MODEL"),
    ],
)
def test_colmap_lines_that_cannot_be_used_say_why(line, message, written):
    with pytest.raises(ValueError, match=message):
        load_cameras(written(line, "cameras.txt"))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("equidistant", "radtan", "camera cam0: .*radtan is not supported yet; supported: pinhole"),
        ("camera_model: pinhole", "camera_model: omni", "Kalibr model omni"),
        ("camera_model: pinhole", "camera_model: ds", "Kalibr model ds"),
        ("camera_model: pinhole", "camera_model: eucm", "Kalibr model eucm"),
        ("resolution: [512, 512]", "size: 512", "camera cam0: missing keys: resolution"),
        ("190.9, 190.8,", "190.9,", "intrinsics must be 4 numbers"),
        ("-0.002, 0.0002]", "-0.002]", "distortion_coeffs must be 4 numbers"),
        ("resolution: [512, 512]", "resolution: [512, 0]", "height must be a positive integer"),
    ],
)
def test_kalibr_cameras_that_cannot_be_used_say_why(before, after, message, written):
    with pytest.raises(ValueError, match=message):
        load_cameras(written(KALIBR.replace(before, after), "camchain.yaml"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {"model": "Pinhole", "width": 4, "height": 4, "f": 3, "c": 1},
            "for Pinhole: f, c; it has",
        ),
        ({"model": "Pinhole", "width": 4, "height": 4, "fx": 3}, "missing keys: fy, cx, cy"),
        (
            {"model": "DoubleSphere", "width": 4},
            "'DoubleSphere' is not supported yet; supported: E",
        ),
        ({"model": ["Pinhole"]}, "is not supported yet"),
        ({"cameras": {}}, "with one at least"),
        ({"cameras": ["Pinhole"]}, "must be a mapping of names"),
        ({"cameras": {"a": 5}}, "camera a must be a mapping, got 5"),
        ({"cameras": {"a": {"model": "Equirectangular", "width": 8}}}, "camera a: missing keys"),
        ({"cameras": {}, "version": 2}, "unknown keys beside 'cameras': version"),
        ({"model": "Equirectangular", "width": 8.5, "height": 4}, "width must be a positive int"),
        ({"value0": {"intrinsics": []}}, "no cameras that epi360 can read"),
        ([1, 2, 3], "no cameras that epi360 can read"),
        ("", "no cameras that epi360 can read"),
        ("# only a comment", "no cameras that epi360 can read"),
        ("hello", "no cameras that epi360 can read"),
        ("{not json", "must be YAML or JSON"),
        ("a: [1, 2", "must be YAML or JSON"),
        ("%YAML:1.0\n---\nK: !!opencv-matrix\n", "must be YAML or JSON"),
        ("when: 2020-13-45", "must be YAML or JSON"),
        ("[" * 1000, "must be YAML or JSON"),
    ],
)
def test_files_that_cannot_be_used_say_why_in_one_line(content, message, written):
    with pytest.raises(ValueError, match=message) as raised:
        load_cameras(written(content))
    assert "calibration.txt" in str(raised.value) and "\n" not in str(raised.value)


def test_files_that_are_no_text_or_not_there_say_so(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.yaml does not exist"):
        load_cameras(tmp_path / "nowhere.yaml")
    with pytest.raises(ValueError, match="is a folder"):
        load_cameras(tmp_path)
    picture = tmp_path / "picture.jpg"
    picture.write_bytes(b"\xff\xd8\xff\xe0\x00\x10JFIF\x00" + bytes(range(256)))
    with pytest.raises(ValueError, match="must be text, got binary data"):
        load_cameras(picture)


def test_single_camera_of_a_file_with_several_is_refused_by_their_names(written):
    with pytest.raises(ValueError, match="must hold one camera, got 2: cam0, cam1; take one with"):
        load_camera(str(written(KALIBR)))
