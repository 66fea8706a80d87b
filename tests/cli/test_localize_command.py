# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 localize`: what is printed and written, exit codes."""

import csv
import json
import shutil

import cv2
import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use
from mapped_room import CAMERA, write_picture

from epi360 import cli
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

pytest.importorskip("pycolmap")

PLACES = [(-0.35, -1.47, -0.42), (-0.6, -1.5, -0.3)]


@pytest.fixture(scope="module")
def new_folder(tmp_path_factory):
    """Two new images of the room of the map, and a grey one."""
    folder = tmp_path_factory.mktemp("new")
    for number, place in enumerate(PLACES):
        pose = Pose(rotation_from_vector([0.0, 1.0 + number, 0.0]), np.array(place))
        write_picture(folder / f"{number}.png", furnished_room(0).render(CAMERA, pose).image)
    write_picture(folder / "grey.png", np.full((256, 512, 3), 128, np.uint8))
    return folder


def test_poses_are_printed_and_written_in_every_form(room_run, new_folder, tmp_path, capsys):
    import pycolmap

    from epi360.interop import read_tum_trajectory

    outputs = [tmp_path / name for name in ("a.csv", "a.json", "a.tum", "model")]
    page = tmp_path / "page.html"
    words = ["localize", str(room_run[0]), str(new_folder), "--report", str(page)]
    for path in outputs:
        words += ["--out", str(path)]
    assert cli.main(words) == 0
    printed = capsys.readouterr().out
    assert "0.png     ok: at (" in printed and "sigma" in printed
    assert "grey.png  too_few_matches: 0 matches" in printed
    assert all(f"wrote {path}" in printed for path in (*outputs, page))
    assert "2 of 3 images have a pose that can be used" in page.read_text(encoding="utf-8")
    rows = list(csv.DictReader(outputs[0].open(encoding="utf-8")))
    assert [row["status"] for row in rows] == ["ok", "ok", "too_few_matches"]
    assert float(rows[0]["position_sigma"]) > 0 and rows[2]["qw"] == ""
    record = json.loads(outputs[1].read_text(encoding="utf-8"))
    assert record["map"] == str(room_run[0]) and len(record["images"]) == 3
    assert record["images"][2]["cam_from_world"]["translation"] == [None, None, None]
    centers = [each["center"] for each in record["images"][:2]]
    trajectory = read_tum_trajectory(outputs[2])
    found = [image.cam_from_world.inverse().translation for image in trajectory.images]
    np.testing.assert_allclose(found, centers, atol=1e-9)
    model = pycolmap.Reconstruction(str(outputs[3]))
    mapped = len(room_run[1].models[0].reconstruction.images)
    assert model.num_reg_images() == mapped + 2
    assert "grey.png" not in {image.name for image in model.images.values()}
    new = next(image for image in model.images.values() if image.name == "0.png")
    assert new.num_points3D > 40
    errors = []
    for point in new.points2D:
        if point.has_point3D():
            seen = new.cam_from_world() * model.points3D[point.point3D_id].xyz
            pixel = CAMERA.pixels_from_bearings([seen])[0]
            errors.append(np.linalg.norm(pixel - point.xy))
    assert np.median(errors) < 1.0


def test_an_image_of_a_name_that_the_model_has_gets_a_folder(
    room_run, room_folder, tmp_path, capsys
):
    from epi360.interop import read_colmap_model

    image = room_folder[0] / "Küche" / "1.png"
    folder = tmp_path / "again" / "Küche"
    folder.mkdir(parents=True)
    (folder / "1.png").write_bytes(image.read_bytes())
    words = ["localize", str(room_run[0]), str(tmp_path / "again"), "--out", str(tmp_path / "m")]
    assert cli.main(words) == 0
    assert "localized/Küche/1.png for Küche/1.png" in capsys.readouterr().out
    assert "localized/Küche/1.png" in {i.name for i in read_colmap_model(tmp_path / "m").images}


def test_a_trajectory_without_times_counts_the_images_and_names_them(
    room_run, new_folder, tmp_path
):
    images = [str(new_folder / name) for name in ("0.png", "grey.png", "1.png")]
    out = tmp_path / "poses.txt"
    assert cli.main(["localize", str(room_run[0]), *images, "--out", str(out)]) == 0
    rows = out.read_text(encoding="utf-8").splitlines()
    assert [row.split()[0] for row in rows[1:]] == ["0", "2"]
    names = (tmp_path / "poses_names.txt").read_text(encoding="utf-8").splitlines()
    assert names[1:] == ["0 0.png", "2 1.png"]


def test_an_image_that_cannot_be_read_has_its_row(room_run, new_folder, tmp_path, capsys):
    shutil.copytree(new_folder, tmp_path / "new")
    (tmp_path / "new" / "bad.png").write_bytes((new_folder / "0.png").read_bytes()[:900])
    outputs = [tmp_path / "a.csv", tmp_path / "a.json"]
    words = ["localize", str(room_run[0]), str(tmp_path / "new")]
    assert cli.main([*words, "--out", str(outputs[0]), "--out", str(outputs[1])]) == 0
    rows = {row["image"]: row for row in csv.DictReader(outputs[0].open(encoding="utf-8"))}
    bad = rows["bad.png"]
    assert bad["status"] == "unreadable_image" and bad["qw"] == bad["probability"] == ""
    assert "truncated" in bad["warnings"] and len(rows) == 4
    record = json.loads(outputs[1].read_text(encoding="utf-8"))["images"]
    assert all(each.keys() == record[0].keys() for each in record)
    (unread,) = [each for each in record if each["image"] == "bad.png"]
    assert (unread["status"], unread["success"]) == ("unreadable_image", False)
    assert unread["cam_from_world"] is unread["probability"] is None


def test_a_run_goes_on_from_the_results_that_are_kept(room_run, new_folder, tmp_path, capsys):
    words = ["localize", str(room_run[0]), str(new_folder / "0.png")]
    kept = ["--keep", str(tmp_path / "kept")]
    assert cli.main([*words, *kept, "--out", str(tmp_path / "a.json")]) == 0
    before = capsys.readouterr().out
    assert "done already" not in before
    both = [*words, str(new_folder / "1.png"), *kept, "--out", str(tmp_path / "b.json")]
    assert cli.main(both) == 0
    printed = capsys.readouterr().out
    assert "1 done already" in printed and before.splitlines()[0] in printed
    first, second = (
        json.loads((tmp_path / name).read_text(encoding="utf-8"))["images"][0]
        for name in ("a.json", "b.json")
    )
    assert first == second


def test_without_any_pose_the_exit_code_is_1_and_no_trajectory_is_written(
    room_run, new_folder, tmp_path, capsys
):
    trajectory = tmp_path / "a.txt"
    words = ["localize", str(room_run[0]), str(new_folder / "grey.png"), "--out", str(trajectory)]
    assert cli.main(words) == 1
    assert f"{trajectory} was not written: no image has a pose" in capsys.readouterr().out
    assert not trajectory.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere", "a.png"], "nowhere"),
        (["MAP", "a.png"], "image a.png does not exist"),
        (["MAP", "NEW", "--out", "a.xyz"], "--out must end with .csv"),
        (["MAP", "NEW", "--out", "no/where.csv"], "folder no does not exist"),
        (["MAP", "NEW", "--out", "a.csv", "--out", "a.csv"], "--out must name different files"),
        (["MAP", "NEW", "--max-views", "0"], "--max-views must be at least 1"),
        (["MAP", "NEW", "--mask-nadir-deg", "200"], "--mask-nadir-deg must be in [0, 180)"),
        (["MAP", "NEW", "--camera", "no.yaml"], "no.yaml"),
        (["MAP", "NEW", "--report", "a.txt"], "--report must end in .html"),
        (["MAP", "NEW", "--keep", "no/where"], "--keep must be a folder, or the name of a new one"),
        (["MAP", "NEW", "--database", "no.db"], "no.db does not exist"),
    ],
)
def test_wrong_use_is_one_line(words, message, room_run, new_folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    paths = {"MAP": str(room_run[0]), "NEW": str(new_folder)}
    assert_wrong_use(capsys, ["localize", *(paths.get(word, word) for word in words)], message)


def test_nothing_that_is_there_is_replaced(room_run, new_folder, tmp_path, capsys):
    (tmp_path / "a.csv").write_text("mine")
    words = ["localize", str(room_run[0]), str(new_folder), "--out", str(tmp_path / "a.csv")]
    assert cli.main(words) == 2
    assert "is there already" in capsys.readouterr().err
    assert (tmp_path / "a.csv").read_text() == "mine"


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "localize", "--images", "--features", "--database", "--camera", "--mask",
        "--mask-nadir-deg", "--max-views", "--seed", "--known-place", "--keep", "--out", "--report",
    )  # fmt: skip


def test_the_folder_of_an_image_names_its_camera(room_run, new_folder, tmp_path, capsys):
    size = f"width: {CAMERA.width}, height: {CAMERA.height}"
    (tmp_path / "cameras.yaml").write_text(
        f"cameras:\n  top: {{model: Equirectangular, {size}}}\n"
        f"  rig/left: {{model: Equirectangular, {size}, horizontal_fov_deg: 90}}\n"
    )
    for folder in ("new/top", "new/rig/left"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(new_folder / "0.png", tmp_path / "new" / "top")
    words = ["localize", str(room_run[0]), "--camera", str(tmp_path / "cameras.yaml")]
    assert cli.main([*words, str(tmp_path / "new" / "top" / "0.png")]) == 0
    capsys.readouterr()
    shutil.copy(new_folder / "1.png", tmp_path / "new" / "rig" / "left" / "other.png")
    table = tmp_path / "a.csv"
    assert cli.main([*words, str(tmp_path / "new"), "--out", str(table)]) == 0
    assert "rig/left/other.png" in table.read_text(encoding="utf-8")
    shutil.copy(new_folder / "1.png", tmp_path / "new")
    capsys.readouterr()
    said = "1.png must lie in a sub-folder that is called as its camera, one of top, rig/left"
    assert_wrong_use(capsys, [*words, str(tmp_path / "new")], said)


def test_a_panorama_without_its_lowest_part_stops_nothing(room_run, new_folder, tmp_path, capsys):
    from epi360 import read_image

    whole = read_image(new_folder / "0.png")
    cut = cv2.resize(whole[:225], (512, 256), interpolation=cv2.INTER_AREA)
    write_picture(tmp_path / "cut.png", cut)
    outputs = [tmp_path / "a.json", tmp_path / "model"]
    words = ["localize", str(room_run[0]), str(tmp_path / "cut.png"), str(new_folder / "1.png")]
    words += ["--report", str(tmp_path / "page.html")]
    for path in outputs:
        words += ["--out", str(path)]
    assert cli.main(words) == 0
    assert all(path.exists() for path in (*outputs, tmp_path / "page.html"))
    first, second = json.loads(outputs[0].read_text(encoding="utf-8"))["images"]
    assert first["camera"] == second["camera"]
    if first["success"]:
        (warning,) = [each for each in first["warnings"] if "points of the map agree" in each]
        assert "degrees high, not 180" in warning and "with a pose that is" in warning
