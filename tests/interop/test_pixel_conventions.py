# SPDX-License-Identifier: BSD-3-Clause
"""One test for each row of the table in docs/conventions.md: pixel k of a tool, its ray, our pixel.

Rays are worked out by hand from the tool's formulas; where its library is installed, it is asked
too. Panoramas are 360 x 180, so that a pixel is a degree.
"""

import json
import math

import cv2
import numpy as np
import pytest

from epi360.cameras import (
    Equirectangular,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
    load_camera,
    load_cameras,
)
from epi360.interop.gpano import GPano, PanoramaPart, gpano_packet, parse_gpano
from epi360.interop.nerfstudio import read_nerfstudio
from epi360.interop.opensfm import read_opensfm
from epi360.interop.tum import read_tum_trajectory

SIN_1, COS_1 = math.sin(1), math.cos(1)
# Column 270, row 89: its centre is 90.5 degrees to the right and 0.5 degrees up.
COLUMN, ROW = 270, 89
SIN, COS = math.sin(math.radians(0.5)), math.cos(math.radians(0.5))
RAY = [[COS * COS, -SIN, -COS * SIN]]  # sin 90.5 = cos 0.5, cos 90.5 = -sin 0.5


def assert_pixel_has_ray(camera, pixel, ray):
    np.testing.assert_allclose(camera.bearings_from_pixels([pixel]), ray, atol=1e-9)
    np.testing.assert_allclose(camera.pixels_from_bearings(ray), [pixel], atol=1e-7)


def unit(*direction):
    return [np.array(direction) / np.linalg.norm(direction)]


def test_epi360_puts_the_first_pixels_centre_at_a_half():
    camera = Equirectangular(360, 180)
    assert_pixel_has_ray(camera, [COLUMN + 0.5, ROW + 0.5], RAY)
    # The first pixel: 179.5 degrees to the left, 89.5 up.
    assert_pixel_has_ray(camera, [0.5, 0.5], [[-SIN * SIN, -COS, -SIN * COS]])


def test_colmap_panoramas_have_our_pixels_and_axes():
    pycolmap = pytest.importorskip("pycolmap")
    if "EQUIRECTANGULAR" not in pycolmap.CameraModelId.__members__:
        pytest.skip("needs pycolmap 4.2 for panoramas")
    camera = pycolmap.Camera(model="EQUIRECTANGULAR", width=360, height=180, params=[360, 180])
    pixel = np.array([COLUMN + 0.5, ROW + 0.5])
    np.testing.assert_allclose(camera.cam_ray_from_img(pixel), RAY[0], atol=1e-9)
    assert_pixel_has_ray(Equirectangular(360, 180), pixel, RAY)


@pytest.mark.parametrize(
    ("model", "parameters", "pixel", "ray", "ours"),
    [
        # 50.5 and 30.5 pixels from the principal point, f = 100.
        (
            "PINHOLE", [100, 100, 100, 50], [150.5, 80.5], unit(0.505, 0.305, 1),
            Pinhole(200, 100, 100, 100, 100, 50),
        ),
        # r = a (1 + 0.1 a^2) is 1.1 for a = 1 radian: 110 pixels to the right.
        (
            "OPENCV_FISHEYE", [100, 100, 200, 150, 0.1, 0, 0, 0], [310, 150], [[SIN_1, 0, COS_1]],
            KannalaBrandt(400, 300, 100, 100, 200, 150, 0.1),
        ),
        # x = 0.5 is distorted to 0.5 (1 + 0.2 * 0.25) + 0.01 * (0.25 + 0.5) = 0.5325 by k1, p2.
        (
            "OPENCV", [100, 100, 200, 150, 0.2, 0, 0, 0.01], [253.25, 150], unit(0.5, 0, 1),
            UnifiedCamera(400, 300, 100, 100, 200, 150, 0, 0.2, 0, 0, 0.01),
        ),
    ],
)  # fmt: skip
def test_colmap_has_our_pixels_and_axes(model, parameters, pixel, ray, ours):
    assert_pixel_has_ray(ours, pixel, ray)
    pycolmap = pytest.importorskip("pycolmap")
    camera = pycolmap.Camera(
        model=model, width=ours.width, height=ours.height, params=np.array(parameters, float)
    )
    np.testing.assert_allclose(
        camera.img_from_cam(np.array(ray[0], float).reshape(1, 3))[0], pixel, atol=1e-9
    )


def test_opencv_pixels_are_half_a_pixel_less():
    """Fisheye with r = a (1 + 0.1 a^2), f = 100, c = (199.5, 149.5): a = 1 is column 309.5."""
    opencv_pixel, ray = np.array([309.5, 149.5]), np.array([SIN_1, 0, COS_1])
    K = np.array([[100, 0, 199.5], [0, 100, 149.5], [0, 0, 1]])
    from_opencv, _ = cv2.fisheye.projectPoints(
        ray.reshape(1, 1, 3), np.zeros(3), np.zeros(3), K, np.array([0.1, 0, 0, 0])
    )
    np.testing.assert_allclose(from_opencv.ravel(), opencv_pixel, atol=1e-9)
    ours = KannalaBrandt(400, 300, 100, 100, 199.5 + 0.5, 149.5 + 0.5, 0.1)
    assert_pixel_has_ray(ours, opencv_pixel + 0.5, [ray])


def test_opencv_omnidir_pixels_are_half_a_pixel_less():
    """With xi = 1 the direction x goes to 1 / (0 + 1) = 1: f = 100 right of c = (199.5, 149.5)."""
    ray = np.array([1.0, 0, 0])
    assert_pixel_has_ray(UnifiedCamera(400, 300, 100, 100, 200, 150, 1), [300, 150], [ray])
    if not hasattr(cv2, "omnidir"):
        pytest.skip("needs OpenCV's contrib modules")
    K = np.array([[100, 0, 199.5], [0, 100, 149.5], [0, 0, 1]])
    pixels, _ = cv2.omnidir.projectPoints(
        ray.reshape(1, 1, 3), np.zeros((1, 3)), np.zeros((1, 3)), K, 1.0, np.zeros((1, 4))
    )
    np.testing.assert_allclose(pixels.ravel(), [299.5, 149.5], atol=1e-9)


def test_hloc_key_points_are_half_a_pixel_less(tmp_path):
    h5py = pytest.importorskip("h5py")
    from epi360.interop.hloc import read_hloc

    with h5py.File(tmp_path / "features.h5", "w") as file:
        for name in ("a.jpg", "b.jpg"):
            group = file.create_group(name)
            group["keypoints"] = np.array([[COLUMN, ROW], [0, 0]], np.float32)
            group["image_size"] = np.array([360, 180])
    with h5py.File(tmp_path / "matches.h5", "w") as file:
        file.create_group("a.jpg/b.jpg")["matches0"] = np.array([0, -1], np.int32)
    graph = read_hloc(tmp_path / "features.h5", tmp_path / "matches.h5")
    image = graph.images["a.jpg"]
    assert image.keypoints.tolist() == [[COLUMN + 0.5, ROW + 0.5], [0.5, 0.5]]
    bearings = graph.cameras[image.camera].bearings_from_pixels(image.keypoints[:1])
    np.testing.assert_allclose(bearings, RAY, atol=1e-9)


KALIBR = """
cam0:
  camera_model: pinhole
  distortion_model: equidistant
  distortion_coeffs: [0.1, 0.0, 0.0, 0.0]
  intrinsics: [100.0, 100.0, 199.5, 149.5]
  resolution: [400, 300]
"""


def test_kalibr_pixels_are_half_a_pixel_less(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    # Kalibr's pixel (309.5, 149.5) is 110 right of its centre: 1.1 = a (1 + 0.1 a^2) for a = 1.
    assert_pixel_has_ray(load_camera(path), [309.5 + 0.5, 149.5 + 0.5], [[SIN_1, 0, COS_1]])


def test_basalt_pixels_are_half_a_pixel_less(tmp_path):
    lens = {"fx": 100, "fy": 100, "cx": 199.5, "cy": 149.5, "k1": 0.1, "k2": 0, "k3": 0, "k4": 0}
    path = tmp_path / "calibration.json"
    path.write_text(
        json.dumps(
            {
                "value0": {
                    "intrinsics": [{"camera_type": "kb4", "intrinsics": lens}],
                    "resolution": [[400, 300]],
                }
            }
        )
    )
    camera = load_cameras(path)["cam0"]
    assert_pixel_has_ray(camera, [309.5 + 0.5, 149.5 + 0.5], [[SIN_1, 0, COS_1]])


def test_opensfm_counts_from_the_middle_of_the_image(tmp_path):
    """Its pixel k is k + 0.5 of ours; normalised it is (k + 0.5 - W / 2) / W, the turns of it."""
    shot = {"rotation": [0, 0, 0], "translation": [1, 2, 3], "camera": "pano"}
    cameras = {"pano": {"projection_type": "spherical", "width": 360, "height": 180}}
    path = tmp_path / "reconstruction.json"
    path.write_text(json.dumps([{"cameras": cameras, "shots": {"a.jpg": shot}, "points": {}}]))
    reconstruction = read_opensfm(path)
    x, y = (COLUMN + 0.5 - 180) / 360, (ROW + 0.5 - 90) / 360
    lon, lat = 2 * math.pi * x, -2 * math.pi * y
    assert (math.degrees(lon), math.degrees(lat)) == pytest.approx((90.5, 0.5))
    ray = [[math.cos(lat) * math.sin(lon), -math.sin(lat), math.cos(lat) * math.cos(lon)]]
    np.testing.assert_allclose(ray, RAY, atol=1e-12)
    assert_pixel_has_ray(reconstruction.cameras["pano"], [COLUMN + 0.5, ROW + 0.5], RAY)
    # A pose is cam_from_world: the world's origin is at t in the camera.
    assert reconstruction.images[0].cam_from_world.translation.tolist() == [1, 2, 3]


def test_nerfstudio_has_our_pixels_but_y_up_and_z_backward(tmp_path):
    """theta = -pi (270.5 - 180) / 180 is -90.5 degrees, phi = pi (1/2 + (89.5 - 90) / 180) 89.5."""
    theta, phi = math.radians(-90.5), math.radians(89.5)
    in_opengl = [
        -math.sin(theta) * math.sin(phi),
        math.cos(phi),
        -math.cos(theta) * math.sin(phi),
    ]
    np.testing.assert_allclose(in_opengl, [COS * COS, SIN, COS * SIN], atol=1e-12)
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    frame = {"file_path": "images/a.jpg", "transform_matrix": matrix.tolist()}
    intrinsics = {"w": 360, "h": 180, "fl_x": 180, "fl_y": 180, "cx": 180, "cy": 90}
    path = tmp_path / "transforms.json"
    path.write_text(
        json.dumps({"camera_model": "EQUIRECTANGULAR", **intrinsics, "frames": [frame]})
    )
    reconstruction = read_nerfstudio(path)
    assert_pixel_has_ray(reconstruction.cameras["1"], [COLUMN + 0.5, ROW + 0.5], RAY)
    world_from_cam = reconstruction.images[0].cam_from_world.inverse()
    np.testing.assert_allclose(world_from_cam.rotation @ RAY[0], in_opengl, atol=1e-12)
    np.testing.assert_allclose(world_from_cam.translation, [1, 2, 3], atol=1e-12)


def test_a_trajectory_says_where_the_camera_is_in_the_world(tmp_path):
    """A camera at (1, 2, 3) turned by 90 degrees about y: its z axis is the world's x axis."""
    half = math.sqrt(0.5)
    path = tmp_path / "trajectory.txt"
    path.write_text(f"0.5 1 2 3 0 {half} 0 {half}\n")
    (image,) = read_tum_trajectory(path).images
    camera, pose = Equirectangular(360, 180), image.cam_from_world
    in_camera = pose.rotation @ [6, 2, 3] + pose.translation  # 5 along the world's x from there
    np.testing.assert_allclose(in_camera, [0, 0, 5], atol=1e-12)
    np.testing.assert_allclose(camera.pixels_from_bearings([in_camera]), [[180, 90]], atol=1e-9)


def test_gpano_counts_whole_pixels_from_the_border_of_the_whole_panorama():
    """The part begins at column 90, row 30: its first pixel is 89.5 to the left, 59.5 up."""
    gpano = GPano(part=PanoramaPart(180, 90, 90, 30, 360, 180), pitch_deg=30, roll_deg=0)
    lon, lat = math.radians(-89.5), math.radians(59.5)
    ray = [[math.cos(lat) * math.sin(lon), -math.sin(lat), math.cos(lat) * math.cos(lon)]]
    camera = gpano.camera(180, 90)
    assert_pixel_has_ray(camera, [0.5, 0.5], ray)
    assert parse_gpano(gpano_packet(camera)).part == gpano.part
    # The centre looks 30 degrees up: straight down is 120 degrees below it, behind the camera.
    np.testing.assert_allclose(gpano.down, [0, math.cos(math.pi / 6), -0.5], atol=1e-12)
