# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's reconstruction.json."""

import json
import math

import numpy as np
import pytest

from epi360.cameras import (
    DoubleSphere,
    Equirectangular,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
)
from epi360.interop.opensfm import read_opensfm, write_opensfm
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.poses import Pose, rotation_from_vector

PANORAMA = {"projection_type": "spherical", "width": 360, "height": 180}
SHOT = {"rotation": [0, math.pi / 2, 0], "translation": [0, 0, 1], "camera": "theta"}
POINT = {"coordinates": [0, 0, 2], "color": [255.0, 127.6, 0]}
DOCUMENT = [
    {
        "cameras": {"theta": PANORAMA},
        "shots": {"R0010085.JPG": {**SHOT, "capture_time": 12.5, "scale": 1.0}},
        "points": {"17": POINT},
        "reference_lla": {"latitude": 0, "longitude": 0, "altitude": 0},
    }
]


@pytest.fixture
def write(tmp_path):
    def write(document):
        path = tmp_path / "reconstruction.json"
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        return path

    return write


def test_a_world_point_lands_where_the_formulas_of_opensfm_put_it(write):
    """A turn by 90 degrees about y takes z to x: (0, 0, 2) becomes (2, 0, 0), plus t (2, 0, 1)."""
    reconstruction = read_opensfm(write(DOCUMENT))
    image = reconstruction.images[0]
    pose = image.cam_from_world
    in_camera = pose.rotation @ reconstruction.points[0] + pose.translation
    np.testing.assert_allclose(in_camera, [2, 0, 1], atol=1e-12)
    # One pixel is one degree: the longitude of (2, 0, 1) is atan(2) = 63.4349 degrees.
    pixel = reconstruction.cameras[image.camera].pixels_from_bearings([in_camera])
    np.testing.assert_allclose(pixel, [[180 + 63.43494882, 90]], atol=1e-8)
    assert (image.name, image.timestamp_s) == ("R0010085.JPG", 12.5)
    assert reconstruction.colors.tolist() == [[255, 128, 0]]
    assert reconstruction.observations is None


def test_of_several_reconstructions_the_largest_is_taken_and_the_others_are_counted(write):
    small = {**DOCUMENT[0], "shots": {"other.jpg": SHOT}}
    large = {**DOCUMENT[0], "shots": {"a.jpg": SHOT, "b.jpg": SHOT}}
    path = write([small, large, small])
    with pytest.warns(UserWarning, match=r"3 reconstructions.*largest, 2 of 4 shots"):
        reconstruction = read_opensfm(path)
    assert [image.name for image in reconstruction.images] == ["a.jpg", "b.jpg"]
    assert reconstruction.images[0].timestamp_s is None


def camera_pose(seed):
    rng = np.random.default_rng(seed)
    return Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))


CAMERAS = {
    "v2 ricoh theta 5376 2688 spherical 0": Equirectangular(5376, 2688),
    "band": Equirectangular(6000, 2000, vertical_fov_deg=120),
    "pinhole": Pinhole(4000, 3000, 3200, 3240, 2040, 1420),
    "brown": UnifiedCamera(3000, 4000, 3400, 3410, 1500, 2000, 0, -0.1, 0.02, 0.001, -0.002),
    "fisheye": KannalaBrandt(848, 800, 285, 286, 424, 399, -0.006, 0.04, -0.04, 0.007),
}


def all_models():
    images = tuple(
        PosedImage(f"Stra\u00dfe/{index} \u6771.jpg", name, camera_pose(index), 100.0 + index)
        for index, name in enumerate(CAMERAS)
    )
    rng = np.random.default_rng(0)
    colors = rng.integers(0, 256, (50, 3)).astype(np.uint8)
    return Reconstruction(CAMERAS, images, rng.normal(size=(50, 3)), colors)


def test_what_is_written_reads_back(tmp_path):
    path = tmp_path / "reconstruction.json"
    before = all_models()
    write_opensfm(path, before)
    after = read_opensfm(path)
    for one, other in zip(before.images, after.images, strict=True):
        assert (one.name, one.camera, one.timestamp_s) == (
            other.name, other.camera, other.timestamp_s,
        )  # fmt: skip
        np.testing.assert_allclose(
            one.cam_from_world.matrix(), other.cam_from_world.matrix(), atol=1e-12
        )
    np.testing.assert_array_equal(before.points, after.points)
    np.testing.assert_array_equal(before.colors, after.colors)
    pixels = np.array([[100.5, 200.25], [400, 600], [700, 300.5]])
    for name, camera in CAMERAS.items():
        np.testing.assert_allclose(
            after.cameras[name].bearings_from_pixels(pixels),
            camera.bearings_from_pixels(pixels),
            atol=1e-12,
        )


def test_the_file_has_the_numbers_of_opensfm(tmp_path):
    """Units are the larger side, 4000: f = 3200 is 0.8, cx = 2040 is 40 beyond the middle, 0.01."""
    path = tmp_path / "reconstruction.json"
    quarter_turn = Pose(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([1.0, 2, 3]))
    image = PosedImage("a.jpg", "pinhole", quarter_turn)
    write_opensfm(path, Reconstruction({"pinhole": CAMERAS["pinhole"]}, (image,)))
    (document,) = json.loads(path.read_text())
    assert document["cameras"]["pinhole"] == {
        "projection_type": "brown", "width": 4000, "height": 3000,
        "focal_x": 0.8, "focal_y": 0.81, "c_x": 0.01, "c_y": -0.02,
        "k1": 0, "k2": 0, "k3": 0, "p1": 0, "p2": 0,
    }  # fmt: skip
    shot = document["shots"]["a.jpg"]
    np.testing.assert_allclose(shot["rotation"], [0, math.pi / 2, 0], atol=1e-12)
    assert shot["translation"] == [1, 2, 3]
    assert "capture_time" not in shot  # unknown is not zero


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (DoubleSphere(64, 64, 30, 30, 32, 32, -0.2, 0.6), "OpenSfM has no DoubleSphere model"),
        (UnifiedCamera(64, 64, 30, 30, 32, 32, 0.9), "no UnifiedCamera model.*xi = 0"),
        (Equirectangular(64, 64, horizontal_fov_deg=180), "only whole panoramas"),
        (Equirectangular(128, 32, vertical_fov_deg=90, center_latitude_deg=10), "only whole"),
    ],
)
def test_a_camera_that_opensfm_lacks_is_refused_and_nothing_is_written(tmp_path, camera, message):
    path = tmp_path / "reconstruction.json"
    image = PosedImage("a.jpg", "odd", Pose(np.eye(3), np.zeros(3)))
    with pytest.raises(ValueError, match=f"camera odd: .*{message}"):
        write_opensfm(path, Reconstruction({"odd": camera}, (image,)))
    assert not path.exists()


def test_an_image_without_pose_or_camera_is_not_written(tmp_path):
    cameras = {"theta": Equirectangular(360, 180)}
    lost = PosedImage("lost.jpg", "theta", Pose.nan())
    with pytest.raises(ValueError, match=r"image lost.jpg has no pose"):
        write_opensfm(tmp_path / "r.json", Reconstruction(cameras, (lost,)))
    unknown = PosedImage("a.jpg", None, Pose(np.eye(3), np.zeros(3)))
    with pytest.raises(ValueError, match=r"OpenSfM needs the camera of image a.jpg"):
        write_opensfm(tmp_path / "r.json", Reconstruction(cameras, (unknown,)))


def changed(**parts):
    return [{**DOCUMENT[0], **parts}]


def without(key):
    return [{name: part for name, part in DOCUMENT[0].items() if name != key}]


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ('[{"cameras": {', "must be JSON"),
        ({"cameras": {}}, "must be a list of reconstructions"),
        ([], "must be a list of reconstructions"),
        ([3], "reconstruction 0 must be a mapping, got 3"),
        (without("cameras"), "missing keys: cameras"),
        (without("shots"), "missing keys: shots"),
        (changed(shots=[]), "shots of reconstruction 0 must be a mapping"),
        (changed(shots={"a": 3}), "shot a: it must be a mapping"),
        (changed(shots={"a": {"camera": "theta"}}), "shot a: missing keys: rotation, translation"),
        (
            changed(shots={"a": {**SHOT, "rotation": [0, 1e200, 0]}}),
            r"shot a: rotation vector must be at most 1e\+100 long",
        ),
        (changed(shots={"a": {**SHOT, "rotation": [0, 1]}}), "shot a: rotation must be 3 finite"),
        (
            changed(shots={"a": {**SHOT, "translation": [0, float("nan"), 0]}}),
            "shot a: translation must be 3 finite numbers",
        ),
        (changed(shots={"a": {**SHOT, "capture_time": "noon"}}), "shot a: capture_time must be"),
        (changed(shots={"a": {**SHOT, "camera": "x"}}), "image a has the unknown camera 'x'"),
        (changed(cameras={"theta": {**PANORAMA, "width": 0}}), "camera theta: width must be"),
        (changed(points={"5": {"coordinates": [0, 0]}}), "point 5 must hold coordinates and color"),
        (changed(points={"5": POINT, "6": {**POINT, "color": None}}), "point 6 must hold"),
        (
            changed(points={"5": {**POINT, "coordinates": [0, 0, float("inf")]}}),
            "point 5 must hold",
        ),
        (changed(points={"5": {**POINT, "coordinates": [1, 2]}, "6": POINT}), "point 5 must hold"),
    ],
)
def test_a_bad_file_is_named_with_the_place(write, document, message):
    path = write(document)
    with pytest.raises(ValueError, match=message) as caught:
        read_opensfm(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere.json does not exist"):
        read_opensfm(tmp_path / "nowhere.json")


def test_a_time_of_zero_for_all_shots_means_unknown(write):
    """OpenSfM writes 0 where the picture does not say; a sequence may begin at 0."""
    shots = {name: {**SHOT, "capture_time": 0.0} for name in "ab"}
    images = read_opensfm(write(changed(shots=shots))).images
    assert [image.timestamp_s for image in images] == [None, None]
    shots["b"]["capture_time"] = 0.5
    images = read_opensfm(write(changed(shots=shots))).images
    assert [image.timestamp_s for image in images] == [0.0, 0.5]
