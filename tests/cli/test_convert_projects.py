# SPDX-License-Identifier: BSD-3-Clause
"""epi360 convert: OpenSfM's project folders, and trajectories with times and names."""

from convert_scene import assert_same_poses, refused, scene

from epi360.interop.colmap_model import read_colmap_model, write_colmap_model
from epi360.interop.opensfm import write_opensfm
from epi360.interop.tum import read_tum_trajectory


def test_a_model_becomes_a_project_of_opensfm_and_comes_back(run, tmp_path):
    write_colmap_model("model", scene())
    assert run("model", "project", "--format", "opensfm-folder") == (
        0, "wrote project (OpenSfM project): 3 images, 5 points, 1 camera", ""
    )  # fmt: skip
    assert len(list((tmp_path / "project" / "exif").iterdir())) == 3
    code, out, err = run("project", "back")
    assert (code, out, err) == (0, "wrote back (COLMAP model): 3 images, 5 points, 1 camera", "")
    back, before = read_colmap_model("back"), scene()
    assert_same_poses(before, back)
    assert len(back.observations.points) == 15
    # One file has no place for observations, and says so.
    out = run("model", "my_reconstruction.json")[1]
    assert out.endswith("5 points, 1 camera; not kept: observations")
    refused(run("model", "project", "--format", "opensfm-folder"), "project is there already")


def test_a_match_folder_with_a_reconstruction_in_it_stays_one(run, tmp_path):
    write_opensfm("reconstruction.json", scene())
    (tmp_path / "epi360-match.json").write_text("{}")
    code, _, err = run(".", "model")
    assert code == 2 and "make a model first with epi360 map" in err


def test_a_trajectory_gets_times_and_names(run, tmp_path):
    write_opensfm("reconstruction.json", scene())
    assert run("reconstruction.json", "poses.tum", "--fps", "10")[0] == 0
    assert [image.timestamp_s for image in read_tum_trajectory("poses.tum").images] == [0, 0.1, 0.2]
    names = (tmp_path / "poses_names.txt").read_text().splitlines()
    assert names == ["# timestamp filename", *(f"{k / 10!r} hall/{k}.jpg" for k in range(3))]
    refused(run("reconstruction.json", "poses.tum"), "poses.tum is there already")
    refused(run("reconstruction.json", "t.tum", "--fps", "0"), "--fps must be positive")
    refused(run("reconstruction.json", "model", "--fps", "2"), "--fps is for a TUM trajectory")


def test_a_project_of_opensfm_gets_links_to_the_pictures(run, tmp_path):
    write_colmap_model("model", scene())
    words = ("model", "project", "--format", "opensfm-folder", "--images", "pictures")
    refused(run(*words), "0.jpg does not exist")
    for image in scene().images:
        path = tmp_path / "pictures" / image.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(image.name)
    assert run(*words)[0] == 0
    assert (tmp_path / "project" / "images" / "hall" / "2.jpg").read_text() == "hall/2.jpg"
    refused(run("model", "other", "--images", "pictures"), "--images is for nerfstudio's")
