# SPDX-License-Identifier: BSD-3-Clause
"""nerfstudio's transforms.json and the points beside it."""

import json
import struct

import numpy as np
import pytest

from epi360.cameras import (
    DoubleSphere,
    Equirectangular,
    KannalaBrandt,
    Pinhole,
    UnifiedCamera,
)
from epi360.interop.nerfstudio import read_nerfstudio, write_nerfstudio
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.poses import Pose, rotation_from_vector

PANORAMA = {
    "camera_model": "EQUIRECTANGULAR", "w": 360, "h": 180,
    "fl_x": 180, "fl_y": 180, "cx": 180, "cy": 90,
}  # fmt: skip
IDENTITY = np.eye(4).tolist()
FRAME = {"file_path": "images/a.jpg", "transform_matrix": IDENTITY}
DOCUMENT = {**PANORAMA, "frames": [FRAME]}


@pytest.fixture
def write(tmp_path):
    def write(document):
        path = tmp_path / "transforms.json"
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        return path

    return write


def nerfstudio_directions(entry, pixels):
    """Directions in nerfstudio's camera, by the formulas of its cameras.py; y up, z backward."""
    x = (pixels[:, 0] - entry["cx"]) / entry["fl_x"]
    y = (pixels[:, 1] - entry["cy"]) / entry["fl_y"]
    if entry["camera_model"] == "EQUIRECTANGULAR":
        theta, phi = -np.pi * x, np.pi * (0.5 + y)
        return np.column_stack(
            [-np.sin(theta) * np.sin(phi), np.cos(phi), -np.cos(theta) * np.sin(phi)]
        )
    if entry["camera_model"] == "OPENCV_FISHEYE":
        theta = np.hypot(x, y)
        return np.column_stack(
            [x * np.sinc(theta / np.pi), -y * np.sinc(theta / np.pi), -np.cos(theta)]
        )
    directions = np.column_stack([x, -y, -np.ones(len(x))])
    return directions / np.linalg.norm(directions, axis=1)[:, None]


@pytest.mark.parametrize(
    "camera",
    [
        Equirectangular(360, 180),
        Equirectangular(
            600,
            340,
            horizontal_fov_deg=210,
            vertical_fov_deg=100,
            center_longitude_deg=30,
            center_latitude_deg=-20,
        ),
        Pinhole(640, 480, 400, 410, 310.5, 250),
        KannalaBrandt(640, 480, 200, 210, 310.5, 250),
    ],
    ids=lambda camera: type(camera).__name__,
)
def test_a_pixel_has_the_ray_that_nerfstudio_gives_it(tmp_path, camera):
    path = tmp_path / "transforms.json"
    image = PosedImage("a.jpg", "c", Pose(np.eye(3), np.zeros(3)))
    write_nerfstudio(path, Reconstruction({"c": camera}, (image,)))
    document = json.loads(path.read_text())
    rng = np.random.default_rng(0)
    pixels = rng.uniform([0, 0], [camera.width, camera.height], (200, 2))
    in_opengl = nerfstudio_directions(document, pixels)
    matrix = np.array(document["frames"][0]["transform_matrix"])
    saved_from_world = np.array(document["applied_transform"])[:, :3]
    np.testing.assert_allclose(
        in_opengl @ matrix[:3, :3].T @ saved_from_world,
        camera.bearings_from_pixels(pixels),
        atol=1e-12,
    )


def test_the_identity_looks_along_minus_z_with_y_up(write):
    """Image centre: world -z. A quarter to the right: world x. The top border: world y."""
    reconstruction = read_nerfstudio(write(DOCUMENT))
    (image,) = reconstruction.images
    bearings = reconstruction.cameras[image.camera].bearings_from_pixels(
        [[180, 90], [270, 90], [0, 0]]
    )
    in_world = bearings @ image.cam_from_world.inverse().rotation.T
    np.testing.assert_allclose(in_world, [[0, 0, -1], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    assert image.name == "a.jpg"


def test_the_last_column_is_where_the_camera_is(write):
    matrix = np.eye(4)
    matrix[:3, 3] = 1, 2, 3
    (image,) = read_nerfstudio(
        write({**PANORAMA, "frames": [{**FRAME, "transform_matrix": matrix.tolist()}]})
    ).images
    np.testing.assert_allclose(image.cam_from_world.inverse().translation, [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(image.cam_from_world.translation, [-1, 2, 3], atol=1e-12)


ASCII_PLY = (
    "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 1\nproperty float x\n"
    "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
    "property uchar blue\nend_header\n2 1 -3 255 128 0\n"
)


@pytest.mark.parametrize(
    ("applied", "saved_point"),
    [
        # nerfstudio's own, which is its inverse: x and y swapped, z flipped.
        ([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]], (2, 1, -3)),
        # 90 degrees about z takes (1, 2, 3) to (-2, 1, 3), then 10 along x.
        ([[0, -1, 0, 10], [1, 0, 0, 0], [0, 0, 1, 0]], (8, 1, 3)),
    ],
)
def test_an_applied_transform_is_undone_for_cameras_and_points(
    tmp_path, write, applied, saved_point
):
    opengl = np.array([[1.0, 0, 0, 1], [0, -1, 0, 2], [0, 0, -1, 3], [0, 0, 0, 1]])
    saved = [*(np.array(applied) @ opengl).tolist(), [0, 0, 0, 1]]
    ply = ASCII_PLY.replace("2 1 -3", " ".join(map(str, saved_point)))
    (tmp_path / "sparse_pc.ply").write_text(ply)
    document = {
        **PANORAMA,
        "applied_transform": applied,
        "ply_file_path": "sparse_pc.ply",
        "frames": [{**FRAME, "transform_matrix": saved}],
    }
    reconstruction = read_nerfstudio(write(document))
    world_from_cam = reconstruction.images[0].cam_from_world.inverse()
    np.testing.assert_allclose(world_from_cam.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(world_from_cam.translation, [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(reconstruction.points, [[1, 2, 3]], atol=1e-12)
    assert reconstruction.colors.tolist() == [[255, 128, 0]]


def posed(names_and_cameras):
    rng = np.random.default_rng(0)
    return tuple(
        PosedImage(name, camera, Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)))
        for name, camera in names_and_cameras
    )


CAMERA_GROUPS = {
    "panoramas": {
        "whole": Equirectangular(5760, 2880),
        "small": Equirectangular(2048, 1024),
        "part": Equirectangular(600, 340, 210, 100, 30, -20),
    },
    "one": {"whole": Equirectangular(5760, 2880)},
    "fisheyes": {
        "front": KannalaBrandt(848, 800, 285, 286, 424, 399, -0.006, 0.04, -0.04, 0.007),
        "back": KannalaBrandt(848, 800, 285, 286, 424, 399),
    },
    "perspective": {
        "plain": Pinhole(640, 480, 400, 410, 310.5, 250),
        "lens": UnifiedCamera(640, 480, 400, 410, 310.5, 250, 0, -0.1, 0.02, 0.001, -0.002),
    },
}


@pytest.mark.parametrize("group", CAMERA_GROUPS)
def test_what_is_written_reads_back(tmp_path, group):
    cameras = CAMERA_GROUPS[group]
    images = posed((f"Stra\u00dfe/{name} \u6771.jpg", name) for name in cameras)
    rng = np.random.default_rng(0)
    points, colors = rng.normal(size=(20, 3)), rng.integers(0, 256, (20, 3)).astype(np.uint8)
    path = tmp_path / "transforms.json"
    write_nerfstudio(path, Reconstruction(cameras, images, points, colors), images="pictures")
    after = read_nerfstudio(path, images="pictures")
    for one, other in zip(images, after.images, strict=True):
        assert one.name == other.name
        camera, read = cameras[one.camera], after.cameras[other.camera]
        assert type(read) is type(camera)
        for field in vars(camera):
            assert getattr(read, field) == pytest.approx(getattr(camera, field), abs=1e-9)
        np.testing.assert_allclose(
            one.cam_from_world.matrix(), other.cam_from_world.matrix(), atol=1e-12
        )
    np.testing.assert_allclose(points, after.points, atol=1e-12)  # they were turned and back
    np.testing.assert_array_equal(colors, after.colors)


def test_the_written_file_is_what_nerfstudio_expects(tmp_path):
    path = tmp_path / "transforms.json"
    image = PosedImage("sub/\u00e4.jpg", "pano", Pose(np.eye(3), np.array([0.0, 0, 5])))
    points = np.array([[1.0, 2, 3]])
    colors = np.array([[9, 8, 7]], np.uint8)
    write_nerfstudio(
        path, Reconstruction({"pano": Equirectangular(360, 180)}, (image,), points, colors)
    )
    document = json.loads(path.read_text(encoding="utf-8"))
    assert {key: document[key] for key in PANORAMA} == PANORAMA
    # z is up, as -y was: (x, y, z) becomes (x, z, -y), and nerfstudio is to leave it so.
    assert document["applied_transform"] == [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]]
    assert document["orientation_override"] == "none"
    (frame,) = document["frames"]
    assert frame["file_path"] == "images/sub/\u00e4.jpg"
    # The camera is at (0, 0, -5) of the world; its y axis is up, and it looks along the saved y.
    assert frame["transform_matrix"] == [[1, 0, 0, 0], [0, 0, -1, -5], [0, 1, 0, 0], [0, 0, 0, 1]]
    ply = (tmp_path / document["ply_file_path"]).read_bytes()
    header, body = ply.split(b"end_header\n")
    assert header.startswith(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n")
    assert body == b"1.0 3.0 -2.0 9 8 7\n"


def test_each_frame_names_its_mask_or_none_does(tmp_path):
    path = tmp_path / "transforms.json"
    source = Reconstruction({"p": Equirectangular(360, 180)}, posed([("a.jpg", "p"), ("b", "p")]))
    write_nerfstudio(path, source, masks={"a.jpg": "masks/a.jpg.png", "b": "../one.png"})
    frames = json.loads(path.read_text())["frames"]
    assert [frame["mask_path"] for frame in frames] == ["masks/a.jpg.png", "../one.png"]
    write_nerfstudio(path, source)
    assert "mask_path" not in path.read_text()
    with pytest.raises(ValueError, match="masks of all images or of none, image b has none"):
        write_nerfstudio(path, source, masks={"a.jpg": "masks/a.jpg.png"})


def test_intrinsics_of_a_frame_count_unless_the_file_has_them_for_all(write):
    lens = {"camera_model": "OPENCV", "w": 640, "h": 480.0, "fl_x": 400, "fl_y": 400, "cx": 320}
    frames = [
        {**FRAME, "file_path": "./images/a.jpg", "cy": 240, "fl_x": 7},
        {**FRAME, "file_path": "./images/b.jpg", "cy": 240},
        {**FRAME, "file_path": "./images/c.jpg", "cy": 250, "k1": -0.1},
    ]
    reconstruction = read_nerfstudio(write({**lens, "frames": frames}))
    assert reconstruction.cameras == {
        "1": Pinhole(640, 480, 400, 400, 320, 240),
        "2": UnifiedCamera(640, 480, 400, 400, 320, 250, 0, -0.1),
    }
    assert [(image.name, image.camera) for image in reconstruction.images] == [
        ("a.jpg", "1"), ("b.jpg", "1"), ("c.jpg", "2"),
    ]  # fmt: skip


def test_names_keep_their_folder_where_an_image_lies_elsewhere(write):
    frames = [FRAME, {**FRAME, "file_path": "extra/a.jpg"}]
    names = [image.name for image in read_nerfstudio(write({**PANORAMA, "frames": frames})).images]
    assert names == ["images/a.jpg", "extra/a.jpg"]


def test_single_precision_rotations_become_exact_ones(write):
    rotation = rotation_from_vector([0.3, -0.2, 0.9]).astype(np.float32)
    matrix = np.eye(4)
    matrix[:3, :3] = np.round(rotation, 5)
    (image,) = read_nerfstudio(
        write({**PANORAMA, "frames": [{**FRAME, "transform_matrix": matrix.tolist()}]})
    ).images
    R = image.cam_from_world.rotation
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ({"a": DoubleSphere(64, 64, 30, 30, 32, 32, -0.2, 0.6)}, "has no DoubleSphere model"),
        ({"a": UnifiedCamera(64, 64, 30, 30, 32, 32, 0.9)}, "camera a: .*xi = 0"),
        (
            {"a": Equirectangular(64, 32), "b": Pinhole(64, 32, 30, 30, 32, 16)},
            "one camera model a file, the reconstruction needs EQUIRECTANGULAR, PINHOLE",
        ),
    ],
)
def test_a_camera_that_nerfstudio_lacks_is_refused_and_nothing_is_written(
    tmp_path, cameras, message
):
    images = posed((f"{name}.jpg", name) for name in cameras)
    points = np.zeros((1, 3))
    with pytest.raises(ValueError, match=message):
        write_nerfstudio(
            tmp_path / "transforms.json",
            Reconstruction(cameras, images, points, points.astype(np.uint8)),
        )
    assert list(tmp_path.iterdir()) == []


def changed(**parts):
    return {**DOCUMENT, **parts}


def frame(**parts):
    return {**DOCUMENT, "frames": [FRAME, {**FRAME, "file_path": "images/b.jpg", **parts}]}


TWICE, MIRROR = np.diag([2.0, 2, 2, 1]).tolist(), np.diag([1.0, 1, -1, 1]).tolist()


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ('{"frames": [', "must be JSON"),
        ("[1]", "it must be a mapping"),
        (PANORAMA, "missing keys: frames"),
        (changed(frames=[]), "frames must be a list, with one frame at least"),
        (changed(frames=["a.jpg"]), "frame 0 must be a mapping"),
        (changed(frames=[{"transform_matrix": IDENTITY}]), "frame 0 must have a file_path"),
        (frame(transform_matrix=None), r"frame 1 \(b.jpg\): transform_matrix must be 3 x 4 finite"),
        (
            changed(frames=[{"file_path": "images/a.jpg"}]),
            r"frame 0 \(a.jpg\): missing keys: transform_matrix",
        ),
        (frame(transform_matrix=(np.eye(4) * np.nan).tolist()), "must be 4 x 4 finite numbers"),
        (
            frame(transform_matrix=TWICE),
            r"frame 1 \(b.jpg\): transform_matrix must hold a rotation",
        ),
        (frame(transform_matrix=MIRROR), "must hold a rotation, got a matrix with determinant -1"),
        (
            frame(transform_matrix=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]),
            "last row of transform_matrix",
        ),
        (frame(file_path="images/a.jpg"), "image a.jpg is there twice"),
        (changed(camera_model="VR180_L"), "'VR180_L' is not supported; supported: EQUIRECTANGULAR"),
        (
            {"camera_angle_x": 0.7, "frames": [FRAME]},
            r"frame 0 \(a.jpg\): missing keys: w, h, fl_x",
        ),
        (changed(fl_x=90), "horizontal_fov_deg must be at most 360, got 720"),
        (changed(fl_x=0), "fl_x must be positive"),
        (changed(camera_model="OPENCV", k3=0.1), "OPENCV with k3 = 0.1 is not supported"),
        (changed(camera_model="OPENCV_FISHEYE", p1=0.1), "OPENCV_FISHEYE with p1 = 0.1"),
        (changed(applied_transform=[[1, 0, 0], [0, 1, 0]]), "applied_transform must be 3 x 4"),
        (changed(applied_scale=0.5), "applied_scale is not supported"),
        (changed(ply_file_path=3), "ply_file_path must be a path"),
    ],
)
def test_a_bad_file_is_named_with_the_place(write, document, message):
    path = write(document)
    with pytest.raises(ValueError, match=message) as caught:
        read_nerfstudio(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 350


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no points", "it has no header"),
        (ASCII_PLY.replace("vertex 1", "vertex 2").encode(), "it is cut off"),
        (ASCII_PLY.replace("ascii", "binary_little_endian").encode()[:-4], "it is cut off"),
        (ASCII_PLY.replace("property float z\n", "").encode(), "no x, y, z"),
        (ASCII_PLY.replace("vertex", "face").encode(), "first element is not the vertices"),
        (ASCII_PLY.replace("2 1 -3", "2 nan -3").encode(), "must hold finite points"),
        (ASCII_PLY.encode()[:20], "it has no header"),
    ],
)
def test_bad_points_are_named(tmp_path, write, content, message):
    (tmp_path / "points.ply").write_bytes(content)
    with pytest.raises(ValueError, match=f"points.ply must .*{message}|points.ply {message}"):
        read_nerfstudio(write(changed(ply_file_path="points.ply")))


def test_missing_points_are_named(write):
    with pytest.raises(FileNotFoundError, match=r"points.ply does not exist"):
        read_nerfstudio(write(changed(ply_file_path="points.ply")))


def test_points_without_color_and_with_other_properties_are_read(tmp_path, write):
    header = (
        "ply\nformat binary_big_endian 1.0\nelement vertex 2\nproperty float32 x\n"
        "property float32 y\nproperty float32 z\nproperty double weight\n"
        "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = struct.pack(">3fd3fd", 1, 2, 3, 0.5, 4, 5, 6, 0.5)
    (tmp_path / "points.ply").write_bytes(header.encode() + body)
    reconstruction = read_nerfstudio(write(changed(ply_file_path="points.ply")))
    assert reconstruction.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert reconstruction.colors.tolist() == [[0, 0, 0], [0, 0, 0]]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [1e154, 1e308])
def test_a_matrix_of_huge_numbers_is_no_rotation(number):
    from epi360.interop.checks import pose_of_matrix

    matrix = np.diag([number, number, 1.0, 1.0]).tolist()
    with pytest.raises(ValueError, match="must hold a rotation, got a matrix with determinant"):
        pose_of_matrix(matrix, "applied_transform")


def test_the_folder_of_the_images_may_be_named_as_it_is_seen_from_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    camera = Pinhole(8, 4, 5.0, 5.0, 4.0, 2.0)
    images = (PosedImage("front/1.png", "1", Pose(np.eye(3), np.zeros(3))),)
    (tmp_path / "map").mkdir()
    path = tmp_path / "map" / "transforms.json"
    write_nerfstudio(path, Reconstruction({"1": camera}, images), images="../pictures")
    for folder in ("../pictures", "pictures", str(tmp_path / "pictures")):
        assert read_nerfstudio(path, images=folder).images[0].name == "front/1.png"
    assert read_nerfstudio(path).images[0].name == "../pictures/front/1.png"
