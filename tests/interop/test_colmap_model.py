# SPDX-License-Identifier: BSD-3-Clause
"""Sparse models: what COLMAP reads of ours, what we read of COLMAP's."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from epi360.cameras import DoubleSphere, Equirectangular, KannalaBrandt
from epi360.interop import MatchedImage, MatchGraph, Observations, PosedImage, Reconstruction
from epi360.interop.colmap_model import read_colmap_model, write_colmap_model
from epi360.poses import Pose, rotation_from_vector

pycolmap = pytest.importorskip("pycolmap")

KINDS = pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
SMALL = Reconstruction(
    {"pano": Equirectangular(1000, 500), "fish": KannalaBrandt(800, 600, 300, 301, 400, 300, 0.1)},
    (
        PosedImage("b/ä-1.jpg", "fish", Pose(rotation_from_vector([0.1, 0.2, 0.3]), [1, 2, 3])),
        PosedImage("a-2.jpg", "pano", Pose(rotation_from_vector([0, 3, 0]), [-1, 0, 0])),
        PosedImage("sees_nothing.jpg", "pano", Pose(np.eye(3), np.zeros(3))),
    ),
    np.array([[1.0, 2.0, 1.0 / 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]),
    np.array([[255, 0, 7], [1, 2, 3], [0, 0, 0]], np.uint8),
    Observations(
        np.array([1, 0, 1]),
        np.array([1, 1, 0]),
        np.array([[10.25, 20.5], [30.125, 40.0], [0.1, 0.2]]),
    ),
)


def synthetic_model(**options):
    dataset = pycolmap.SyntheticDatasetOptions()
    dataset.num_points3D = 30
    for name, value in options.items():
        setattr(dataset, name, value)
    return pycolmap.synthesize_dataset(dataset)


def write_theirs(model, folder, text):
    folder.mkdir(exist_ok=True)
    (model.write_text if text else model.write_binary)(folder)


@KINDS
def test_colmap_reads_what_we_write(text, tmp_path):
    write_colmap_model(tmp_path / "new" / "0", SMALL, text=text)
    folder = tmp_path / "new" / "0"
    kind = "txt" if text else "bin"
    names = ("cameras", "frames", "images", "points3D", "rigs")
    assert sorted(file.name for file in folder.iterdir()) == [f"{name}.{kind}" for name in names]
    model = pycolmap.Reconstruction(folder)
    assert model.num_rigs() == 2 and model.num_reg_frames() == 3
    assert model.cameras[1].model_name == "EQUIRECTANGULAR"
    assert model.cameras[2].params.tolist() == [300, 301, 400, 300, 0.1, 0, 0, 0]
    for image_id, image in enumerate(SMALL.images, start=1):
        assert model.images[image_id].name == image.name
        pose = model.images[image_id].cam_from_world().matrix()
        np.testing.assert_allclose(pose, image.cam_from_world.matrix()[:3], atol=1e-15)
    points = [model.points3D[point_id] for point_id in (1, 2, 3)]
    np.testing.assert_array_equal([point.xyz for point in points], SMALL.points)
    np.testing.assert_array_equal([point.color for point in points], SMALL.colors)
    seen = {
        (
            point_id - 1,
            element.image_id - 1,
            *model.images[element.image_id].points2D[element.point2D_idx].xy,
        )
        for point_id, point in model.points3D.items()
        for element in point.track.elements
    }
    observations = SMALL.observations
    assert seen == {
        (point, image, *pixel)
        for point, image, pixel in zip(
            observations.points, observations.images, observations.pixels.tolist(), strict=True
        )
    }


@KINDS
def test_we_read_what_we_write(text, tmp_path):
    write_colmap_model(tmp_path, SMALL, text=text)
    again = read_colmap_model(tmp_path)
    assert list(again.cameras.values()) == list(SMALL.cameras.values())
    for image, expected in zip(again.images, SMALL.images, strict=True):
        assert image.name == expected.name
        assert again.cameras[image.camera] == SMALL.cameras[expected.camera]
        found, pose = image.cam_from_world.matrix(), expected.cam_from_world.matrix()
        np.testing.assert_allclose(found, pose, atol=1e-15)
    np.testing.assert_array_equal(again.points, SMALL.points)
    np.testing.assert_array_equal(again.colors, SMALL.colors)
    assert again.colors.dtype == np.uint8
    np.testing.assert_array_equal(again.observations.points, [1, 1, 0])  # in the images' order
    np.testing.assert_array_equal(again.observations.images, [0, 1, 1])
    pixels = SMALL.observations.pixels[[2, 0, 1]]
    np.testing.assert_array_equal(again.observations.pixels, pixels)


@KINDS
def test_we_read_what_colmap_writes_of_a_rig(text, tmp_path):
    model = synthetic_model(num_rigs=2, num_cameras_per_rig=2, num_frames_per_rig=3)
    write_theirs(model, tmp_path, text)
    reconstruction = read_colmap_model(tmp_path)
    assert len(reconstruction.cameras) == 4 and len(reconstruction.images) == 12
    theirs = [model.images[image_id] for image_id in sorted(model.images)]
    for image, expected in zip(reconstruction.images, theirs, strict=True):
        assert (image.name, image.camera) == (expected.name, str(expected.camera_id))
        pose = expected.cam_from_world().matrix()
        np.testing.assert_allclose(image.cam_from_world.matrix()[:3], pose, atol=1e-12)
    seen = reconstruction.observations
    assert len(seen.points) == model.compute_num_observations()
    for index, image in enumerate(reconstruction.images):
        rows = seen.images == index
        pose, camera = image.cam_from_world, reconstruction.cameras[image.camera]
        points = reconstruction.points[seen.points[rows]] @ pose.rotation.T + pose.translation
        found = camera.pixels_from_bearings(points)
        np.testing.assert_allclose(found, seen.pixels[rows], rtol=0, atol=1e-6)


@KINDS
def test_model_without_points_keeps_its_poses(text, tmp_path):
    images = SMALL.images[:2]
    write_colmap_model(tmp_path, Reconstruction(SMALL.cameras, images), text=text)
    assert pycolmap.Reconstruction(tmp_path).num_reg_images() == 2
    again = read_colmap_model(tmp_path)
    assert len(again.images) == 2 and again.points.shape == (0, 3) and again.observations is None


def test_names_with_spaces_are_kept_or_refused(tmp_path):
    images = tuple(replace(image, name=f"my {image.name}") for image in SMALL.images)
    write_colmap_model(tmp_path / "binary", replace(SMALL, images=images))
    assert pycolmap.Reconstruction(tmp_path / "binary").images[1].name == "my b/ä-1.jpg"
    assert read_colmap_model(tmp_path / "binary").images[0].name == "my b/ä-1.jpg"
    # COLMAP would read "my".
    with pytest.raises(ValueError, match="write 'my b/ä-1.jpg' in binary"):
        write_colmap_model(tmp_path / "text", replace(SMALL, images=images), text=True)
    write_colmap_model(tmp_path / "text", SMALL, text=True)
    path = tmp_path / "text" / "images.txt"
    path.write_text(path.read_text("utf-8").replace("b/ä-1", "b/ä 1"), "utf-8")
    assert read_colmap_model(tmp_path / "text").images[0].name == "b/ä 1.jpg"


def test_model_of_an_older_colmap_has_no_rigs(tmp_path):
    write_colmap_model(tmp_path, SMALL)
    (tmp_path / "rigs.bin").unlink()
    (tmp_path / "frames.bin").unlink()
    assert len(read_colmap_model(tmp_path).images) == 3


@pytest.mark.parametrize(
    "line", ["SPHERICAL 1000 500 1000 500", "SPHERE 1000 500 1 500 250", "SPHERE 1000 500 1000 500"]
)
def test_panoramas_of_forks_are_known_in_text(line, tmp_path):
    write_colmap_model(tmp_path, SMALL, text=True)
    cameras = tmp_path / "cameras.txt"
    text = cameras.read_text("utf-8")
    assert "1 EQUIRECTANGULAR 1000 500 1000.0 500.0" in text
    cameras.write_text(text.replace("EQUIRECTANGULAR 1000 500 1000.0 500.0", line), "utf-8")
    with pytest.raises(ValueError):
        pycolmap.Reconstruction(tmp_path)
    assert read_colmap_model(tmp_path).cameras["1"] == Equirectangular(1000, 500)


def test_model_is_replaced_but_not_hidden_by_one_of_the_other_kind(tmp_path):
    write_colmap_model(tmp_path, SMALL)
    write_colmap_model(tmp_path, replace(SMALL, images=SMALL.images[:2]))
    assert len(read_colmap_model(tmp_path).images) == 2
    with pytest.raises(ValueError, match=r"has a COLMAP model in \.bin already"):
        write_colmap_model(tmp_path, SMALL, text=True)


def test_what_cannot_be_written_leaves_no_folder(tmp_path):
    image, pose = SMALL.images[0], SMALL.images[0].cam_from_world
    sphere = DoubleSphere(640, 480, 240, 240, 320, 240, -0.2, 0.58)
    for wrong, message in (
        (Reconstruction({}, ()), "must have an image"),
        (Reconstruction({}, (replace(image, camera=None),)), "needs the camera of image"),
        (Reconstruction({"s": sphere}, (PosedImage("a", "s", pose),)), "equal to DoubleSphere"),
        (replace(SMALL, images=(replace(image, cam_from_world=Pose.nan()),)), "has no pose"),
    ):
        with pytest.raises(ValueError, match=message):
            write_colmap_model(tmp_path / "model", wrong)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("share", [0, 0.3, 0.99])
def test_truncated_file_is_one_clear_error(name, share, tmp_path):
    write_theirs(synthetic_model(num_rigs=1, num_frames_per_rig=3), tmp_path, text=False)
    path = tmp_path / f"{name}.bin"
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ValueError, match=f"{name}.bin cannot be used: .*truncated") as raised:
        read_colmap_model(tmp_path)
    assert "\n" not in str(raised.value)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("bits", [0x7FF0000000000001, 0x7FF8000000000000, 0x7FEFFFFFFFFFFFFF])
def test_a_rotation_of_a_binary_file_that_is_no_number_is_one_clear_error(bits, tmp_path):
    write_colmap_model(tmp_path, SMALL)
    data = bytearray((tmp_path / "images.bin").read_bytes())
    data[12:44] = 4 * bits.to_bytes(8, "little")  # signalling and quiet NaN, the largest number
    (tmp_path / "images.bin").write_bytes(data)
    with pytest.raises(ValueError, match="must have a rotation"):
        read_colmap_model(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("images.txt", "1 1 0 0 0 0 0 0\n\n", "images.txt cannot be used"),
        ("images.txt", "1 1 0 0 0 0 0 x 1 a.jpg\n\n", "could not convert string to float: 'x'"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n1 2\n", "7 numbers, a camera, a name and triples"),
        ("images.txt", "1 0 0 0 0 0 0 0 1 a.jpg\n\n", "a.jpg must have a rotation"),
        ("images.txt", "1 1 0 0 0 0 0 0 7 a.jpg\n\n", "a.jpg has the unknown camera '7'"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n5 6 77\n", "points that are not there"),
        ("points3D.txt", "1 2 3 4 5\n", "point 1 must have 3 numbers, a color"),
        ("points3D.txt", "1 2 3 4 300 0 0 1\n", "cannot be used: the color of point 1"),
        ("cameras.txt", "1 FOV 64 48 30 30 32 24 1\n", "'FOV' is not supported; supported: EQUI"),
    ],
)
def test_damaged_text_is_one_clear_error(name, content, message, tmp_path):
    write_colmap_model(tmp_path, SMALL, text=True)
    (tmp_path / name).write_text(content, "utf-8")
    with pytest.raises(ValueError, match=message) as raised:
        read_colmap_model(tmp_path)
    assert str(tmp_path) in str(raised.value) and "\n" not in str(raised.value)


def test_missing_model_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match="does not exist"):
        read_colmap_model(tmp_path / "none")
    write_colmap_model(tmp_path, SMALL)
    shutil.move(tmp_path / "points3D.bin", tmp_path / "points3D.txt")
    with pytest.raises(FileNotFoundError, match="no COLMAP model: it must have cameras, images"):
        read_colmap_model(tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process are POSIX")
@KINDS
def test_full_disk_is_one_clear_error_and_keeps_the_old_model(text, tmp_path):
    write_colmap_model(tmp_path, SMALL, text=text)
    code = """
import resource, signal, sys
from dataclasses import replace
from test_colmap_model import SMALL, write_colmap_model
import numpy as np
more = replace(SMALL, points=np.ones((999, 3)), colors=np.ones((999, 3), np.uint8))
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
try:
    write_colmap_model(sys.argv[1], more, text=sys.argv[2] == "True")
except OSError as error:
    print(error)
"""
    answer = subprocess.run(
        [sys.executable, "-c", code, tmp_path, str(text)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        timeout=60,
    )
    assert "File too large" in answer.stdout, answer.stderr
    assert len(read_colmap_model(tmp_path).points) == 3 and len(list(tmp_path.iterdir())) == 5


def test_white_space_of_other_scripts_is_part_of_a_name(tmp_path):
    """COLMAP's text ends a name at a blank alone, a line at a line feed alone."""
    names = ["部屋\u3000一.jpg", "a\u2028b.jpg", "a\x85b.jpg"]
    images = tuple(
        replace(image, name=name) for image, name in zip(SMALL.images, names, strict=True)
    )
    write_colmap_model(tmp_path, replace(SMALL, images=images), text=True)
    assert [image.name for image in read_colmap_model(tmp_path).images] == names
    theirs = pycolmap.Reconstruction(tmp_path).images
    assert [theirs[image_id].name for image_id in (1, 2, 3)] == names


@pytest.mark.parametrize("name", [" a.jpg", "a.jpg ", "a\tb.jpg"])
def test_a_blank_at_an_end_of_a_name_is_refused_in_text(tmp_path, name):
    images = (replace(SMALL.images[0], name=name),)
    with pytest.raises(ValueError, match="COLMAP's text ends names at a space"):
        write_colmap_model(tmp_path, Reconstruction(SMALL.cameras, images), text=True)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("points3D", "1 1.0", "18446744073709551615 1.0", "ids must be 0 to 2"),
        ("points3D", "1 1.0", "2 1.0", "points3D.txt .* id 2 is there twice"),
        ("points3D", "1 1.0", "1 nan", "point 1 must be finite"),
        ("images", "-1.0 0.0 0.0 1 a", "nan 0.0 0.0 1 a", "of image a-2.jpg must be finite"),
        ("images", "10.25", "inf", "of image a-2.jpg must be finite"),
        ("images", "10.25 20.5 2", "10.25 20.5 99999999999999999999", "images.txt cannot be used"),
    ],
)
def test_numbers_that_fit_no_model_are_one_clear_error(tmp_path, file, old, new, message):
    write_colmap_model(tmp_path, SMALL, text=True)
    path = tmp_path / f"{file}.txt"
    text = path.read_text("utf-8")
    assert text.count(old) == 1
    path.write_text(text.replace(old, new), "utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        read_colmap_model(tmp_path)
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("name", ["a\udcff.jpg", ""])
def test_a_name_that_is_no_text_is_refused(name):
    with pytest.raises(ValueError, match="must be Unicode text; rename|must have a name"):
        Reconstruction(SMALL.cameras, (replace(SMALL.images[0], name=name),))
    with pytest.raises(ValueError, match="must be Unicode text; rename|must have a name"):
        MatchGraph({}, {name: MatchedImage(name, None, np.zeros((0, 2)))}, ())
