# SPDX-License-Identifier: BSD-3-Clause
"""The how-tos run, command by command, on scenes that the package renders."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from documents import ROOT, check_links, run_document

from epi360 import cli
from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import scene

DOCS = ROOT / "docs"
HOWTOS = (
    "splats_from_360_video",
    "existing_project",
    "virtual_tour",
    "fisheye_rig",
    "batch",
    "odometry",
    "large_folders",
    "localize",
)
WALK = ("--scene", "living_room", "--num-frames", "6", "--step-m", "0.2",
        "--max-turn-deg", "6", "--width", "512")  # fmt: skip


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """A rendered walk, as the first how-to renders it."""
    folder = tmp_path_factory.mktemp("howto") / "walk"
    assert cli.main(["render", str(folder), *WALK]) == 0
    return folder


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", HOWTOS)
def test_links_of_a_howto_lead_somewhere(name):
    check_links(DOCS / f"{name}.md")


def test_splats_from_a_360_video(walk, folder):
    pytest.importorskip("pycolmap")
    shutil.copytree(walk, "walk")
    run_document(DOCS / "splats_from_360_video.md")
    faces = {path.stem.partition("_")[2] for path in Path("map/cubemap/images").iterdir()}
    assert faces == {"front", "right", "back", "left", "up"}


def test_odometry(walk, folder):
    shutil.copytree(walk, "walk")
    run_document(DOCS / "odometry.md")
    assert Path("tracked/trajectory.txt").is_file()


def test_new_images_in_a_map(walk, folder):
    for library in ("pycolmap", "h5py"):
        pytest.importorskip(library)
    Path("images").mkdir()
    for number in (1, 2, 3, 5, 6):
        shutil.copy(walk / "rgb" / f"{number}.png", "images")
    shutil.copy(walk / "rgb" / "4.png", "new.png")
    assert cli.main(["map", "images", "--output", "map"]) == 0
    run_document(DOCS / "localize.md")
    assert len(Path("trajectory.txt").read_text(encoding="utf-8").splitlines()) == 2


def test_an_existing_project(walk, folder):
    for library in ("pycolmap", "h5py", "pyarrow"):
        pytest.importorskip(library)
    shutil.copytree(walk, "walk")
    assert cli.main(["map", "walk/rgb", "--output", "map"]) == 0
    assert cli.main(["convert", "map", "project.db"]) == 0
    assert cli.main(["convert", "project.db", "matches.h5", "--features", "features.h5"]) == 0
    before = Path("project.db").read_bytes()
    run_document(DOCS / "existing_project.md")
    assert Path("project.db").read_bytes() == before


def test_a_virtual_tour(walk, folder):
    write_tour(walk, Path("tour"))
    run_document(DOCS / "virtual_tour.md")


def test_thousands_of_images(walk, folder):
    write_tour(walk, Path("city"))
    run_document(DOCS / "large_folders.md")


def write_tour(walk, folder):
    """Three pictures of one room and one of another."""
    folder.mkdir()
    for name, frame in (("sofa", 1), ("middle", 3), ("window", 6)):
        shutil.copy(walk / "rgb" / f"{frame}.png", folder / f"{name}.png")
    next_door = scene("studio").render(Equirectangular(512, 256), pose_at(0.5, 0.3))
    write_picture(str(folder / "next door.png"), next_door.image)


def test_a_fisheye_rig(folder):
    pytest.importorskip("pycolmap")
    camera = KannalaBrandt(320, 320, 105.0, 105.0, 160.0, 160.0)
    room = scene("living_room")
    cam1_from_cam0 = Pose(np.eye(3), np.array([-0.2, 0.0, 0.0]))
    for moment in range(3):
        world_from_cam0 = pose_at(0.2 * moment, 0.3, turn_rad=0.15 * moment)
        for name, pose in (
            ("cam0", world_from_cam0),
            ("cam1", world_from_cam0 @ cam1_from_cam0.inverse()),
        ):
            Path("rig", name).mkdir(parents=True, exist_ok=True)
            write_picture(f"rig/{name}/{moment:03d}.png", room.render(camera, pose).image)
    run_document(DOCS / "fisheye_rig.md")


def test_many_pairs(folder):
    for library in ("pycolmap", "pyarrow"):
        pytest.importorskip(library)
    run_document(DOCS / "batch.md")


def pose_at(x, z, *, turn_rad=0.0):
    """A world_from_cam at eye height."""
    return Pose(rotation_from_vector([0.0, turn_rad, 0.0]), np.array([x, -1.5, z]))


def write_picture(path, image):
    assert cv2.imwrite(path, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
