# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 map`: what is printed and written, exit codes."""

import shutil

import cv2
import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use
from mapped_room import CAMERA, write_picture

from epi360 import cli
from epi360.poses import Pose
from epi360_scenes import furnished_room

pytest.importorskip("pycolmap")

from epi360.interop import Reconstruction  # noqa: E402
from epi360.interop.colmap_model import read_colmap_model  # noqa: E402
from epi360.jobs.mapping.lone_branches import Branch  # noqa: E402
from epi360.jobs.mapping.map_attempts import Attempt  # noqa: E402
from epi360.jobs.mapping.map_folder import MapRun  # noqa: E402
from epi360.jobs.mapping.mapped_models import MappedModel  # noqa: E402
from epi360.jobs.matching.match_folder import MatchRun  # noqa: E402


def test_the_command_says_what_registered_and_cuts_cube_faces(
    room_folder, room_run, tmp_path, capsys
):
    output, _ = room_run
    report = tmp_path / "map.html"
    # With the options of the fixture: nothing is mapped again in the folder that others look at.
    words = ["map", str(room_folder[0]), "--output", str(output), "--mapper-threads", "1"]
    before = (output / "mapping.json").read_bytes()
    words.append("--cubemap")
    words += ["--report", str(report)]
    assert cli.main([*words, "--faces", "front", "back", "--mask-nadir-deg", "0"]) == 0
    assert (output / "mapping.json").read_bytes() == before
    printed = capsys.readouterr().out
    assert "registered   6 of 7 images" in printed
    assert "not used     zz_grey.png: no accepted pair" in printed
    assert f"wrote {output / 'sparse' / '0'}" in printed
    assert f"wrote {output / 'cubemap'} (12 cube faces)" in printed
    assert (output / "cubemap" / "images" / "Küche" / "0_back.jpg").is_file()
    assert len(read_colmap_model(output / "cubemap" / "sparse" / "0").images) == 12
    text = report.read_text(encoding="utf-8")
    assert "The map holds 6 of 7 images" in text
    assert "zz_grey.png: no accepted pair" in text


def test_an_older_cubemap_is_not_taken_for_that_of_the_new_map(room_folder, tmp_path, capsys):
    pictures, out = tmp_path / "in", tmp_path / "out"
    pictures.mkdir()
    for name in ("1.png", "2.png"):
        (pictures / name).write_bytes((room_folder[0] / "Küche" / name).read_bytes())
    words = ["map", str(pictures), "--output", str(out)]
    assert cli.main([*words, "--cubemap", "--faces", "front"]) == 0
    # Other faces: said before the mapping, so that the map is still that of the faces.
    before = (out / "mapping.json").read_bytes()
    assert cli.main([*words, "--mapper", "global", "--cubemap", "--faces", "up"]) == 2
    said = capsys.readouterr().err
    assert "cubemap with other options (--faces); " in said
    assert f"delete the folder {out / 'cubemap'}, and it is cut anew" in said
    assert (out / "mapping.json").read_bytes() == before
    assert cli.main(words) == 0
    assert "earlier map" not in capsys.readouterr().out
    (pictures / "3.png").write_bytes((room_folder[0] / "Küche" / "0.png").read_bytes())
    assert cli.main(words) == 0
    assert f"{out / 'cubemap'} is of an earlier map: --cubemap cuts it again" in (
        capsys.readouterr().out
    )
    shutil.rmtree(out / "cubemap")  # what the message about other faces tells to do
    assert cli.main([*words, "--cubemap", "--faces", "up"]) == 0
    assert len(read_colmap_model(out / "cubemap" / "sparse" / "0").images) == 3


def nothing_matched(folder):
    return MatchRun(
        folder=folder, how="exhaustive", images=(), verdicts=(), unreadable={}, num_found=0
    )


def test_the_command_says_what_to_do_with_a_second_model(tmp_path, capsys, monkeypatch):
    models = tuple(
        MappedModel(tmp_path / "sparse" / str(number), Reconstruction({}, ()), 0.5)
        for number in range(2)
    )
    matched = nothing_matched(tmp_path)
    run = MapRun(matched, models, {}, 5, {}, ())
    monkeypatch.setattr("epi360.jobs.mapping.map_folder.map_images", lambda *_, **__: run)
    write_picture(tmp_path / "in" / "a.png", np.zeros((64, 128, 3), np.uint8))
    assert cli.main(["map", str(tmp_path / "in"), "--output", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "models       2 that do not connect: 0, 0 images" in printed
    assert f"epi360 cubemap {tmp_path / 'sparse' / '1'} {tmp_path / 'in'} NEW" in printed


def test_the_command_says_which_images_hang_on_one_pair(tmp_path, capsys, monkeypatch):
    model = MappedModel(tmp_path / "sparse" / "0", Reconstruction({}, ()), 0.5)
    branches = (Branch(("e", "b"), tuple("efghi")), Branch(("a", "x"), ("x",)))
    run = MapRun(nothing_matched(tmp_path), (model,), {}, 17, {}, (), branches=branches)
    monkeypatch.setattr("epi360.jobs.mapping.map_folder.map_images", lambda *_, **__: run)
    write_picture(tmp_path / "in" / "a.png", np.zeros((64, 128, 3), np.uint8))
    assert cli.main(["map", str(tmp_path / "in"), "--output", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("one pair")] == [
        "one pair     e, f, g, h and 1 more hang on e - b alone: nothing checks how far away",
        "one pair     x hangs on a - x alone: nothing checks how far away",
    ]


def test_the_command_says_what_was_tried_where_one_way_was_not_enough(
    tmp_path, capsys, monkeypatch
):
    model = MappedModel(tmp_path / "sparse" / "0", Reconstruction({}, ()), 0.5)
    attempts = (
        Attempt("incremental mapper", 5, 0, 0.4, 1.0),
        Attempt("global mapper", 9, 4, 0.5, 1.0, kept=True),
    )
    matched = nothing_matched(tmp_path)
    write_picture(tmp_path / "in" / "a.png", np.zeros((64, 128, 3), np.uint8))
    for tried, expected in ((attempts, 2), (attempts[:1], 0)):
        run = MapRun(matched, (model,), {}, 17, {}, (), tried)
        monkeypatch.setattr(
            "epi360.jobs.mapping.map_folder.map_images", lambda *_, run=run, **__: run
        )
        assert cli.main(["map", str(tmp_path / "in"), "--output", str(tmp_path)]) == 0
        lines = [li for li in capsys.readouterr().out.splitlines() if li.startswith("tried")]
        assert len(lines) == expected
        if lines:
            assert lines == [
                "tried        incremental mapper: 5 of 17 images",
                "tried        global mapper: 9 of 17 images, 4 more at places that nothing "
                "confirms; kept",
            ]


def test_the_command_says_from_which_poses_the_map_of_a_sequence_starts(
    tmp_path, capsys, monkeypatch
):
    model = MappedModel(tmp_path / "sparse" / "0", Reconstruction({}, ()), 0.5)
    matched = nothing_matched(tmp_path)
    write_picture(tmp_path / "in" / "a.png", np.zeros((64, 128, 3), np.uint8))
    counts = {"num_frames": 90, "num_tracked": 88, "num_images": 29, "seconds": 1.0}
    for reason, line in (
        ("", "track        88 of 90 frames; the map starts from 29 of 30 poses"),
        ("the camera turns", "no track     the camera turns; mapped without"),
    ):
        track = {**counts, "reason": reason}
        run = MapRun(matched, (model,), {}, 30, {}, (), track=track)
        monkeypatch.setattr(
            "epi360.jobs.mapping.map_folder.map_images", lambda *_, run=run, **__: run
        )
        assert cli.main(["map", str(tmp_path / "in"), "--output", str(tmp_path)]) == 0
        assert line in capsys.readouterr().out.splitlines()


def test_fewer_than_two_registered_images_are_exit_code_1(tmp_path, capsys):
    rng = np.random.default_rng(1)
    for name in ("a", "b"):
        noise = cv2.resize(rng.integers(0, 256, (32, 64, 3), dtype=np.uint8), (256, 128))
        write_picture(tmp_path / "in" / f"{name}.png", noise)
    words = ["map", str(tmp_path / "in"), "--output", str(tmp_path / "out")]
    assert cli.main(words) == 1
    assert "registered   0 of 2 images" in capsys.readouterr().out
    assert not (tmp_path / "out" / "sparse").exists()


def test_a_camera_that_only_turned_is_said_to_be_nothing_to_map(tmp_path, capsys, monkeypatch):
    pose = Pose(np.eye(3), np.array([-0.9, -1.5, -0.5]))
    picture = furnished_room(0).render(CAMERA, pose, supersample=1).image
    for number in range(2):
        turned = np.roll(picture, 80 * number, axis=1)
        write_picture(tmp_path / "in" / f"{number}.png", turned)
    monkeypatch.setattr(
        "epi360.jobs.mapping.map_attempts.run_mapper", lambda *_, **__: pytest.fail()
    )
    out = tmp_path / "out"
    words = ["map", str(tmp_path / "in"), "--output", str(out)]
    assert cli.main([*words, "--report", str(tmp_path / "map.html")]) == 1
    printed = capsys.readouterr().out
    assert (
        "no map       no pair has a translation, so there is nothing to map: in 1 of 1 pair the "
        "camera only turned (pure_rotation); take pictures from several places\n"
    ) in printed
    assert "not used     0.png: no accepted pair (1 pure_rotation)" in printed
    assert (out / "pairs.csv").is_file() and not (out / "sparse").exists()
    page = (tmp_path / "map.html").read_text(encoding="utf-8")
    assert "No pair shows a translation, so there is nothing to map." in page


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["IMAGES", "--faces", "front"], "need --cubemap"),
        (["NOWHERE"], "does not exist"),
        (["IMAGES", "--num-threads", "0"], " --num-threads must be at least 1, got 0"),
        (["IMAGES", "--mapper-threads", "0"], " --mapper-threads must be 1 or more"),
        (["IMAGES", "--mapper", "best"], "--mapper"),
        (["IMAGES", "--report", "map.txt"], " --report must end in .html"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(room_folder, tmp_path, capsys, words, message):
    paths = {"IMAGES": room_folder[0], "NOWHERE": tmp_path / "no"}
    arguments = [paths.get(word, word) for word in words]
    assert_wrong_use(capsys, ["map", *arguments, "--output", tmp_path / "out"], message)
    assert not (tmp_path / "out").exists()


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "map", "--camera", "--mask", "--mask-nadir-deg", "--pairs", "--overlap",
        "--max-width", "--max-features", "--seed", "--num-threads", "--mapper", "--refine-cameras",
        "--no-track", "--mapper-threads", "--cubemap", "--face-size", "--fov-deg", "--faces",
        "--image-format", "--jpeg-quality", "--output", "--restart", "--report",
    )  # fmt: skip
