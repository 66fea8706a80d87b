# SPDX-License-Identifier: BSD-3-Clause
import dataclasses
import json

import cv2
import numpy as np
import pytest

from epi360 import cli
from epi360.cameras import (
    DoubleSphere,
    Equirectangular,
    ExtendedUnified,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
    load_camera,
    load_cameras,
)

CAMERAS = [
    Equirectangular(1024, 512),
    Equirectangular(300, 200, 90, 60, 150, 20),
    Pinhole(640, 480, 300, 310, 322.5, 238),
    KannalaBrandt(800, 800, 250, 251, 401, 399, 0.03, -0.01, 0.003, -0.0005, max_angle_deg=95),
    KannalaBrandt(800, 800, 250, 251, 401, 399),
    UnifiedCamera(800, 800, 250, 251, 401, 399, 0.9, -0.1, 0.02, 1e-3, -2e-3),
    UnifiedCamera(800, 800, 250, 251, 401, 399, 1.2),
    ExtendedUnified(800, 800, 250, 251, 401, 399, 0.6, 1.1),
    DoubleSphere(800, 800, 250, 251, 401, 399, -0.2, 0.59),
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


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            {"model": "Pinhole", "width": 4, "height": 4, "f": 3, "c": 1},
            "for Pinhole: f, c; it has",
        ),
        ({"model": "Pinhole", "width": 4, "height": 4, "fx": 3}, "missing keys: fy, cx, cy"),
        (
            {"model": "Ladybug", "width": 4},
            "'Ladybug' is not supported; supported: .*DoubleS",
        ),
        ({"model": "OPENCV_FISHEYE"}, "DoubleSphere; write KannalaBrandt for this one"),
        ({"model": "double sphere"}, "write DoubleSphere for this one"),
        ({"model": "DoubleSphere", "width": 4}, "missing keys: height, fx, fy, cx, cy, xi, alpha"),
        ({"model": ["Pinhole"]}, "is not supported"),
        ({"model": "Pin\nhole"}, "is not supported"),
        ({"model": "Pinhole", "a\nb": 4}, "unknown keys for Pinhole: a b; it has width"),
        ({"cameras": {}}, "with one at least"),
        ({"cameras": ["Pinhole"]}, "must be a mapping of names"),
        ({"cameras": {"a": 5}}, "camera a must be a mapping, got 5"),
        ({"cameras": {"a": {"model": "Equirectangular", "width": 8}}}, "camera a: missing keys"),
        ({"cameras": {}, "version": 2}, "unknown keys beside 'cameras': version"),
        ({"model": "Equirectangular", "width": 8.5, "height": 4}, "width must be a positive int"),
        ({"model": "Equirectangular", "width": 10**400, "height": 4}, "width must be at most"),
        ({"value0": {"cameras": []}}, "no cameras that epi360 can read"),
        ({"cam0": {"fx": 3}}, "no cameras that epi360 can read"),
        ([1, 2, 3], "no cameras that epi360 can read"),
        ("", "no cameras that epi360 can read"),
        ("# only a comment", "no cameras that epi360 can read"),
        ("hello", "no cameras that epi360 can read"),
        ("{not json", "must be YAML or JSON"),
        ("a: [1, 2", "must be YAML or JSON"),
        ("%YAML:1.0\n---\nK: !!opencv-matrix\n", "must be YAML or JSON"),
        ("when: 2020-13-45", "must be YAML or JSON"),
        ("[" * 1000, "must be YAML or JSON"),
        ("cameras: &a [*a, 1]", "must be a mapping of names"),
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
    entry = {"model": "Equirectangular", "width": 1024, "height": 512}
    path = written({"cameras": {"cam0": entry, "cam1": entry}})
    with pytest.raises(ValueError, match="must hold one camera, got 2: cam0, cam1; name one as"):
        load_camera(str(path))


def test_one_of_several_cameras_is_named_after_a_colon(written):
    entry = {"model": "Equirectangular", "width": 1024, "height": 512}
    path = written({"cameras": {"cam0": entry, "cam1": {**entry, "width": 2048}}})
    assert load_camera(f"{path}:cam1").width == 2048
    with pytest.raises(ValueError, match="has no camera 'cam2'; it holds cam0, cam1"):
        load_camera(f"{path}:cam2")
    with pytest.raises(FileNotFoundError, match=r"nowhere:10:cam0 does not exist"):
        load_camera("nowhere:10:cam0")


def test_a_yaml_file_may_begin_with_a_brace(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text("{model: Equirectangular, width: 1024, height: 512}\n")
    assert load_camera(path) == Equirectangular(1024, 512)
    path.write_text('{"model": Equirectangular, "width": ')
    with pytest.raises(ValueError, match="must be YAML or JSON: Expecting value"):
        load_camera(path)


def kalibr(camera_model, intrinsics, distortion_model="none", coefficients=()):
    camera = {
        "camera_model": camera_model,
        "intrinsics": intrinsics,
        "distortion_model": distortion_model,
        "distortion_coeffs": list(coefficients),
        "resolution": [64, 64],
    }
    return {"cam0": camera}


ONE_OF_EACH_FORMAT = {
    "own": {"model": "DoubleSphere", "width": 64, "height": 64}
    | {"fx": 20, "fy": 20, "cx": 32, "cy": 32, "xi": -0.2, "alpha": 0.6},
    "kalibr omni": kalibr("omni", [0.9, 30, 30, 32, 32], "radtan", (-0.1, 0.02, 0.001, 0.001)),
    "kalibr eucm": kalibr("eucm", [0.6, 1.1, 20, 20, 32, 32]),
    "basalt": {
        "value0": {
            "intrinsics": [
                {"camera_type": "ucm", "intrinsics": dict(fx=20, fy=20, cx=32, cy=32, alpha=0.6)}
            ],
            "resolution": [[64, 64]],
        }
    },
    "colmap": "1 RADIAL 64 64 30 32 32 -0.1 0.02",
    "opensfm": {"a b": {"projection_type": "fisheye", "width": 64, "height": 64, "focal": 0.3}},
}


@pytest.mark.parametrize("content", ONE_OF_EACH_FORMAT.values(), ids=ONE_OF_EACH_FORMAT)
def test_every_format_describes_an_image_to_the_command(content, written, tmp_path, monkeypatch):
    calls = []

    def estimate(image1, image2, **options):
        calls.append(options)
        raise ValueError("seen enough")

    monkeypatch.setattr("epi360.two_view.relative_pose_of_images", estimate)
    images = [str(tmp_path / name) for name in ("a.png", "b.png")]
    for path in images:
        assert cv2.imwrite(path, np.full((64, 64, 3), 90, np.uint8))
    calibration = written(content)
    assert cli.main(["pair", *images, "--camera", str(calibration)]) == 2
    camera = load_camera(calibration)
    assert (calls[0]["camera1"], calls[0]["camera2"]) == (camera, camera)


@pytest.mark.parametrize("content", ONE_OF_EACH_FORMAT.values(), ids=ONE_OF_EACH_FORMAT)
def test_files_that_were_cut_off_are_read_or_refused_in_one_line(content, written):
    text = written(content).read_text(encoding="utf-8")
    for length in range(0, len(text), 3):
        try:
            cameras = load_cameras(written(text[:length]))
        except ValueError as error:
            assert "calibration.txt" in str(error) and "\n" not in str(error)
        else:
            assert len(cameras) == 1


def test_a_file_that_is_no_calibration_is_refused_at_once(tmp_path):
    path = tmp_path / "video.yaml"
    with path.open("wb") as file:
        file.truncate(2**31)  # of zeros, on no disk
    with pytest.raises(ValueError, match="must have 33554432 bytes at most"):
        load_cameras(path)
    path.write_text("row: {a: 1, b: 2}\n" * 200_000)
    with pytest.raises(ValueError, match="YAML may have 262144 characters, got 3600000"):
        load_cameras(path)


def test_a_short_file_of_endless_content_is_refused_at_once(tmp_path):
    rows = ["- - &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"  - &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    path = tmp_path / "cameras.yaml"
    path.write_text("\n".join(rows))
    with pytest.raises(ValueError, match="no cameras that epi360 can read"):
        load_cameras(path)


def test_a_transforms_json_of_nerfstudio_is_no_camchain(written):
    document = {"camera_model": "EQUIRECTANGULAR", "w": 2048, "h": 1024, "frames": []}
    with pytest.raises(ValueError, match="has no cameras that epi360 can read; it reads") as caught:
        load_cameras(written(document, "transforms.json"))
    assert "Kalibr camera_model" not in str(caught.value)
