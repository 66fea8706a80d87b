# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's project folder: what its own readers find in ours, and what we find in theirs."""

import json
import math

import numpy as np
import pytest

from epi360.cameras import Equirectangular, Pinhole, load_cameras
from epi360.interop import Observations, PosedImage, Reconstruction
from epi360.interop.opensfm import read_opensfm, write_opensfm_folder
from epi360.poses import Pose

IDENTITY = Pose(np.eye(3), np.zeros(3))
CAMERAS = {"pano": Equirectangular(360, 180), "tall": Pinhole(300, 400, 350, 350, 150, 200)}


def scene(names=("a.jpg", "b.jpg")):
    """One point that two cameras see, another one that one of them sees."""
    images = (
        PosedImage(names[0], "pano", IDENTITY, 12.5),
        PosedImage(names[1], "tall", Pose(np.eye(3), np.array([0.0, 0, 1])), 13.0),
    )
    points = np.array([[0.0, 0, 2], [1, 0, 0]])
    colors = np.array([[255, 0, 7], [1, 2, 3]], np.uint8)
    seen = Observations(
        np.array([0, 1, 0]), np.array([1, 0, 0]), np.array([[150.0, 200], [270, 90], [180, 90.5]])
    )
    return Reconstruction(CAMERAS, images, points, colors, seen)


def cells(folder):
    lines = (folder / "tracks.csv").read_text("utf-8").splitlines()
    return lines[0], [line.split("\t") for line in lines[1:]]


def test_the_tracks_have_the_numbers_of_opensfm(tmp_path):
    """x and y from the middle in units of the larger side, 360 and 400.

    The scale is one pixel: a degree of the panorama, in radians, and a 400th of the other image.
    """
    degree = repr(math.pi / 180)
    write_opensfm_folder(tmp_path / "new", scene())
    header, rows = cells(tmp_path / "new")
    assert header == "OPENSFM_TRACKS_VERSION_v2"
    assert rows == [
        ["a.jpg", "1", "0", "0.25", "0.0", degree, "1", "2", "3", "-1", "-1"],
        ["a.jpg", "0", "1", "0.0", repr(0.5 / 360), degree, "255", "0", "7", "-1", "-1"],
        ["b.jpg", "0", "0", "0.0", "0.0", "0.0025", "255", "0", "7", "-1", "-1"],
    ]
    (document,) = json.loads((tmp_path / "new" / "reconstruction.json").read_text())
    assert {row[1] for row in rows} == document["points"].keys()
    assert {row[0] for row in rows} == document["shots"].keys()


def test_every_command_finds_its_files(tmp_path):
    """bundle reads camera_models.json, and exif/NAME.exif of each image."""
    write_opensfm_folder(tmp_path, scene())
    assert load_cameras(tmp_path / "camera_models.json").keys() == CAMERAS.keys()
    (document,) = json.loads((tmp_path / "reconstruction.json").read_text())
    assert json.loads((tmp_path / "camera_models.json").read_text()) == document["cameras"]
    exif = json.loads((tmp_path / "exif" / "b.jpg.exif").read_text())
    assert exif == {
        "camera": "tall", "projection_type": "brown", "width": 300, "height": 400,
        "capture_time": 13.0, "orientation": 1, "gps": {},
    }  # fmt: skip


def test_bundle_is_asked_to_keep_world_and_calibration(tmp_path):
    """Its default turns the world until z is up, and refines focal lengths."""
    write_opensfm_folder(tmp_path, scene())
    config = (tmp_path / "config.yaml").read_text().splitlines()
    assert config == ["align_method: naive", "optimize_camera_parameters: no"]
    origin = json.loads((tmp_path / "reference_lla.json").read_text())
    assert origin == {"latitude": 0, "longitude": 0, "altitude": 0}


def test_what_is_written_reads_back_with_its_observations(tmp_path):
    before = scene()
    write_opensfm_folder(tmp_path, before)
    after = read_opensfm(tmp_path)
    assert [(each.name, each.camera, each.timestamp_s) for each in after.images] == [
        (each.name, each.camera, each.timestamp_s) for each in before.images
    ]
    order = [1, 2, 0]  # by image
    np.testing.assert_array_equal(after.observations.points, before.observations.points[order])
    np.testing.assert_array_equal(after.observations.images, before.observations.images[order])
    np.testing.assert_allclose(
        after.observations.pixels, before.observations.pixels[order], atol=1e-12
    )
    assert read_opensfm(tmp_path / "reconstruction.json").observations is None


@pytest.mark.parametrize(
    ("names", "paths"),
    [
        (("day 1/a.jpg", "b.jpg"), ["day 1/a.jpg", "b.jpg"]),
        (("cam0/1.jpg", "cam1/1.jpg"), ["cam0_1.jpg", "cam1_1.jpg"]),
        (("cam0/a.jpg", "cam1/A.jpg"), ["cam0_a.jpg", "cam1_A.jpg"]),
    ],
)
def test_shots_are_called_as_opensfm_calls_their_pictures(tmp_path, names, paths):
    """It takes the name of a file without its folders, which stand in image_list.txt alone."""
    pictures, project = tmp_path / "in", tmp_path / "new"
    for name in names:
        (pictures / name).parent.mkdir(parents=True, exist_ok=True)
        (pictures / name).write_text(name)
    write_opensfm_folder(project, scene(names), images=pictures)
    listed = (project / "image_list.txt").read_text().splitlines()
    assert listed == [f"images/{path}" for path in paths]
    assert [(project / line).read_text() for line in listed] == list(names)
    (document,) = json.loads((project / "reconstruction.json").read_text())
    shots = [path.rpartition("/")[2] for path in paths]
    assert list(document["shots"]) == shots
    assert {row[0] for row in cells(project)[1]} == set(shots)
    assert {path.name for path in (project / "exif").iterdir()} == {
        f"{name}.exif" for name in shots
    }
    assert [image.name for image in read_opensfm(project).images] == paths
    assert len(read_opensfm(project).observations.points) == 3


def test_lists_of_other_programs_do_not_change_names(tmp_path):
    """OpenDroneMap writes absolute paths; a list may also be wrong or name two pictures alike."""
    write_opensfm_folder(tmp_path, scene())
    for lines in ("/data/x/a.jpg\n/data/x/b.jpg\n", "images/1/a.jpg\nimages/2/a.jpg\n", ""):
        (tmp_path / "image_list.txt").write_text(lines)
        assert [image.name for image in read_opensfm(tmp_path).images] == ["a.jpg", "b.jpg"]


def test_nothing_is_written_where_a_picture_is_missing_or_names_meet(tmp_path):
    (tmp_path / "in").mkdir()
    with pytest.raises(FileNotFoundError, match=r"image .*a\.jpg does not exist"):
        write_opensfm_folder(tmp_path / "new", scene(), images=tmp_path / "in")
    same = ("x/y_z/1.jpg", "x_y/z/1.jpg")  # both 1.jpg, and both x_y_z_1.jpg
    with pytest.raises(ValueError, match="without them two images are equal"):
        write_opensfm_folder(tmp_path / "new", scene(same))
    assert not (tmp_path / "new").exists()


SHOT = {"rotation": [0, math.pi / 2, 0], "translation": [0, 0, 1], "camera": "theta"}
THEIRS = {
    "cameras": {"theta": {"projection_type": "spherical", "width": 360, "height": 180}},
    "shots": {"one.jpg": SHOT, "two.jpg": SHOT},
    "points": {
        "17": {"coordinates": [0, 0, 2], "color": [255, 127, 0]},
        "4": {"coordinates": [1, 0, 2], "color": [0, 0, 0]},
    },
}
VERSIONS = {
    0: "one.jpg\t4\t0\t0.25\t-0.125\t9\t9\t9",
    1: "one.jpg\t4\t0\t0.25\t-0.125\t0.004\t9\t9\t9",
    2: "one.jpg\t4\t0\t0.25\t-0.125\t0.004\t9\t9\t9\t-1\t-1",
}


def write_theirs(folder, tracks, document=THEIRS):
    (folder / "reconstruction.json").write_text(json.dumps([document]))
    (folder / "tracks.csv").write_text(tracks)


@pytest.mark.parametrize("version", VERSIONS)
def test_all_versions_of_the_tracks_are_read(tmp_path, version):
    """x = 0.25 of 360 pixels from the middle is column 270; y = -0.125 is row 90 - 45."""
    header = f"OPENSFM_TRACKS_VERSION_v{version}\n" if version else ""
    row = VERSIONS[version]
    unknown = row.replace("one.jpg", "not posed.jpg"), row.replace("\t4\t", "\t99\t")
    write_theirs(tmp_path, header + "\n".join([unknown[0], row, unknown[1]]) + "\n")
    seen = read_opensfm(tmp_path).observations
    assert (seen.points.tolist(), seen.images.tolist()) == ([1], [0])
    assert seen.pixels.tolist() == [[270, 45]]


@pytest.mark.parametrize(
    ("tracks", "message"),
    [
        ("OPENSFM_TRACKS_VERSION_v3\n", "must have version 0, 1 or 2, got '3'"),
        ("OPENSFM_TRACKS_VERSION_v2\n" + VERSIONS[1], "line 2: it must hold 11 cells"),
        (VERSIONS[0] + "\n" + VERSIONS[0].replace("0.25", "x"), "line 2: it must hold numbers"),
        (VERSIONS[0].replace("0.25", "inf"), "line 1: it must hold finite numbers"),
    ],
)
def test_damaged_tracks_are_named_with_their_line(tmp_path, tracks, message):
    write_theirs(tmp_path, tracks)
    with pytest.raises(ValueError, match=rf"tracks\.csv.* {message}"):
        read_opensfm(tmp_path)


def test_what_has_no_place_here_is_said(tmp_path):
    rig = {"rig_camera_ids": {"one.jpg": "left", "two.jpg": "right"}}
    shots = {"one.jpg": {**SHOT, "gps_position": [1.0, 2.0, 0.0]}, "two.jpg": SHOT}
    write_theirs(tmp_path, "", {**THEIRS, "shots": shots, "rig_instances": {"1": rig}})
    with pytest.warns(UserWarning, match="its rigs and GPS positions and their origin are left"):
        read_opensfm(tmp_path)


@pytest.mark.parametrize(
    "odd", [{"rig_instances": {"1": 3, "2": {"rig_camera_ids": 4}}}, {"reference_lla": {}}]
)
def test_odd_rigs_and_positions_are_no_reason_to_stop(tmp_path, odd):
    shots = {"one.jpg": {**SHOT, "gps_position": 3}, "two.jpg": {**SHOT, "gps_position": [0, 0, 0]}}
    write_theirs(tmp_path, "", {**THEIRS, "shots": shots, **odd})
    assert len(read_opensfm(tmp_path).images) == 2


def test_one_reconstruction_without_its_list_is_read(tmp_path):
    path = tmp_path / "one.json"
    path.write_text(json.dumps(THEIRS))
    assert len(read_opensfm(path).images) == 2


def test_names_that_the_folder_cannot_hold_are_refused_before_anything_is_written(tmp_path):
    for name, message in (("../../x.jpg", "leads out of"), ("a\tb.jpg", "cannot hold a tab")):
        with pytest.raises(ValueError, match=message):
            write_opensfm_folder(tmp_path / "new", scene(("a.jpg", name)))
    assert not list(tmp_path.iterdir())


def test_pictures_that_lie_in_the_project_stay(tmp_path):
    own, others = tmp_path / "images", tmp_path / "others"
    for folder in (own, others):
        folder.mkdir()
        for name in ("a.jpg", "b.jpg"):
            (folder / name).write_text(f"{folder.name} {name}")
    write_opensfm_folder(tmp_path, scene(), images=own)
    with pytest.raises(FileExistsError, match=r"a\.jpg is another picture than .* not replaced"):
        write_opensfm_folder(tmp_path, scene(), images=others)
    for name in ("a.jpg", "b.jpg"):
        assert not (own / name).is_symlink() and (own / name).read_text() == f"images {name}"
