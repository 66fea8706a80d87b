# SPDX-License-Identifier: BSD-3-Clause
"""Which images were taken near each other, by GPS or by a trajectory."""

import json

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from epi360.features.image_headers import read_image_header
from epi360.jobs.folder.image_set import find_images
from epi360.jobs.pairs.positions import near_pairs, positions_of_images
from epi360.poses import Pose, rotation_from_vector

LINE = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [6, 0, 0], [10, 0, 0]])


def write_picture(path, latitude=None, longitude=None, references="NE"):
    """Panorama whose Exif states a place: degrees, minutes and seconds."""
    exif = Image.Exif()
    if latitude is not None:
        rational = TiffImagePlugin.IFDRational
        angles = [
            tuple(rational(int(round(part * 1000)), 1000) for part in angle)
            for angle in (latitude, longitude)
        ]
        exif[34853] = {1: references[0], 2: angles[0], 3: references[1], 4: angles[1]}
    written = Image.Exif()
    written.load(exif.tobytes())
    pixels = np.random.default_rng(0).integers(0, 255, (32, 64, 3), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, exif=written)


@pytest.mark.parametrize("extension", ["jpg", "png", "tif"])
def test_the_place_of_a_picture_is_in_its_exif(tmp_path, extension):
    path = tmp_path / f"a.{extension}"
    write_picture(path, (48, 8, 30.6), (11, 34, 30.0))
    latitude, longitude = read_image_header(path).latitude_longitude_deg
    assert latitude == pytest.approx(48 + 8 / 60 + 30.6 / 3600, abs=1e-9)
    assert longitude == pytest.approx(11 + 34.5 / 60, abs=1e-9)


def test_south_and_west_are_negative(tmp_path):
    write_picture(tmp_path / "a.jpg", (33, 30, 0), (70, 45, 0), "SW")
    assert read_image_header(tmp_path / "a.jpg").latitude_longitude_deg == (-33.5, -70.75)


@pytest.mark.parametrize(
    ("latitude", "longitude", "references"),
    [
        ((0, 0, 0), (0, 0, 0), "NE"),  # a receiver without a fix
        ((91, 0, 0), (0, 0, 0), "NE"),
        ((48, 0, 0), (181, 0, 0), "NE"),
        ((48, 0, 0), (11, 0, 0), "XE"),
    ],
)
def test_a_place_that_is_none_is_not_known(tmp_path, latitude, longitude, references):
    write_picture(tmp_path / "a.jpg", latitude, longitude, references)
    assert read_image_header(tmp_path / "a.jpg").latitude_longitude_deg is None


def test_each_image_is_paired_with_its_nearest():
    assert near_pairs(LINE, 1, None) == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert near_pairs(LINE[[4, 0, 2, 1, 3]], 1, None) == [(0, 4), (1, 3), (2, 3), (2, 4)]


def test_what_is_farther_than_the_radius_is_no_partner():
    assert near_pairs(LINE, 4, 2.0) == [(0, 1), (1, 2)]
    assert near_pairs(LINE, 4, 1.999) == [(0, 1)]


def test_an_image_without_a_place_gets_no_partner():
    centers = LINE.copy()
    centers[1] = np.nan
    assert near_pairs(centers, 1, None) == [(0, 2), (2, 3), (3, 4)]
    assert near_pairs(np.full((3, 3), np.nan), 1, None) == []


def test_the_next_ones_take_the_place_of_near_pairs_that_are_there():
    assert near_pairs(LINE, 1, None, without={(0, 1)}) == [(0, 2), (1, 2), (2, 3), (3, 4)]


def test_images_of_one_place_are_partners():
    assert near_pairs(np.zeros((3, 3)), 20, 0.5) == [(0, 1), (0, 2), (1, 2)]


def test_gps_gives_distances_in_metres(tmp_path):
    write_picture(tmp_path / "a.jpg", (48, 0, 0), (11, 0, 0))
    write_picture(tmp_path / "b.jpg", (48, 0, 0.36), (11, 0, 0))  # 1e-4 degrees
    write_picture(tmp_path / "c.jpg", (48, 0, 0), (11, 0, 3.6))  # 1e-3 degrees to the east
    write_picture(tmp_path / "d.jpg")
    positions = positions_of_images(find_images(tmp_path), None)
    a, b, c, d = positions.centers
    assert np.linalg.norm(b - a) == pytest.approx(11.12, abs=0.01)  # 111.2 km a degree
    assert np.linalg.norm(c - a) == pytest.approx(74.4, abs=0.1)
    assert np.isnan(d).all()
    assert positions.num_unknown == 1
    assert positions.source == "GPS"


def test_gps_is_near_across_the_date_line(tmp_path):
    write_picture(tmp_path / "a.jpg", (10, 0, 0), (179, 59, 59.99))
    write_picture(tmp_path / "b.jpg", (10, 0, 0), (179, 59, 59.99), "NW")
    a, b = positions_of_images(find_images(tmp_path), None).centers
    assert np.linalg.norm(b - a) < 1.0


def test_images_without_gps_need_positions(tmp_path):
    write_picture(tmp_path / "a.jpg")
    with pytest.raises(ValueError, match="none of the 1 images has GPS .* --positions FILE"):
        positions_of_images(find_images(tmp_path), None)


def tum(times, centers):
    pose = rotation_from_vector([0.3, -0.2, 1.0])  # the place does not depend on where it looks
    x, y, z, w = np.roll(Pose(pose, np.zeros(3)).quaternion_wxyz, -1)
    rows = zip(times, centers, strict=True)
    return "\n".join(f"{time} {cx} {cy} {cz} {x} {y} {z} {w}" for time, (cx, cy, cz) in rows)


def test_a_trajectory_is_found_by_the_times_in_the_table_of_frames(tmp_path):
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        write_picture(tmp_path / "images" / name)
    table = "image,timestamp_s\na.jpg,2.0\nb.jpg,1.004\nc.jpg,7\n"
    (tmp_path / "images" / "frames.csv").write_text(table)
    (tmp_path / "poses.txt").write_text(tum([0.5, 1.0, 2.0], LINE[:3]))
    images = find_images(tmp_path / "images")
    positions = positions_of_images(images, tmp_path / "poses.txt")
    np.testing.assert_allclose(positions.centers, [LINE[2], LINE[1], [np.nan] * 3], atol=1e-12)


def test_an_image_without_a_time_in_the_table_has_that_of_its_name(tmp_path):
    write_picture(tmp_path / "images" / "2.0.jpg")
    (tmp_path / "images" / "frames.csv").write_text("image,timestamp_s\n2.0.jpg,\n")
    (tmp_path / "poses.txt").write_text(tum([1.0, 2.0], LINE[:2]))
    positions = positions_of_images(find_images(tmp_path / "images"), tmp_path / "poses.txt")
    np.testing.assert_allclose(positions.centers, [LINE[1]], atol=1e-12)


def test_names_that_are_times_are_seconds_or_nanoseconds(tmp_path):
    write_picture(tmp_path / "images" / "left" / "1403636579763555584.jpg")
    write_picture(tmp_path / "images" / "left" / "1403636580.5.jpg")
    (tmp_path / "poses.txt").write_text(tum(["1403636579.763556", "1403636580.5"], LINE[1:3]))
    images = find_images(tmp_path / "images")
    positions = positions_of_images(images, tmp_path / "poses.txt")
    rows = [image.name for image in images.images].index("left/1403636580.5.jpg")
    np.testing.assert_allclose(positions.centers[rows], LINE[2], atol=1e-12)
    np.testing.assert_allclose(positions.centers[1 - rows], LINE[1], atol=1e-12)


def test_a_model_is_found_by_the_names_of_the_images(tmp_path):
    for name in ("a.jpg", "b.jpg"):
        write_picture(tmp_path / "images" / name)
    matrix = np.eye(4)
    matrix[:3, 3] = [1.0, 2.0, 3.0]
    document = {
        "camera_model": "OPENCV", "w": 64, "h": 32, "fl_x": 30, "fl_y": 30, "cx": 32, "cy": 16,
        "frames": [{"file_path": "images/b.jpg", "transform_matrix": matrix.tolist()}],
    }  # fmt: skip
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    images = find_images(tmp_path / "images")
    positions = positions_of_images(images, tmp_path / "transforms.json")
    assert positions.num_unknown == 1
    assert np.isfinite(positions.centers[1]).all()


def test_images_without_times_do_not_fit_a_trajectory(tmp_path):
    write_picture(tmp_path / "images" / "kitchen.jpg")
    (tmp_path / "poses.txt").write_text(tum([0.0, 1.0], LINE[:2]))
    with pytest.raises(ValueError, match=r"no times: put a table frames\.csv"):
        positions_of_images(find_images(tmp_path / "images"), tmp_path / "poses.txt")


def test_a_trajectory_of_other_times_is_refused(tmp_path):
    write_picture(tmp_path / "images" / "5.jpg")
    (tmp_path / "poses.txt").write_text(tum([0.0, 1.0], LINE[:2]))
    with pytest.raises(ValueError, match="none of the 2 poses of .* is that of an image"):
        positions_of_images(find_images(tmp_path / "images"), tmp_path / "poses.txt")
