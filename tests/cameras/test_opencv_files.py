# SPDX-License-Identifier: BSD-3-Clause
"""Calibrations of ROS's camera_calibration and of OpenCV's samples."""

import json

import numpy as np
import pytest

from epi360 import load_camera
from epi360.cameras import KannalaBrandt, UnifiedCamera, load_cameras

cv2 = pytest.importorskip("cv2")

K = np.array([[285.0, 0.0, 423.5], [0.0, 286.0, 399.5], [0.0, 0.0, 1.0]])
FOCUS = (848, 800, 285.0, 286.0, 424.0, 400.0)
FISHEYE, BENT = (-0.006, 0.04, -0.04, 0.007), (-0.2, 0.05, 0.001, -0.002)


def matrix(values, rows=1):
    return {"rows": rows, "cols": len(values) // rows, "data": list(values)}


def ros(model, coefficients, **more):
    return {
        "image_width": 848,
        "image_height": 800,
        "camera_name": "front",
        "camera_matrix": matrix(K.ravel().tolist(), 3),
        "distortion_model": model,
        "distortion_coefficients": matrix(coefficients),
        **more,
    }


@pytest.mark.parametrize(
    ("model", "coefficients", "camera"),
    [
        ("equidistant", FISHEYE, KannalaBrandt(*FOCUS, *FISHEYE)),
        ("fisheye", FISHEYE, KannalaBrandt(*FOCUS, *FISHEYE)),
        ("plumb_bob", (*BENT, 0.0), UnifiedCamera(*FOCUS, 0.0, *BENT)),
        ("plumb_bob", BENT, UnifiedCamera(*FOCUS, 0.0, *BENT)),
        ("plumb_bob", (), UnifiedCamera(*FOCUS, 0.0)),
        ("rational_polynomial", (*BENT, 0.0, 0.0, 0.0, 0.0), UnifiedCamera(*FOCUS, 0.0, *BENT)),
    ],
)
def test_a_camera_of_ros_is_read(model, coefficients, camera, written):
    assert load_cameras(written(ros(model, coefficients))) == {"front": camera}


@pytest.mark.parametrize("end", ["yaml", "yml", "json"])
@pytest.mark.parametrize("is_fisheye", [False, True])
def test_what_opencv_writes_is_read_and_has_its_rays(end, is_fisheye, tmp_path):
    path = tmp_path / f"out_camera_data.{end}"
    coefficients = np.array(FISHEYE if is_fisheye else (*BENT, 0.0))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 848)
    storage.write("image_height", 800)
    storage.write("fisheye_model", int(is_fisheye))
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", coefficients[:, None])
    storage.release()
    camera = load_camera(path)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 1, 3)) + [0.0, 0.0, 1.0]
    project = cv2.fisheye.projectPoints if is_fisheye else cv2.projectPoints
    args = (points, np.zeros(3), np.zeros(3), K, coefficients)
    pixels = project(*args)[0].reshape(-1, 2) + 0.5
    seen = camera.pixels_from_bearings(points[:, 0])
    known = np.isfinite(seen).all(axis=1)
    assert known.sum() > 20
    np.testing.assert_allclose(seen[known], pixels[known], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"distortion_model": "plumb_fish"}, "distortion_model 'plumb_fish' is not supported"),
        ({"distortion_model": None}, "distortion_model None is not supported"),
        ({"distortion_coefficients": matrix((*BENT, 0.1))}, "after the first 4 is not supported"),
        ({"camera_matrix": matrix([1.0] * 9, 3)}, "camera_matrix must be fx 0 cx"),
        ({"camera_matrix": matrix([1.0] * 3, 1)}, "camera_matrix must be fx 0 cx"),
        ({"camera_matrix": matrix([1.0], 1)}, "camera_matrix must be fx 0 cx"),
        ({"camera_matrix": {"rows": 1.5, "cols": 2, "data": [1.0] * 3}}, "must be a small matrix"),
        ({"camera_matrix": [1.0]}, "camera_matrix must have rows, cols and data"),
        ({"camera_matrix": {"rows": 3, "cols": 3}}, "missing keys: data"),
        ({"camera_matrix": {"rows": 1e9, "cols": 3, "data": []}}, "must be a small matrix"),
        ({"camera_matrix": matrix(["a"] * 9, 3)}, "data of camera_matrix must be a number"),
        ({"image_width": "wide"}, "width"),
    ],
)
def test_a_wrong_file_says_what_is_wrong(changes, words, written):
    document = ros("plumb_bob", BENT) | changes
    with pytest.raises(ValueError, match=words) as caught:
        load_camera(written(document))
    assert str(caught.value).startswith("calibration file ") and "\n" not in str(caught.value)


def test_four_coefficients_of_no_model_are_those_of_two(written):
    document = ros("plumb_bob", BENT)
    del document["distortion_model"]
    with pytest.raises(ValueError, match="add 'distortion_model: equidistant' or"):
        load_camera(written(document))
    document["distortion_coefficients"] = matrix((*BENT, 0.0))
    assert load_camera(written(document)) == UnifiedCamera(*FOCUS, 0.0, *BENT)
    del document["distortion_coefficients"], document["image_height"]
    with pytest.raises(ValueError, match="missing keys: image_height"):
        load_camera(written(document))


@pytest.mark.parametrize("name", [[1, 2], {"a": 1}, "", None, 3])
def test_a_camera_without_a_name_is_called_camera(name, written):
    assert list(load_cameras(written(ros("plumb_bob", (), camera_name=name)))) == ["camera"]


def test_only_a_matrix_of_opencv_has_a_tag(tmp_path):
    for text in ("%YAML:1.0", "%YAML:1.0\n---\na: !!python/object:os.system {}\n"):
        path = tmp_path / "hostile.yaml"
        path.write_text(text)
        with pytest.raises(ValueError, match="hostile.yaml"):
            load_camera(path)
    path.write_text(json.dumps({"camera_matrix": 3}))
    with pytest.raises(ValueError, match="missing keys: image_width"):
        load_camera(path)
