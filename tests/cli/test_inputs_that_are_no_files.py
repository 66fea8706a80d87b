# SPDX-License-Identifier: BSD-3-Clause
"""Pipes and devices where a command wants a file: read whole, or refused in one line, at once."""

import contextlib
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from command_line import assert_wrong_use

from epi360 import cli
from epi360.cameras import Equirectangular
from epi360.interop import (
    PosedImage,
    Reconstruction,
    read_tum_trajectory,
    write_nerfstudio,
    write_opensfm,
)
from epi360.poses import Pose

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and devices are POSIX")
POSE = Pose(np.eye(3), np.zeros(3))


@pytest.fixture
def pipe(tmp_path):
    """A named pipe into which nobody writes."""
    os.mkfifo(tmp_path / "pipe.jpg")
    return tmp_path / "pipe.jpg"


@pytest.fixture
def transforms(tmp_path):
    """A transforms.json with one panorama and one point."""
    path = tmp_path / "transforms.json"
    image = PosedImage("a.jpg", "1", POSE)
    points = np.zeros((1, 3)), np.zeros((1, 3), np.uint8)
    write_nerfstudio(path, Reconstruction({"1": Equirectangular(8, 4)}, (image,), *points))
    return path


def test_a_piped_trajectory_is_converted_whole(tmp_path):
    rows = "".join(f"{time / 10} {time} 0 0 0 0 0 1\n" for time in range(2000))
    program = "import sys; from epi360.cli import main; sys.exit(main(sys.argv[1:]))"
    answer = subprocess.run(
        [sys.executable, "-c", program, "convert", "/dev/stdin", str(tmp_path / "out.tum")],
        input=rows, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert (answer.returncode, answer.stderr) == (0, "")
    assert len(read_tum_trajectory(tmp_path / "out.tum").images) == 2000


def answer_to_a_pipe(content, *words):
    """Answer of a command that gets content through a slow pipe as /dev/stdin."""
    program = "import sys; from epi360.cli import main; sys.exit(main(sys.argv[1:]))"
    process = subprocess.Popen(
        [sys.executable, "-c", program, *map(str, words)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(2.0)  # it waits for the first byte
    printed, said = process.communicate(content, timeout=60)
    return process.returncode, printed, said


def test_a_piped_trajectory_is_evaluated_whole(tmp_path):
    rows = "".join(f"{k / 10} {k % 7} {k} 0 0 0 0 1\n" for k in range(2000))
    (tmp_path / "truth.txt").write_text(rows)
    code, printed, said = answer_to_a_pipe(rows, "evaluate", "/dev/stdin", tmp_path / "truth.txt")
    assert (code, said) == (0, "")
    assert "2000 of 2000 have a pose" in printed


def test_a_piped_model_is_cut_into_cube_faces(tmp_path):
    from epi360.features.picture_writing import encode_picture

    (tmp_path / "images").mkdir()
    picture = encode_picture(np.full((32, 64, 3), 90, np.uint8), ".jpg")
    (tmp_path / "images" / "a.jpg").write_bytes(picture)
    model = Reconstruction({"1": Equirectangular(64, 32)}, (PosedImage("a.jpg", "1", POSE),))
    write_opensfm(tmp_path / "reconstruction.json", model)
    code, printed, said = answer_to_a_pipe(
        (tmp_path / "reconstruction.json").read_text(),
        "cubemap", "/dev/stdin", tmp_path / "images", tmp_path / "cube",
    )  # fmt: skip
    assert code == 0, said
    assert "6 cube faces" in printed


@pytest.mark.parametrize("source", ["pipe", "/dev/zero"])
def test_a_table_of_frames_is_a_file(source, pipe, tmp_path, capsys):
    (tmp_path / "truth.txt").write_text("0 0 0 0 0 0 0 1\n")
    words = ["evaluate", tmp_path / "truth.txt", tmp_path / "truth.txt", "--frames"]
    path = pipe if source == "pipe" else source
    assert_wrong_use(capsys, [*words, path], str(path))


@pytest.mark.parametrize("source", ["pipe", "/dev/zero"])
def test_convert_refuses_what_is_no_file(source, pipe, capsys, tmp_path):
    path = pipe if source == "pipe" else source
    assert_wrong_use(capsys, ["convert", path, tmp_path / "out.tum"], str(path))


@pytest.mark.parametrize("file", ["cameras.txt", "images.txt", "points3D.txt"])
def test_a_model_with_a_pipe_in_it_is_refused(file, tmp_path, capsys):
    model = tmp_path / "model"
    model.mkdir()
    (model / "cameras.txt").write_text("1 EQUIRECTANGULAR 8 4 8 4\n")
    (model / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.jpg\n\n")
    (model / "points3D.txt").write_text("")
    (model / file).unlink()
    os.mkfifo(model / file)
    assert_wrong_use(capsys, ["convert", model, tmp_path / "out.tum"])


@pytest.mark.parametrize("points", ["/dev/zero", "../points.ply", "pipe.jpg"])
def test_points_are_a_file_beside_the_transforms(points, transforms, pipe, tmp_path, capsys):
    (tmp_path.parent / "points.ply").write_text("ply")
    document = json.loads(transforms.read_text())
    transforms.write_text(json.dumps({**document, "ply_file_path": points}))
    words = "is a pipe" if points == "pipe.jpg" else f"the name '{points}' leads out of"
    assert_wrong_use(capsys, ["convert", transforms, tmp_path / "out.tum"], words)
    (tmp_path.parent / "points.ply").unlink()


@pytest.mark.parametrize("source", ["pipe", "/dev/zero"])
def test_pair_refuses_what_is_no_file(source, pipe, capsys):
    path = pipe if source == "pipe" else source
    assert_wrong_use(capsys, ["pair", path, path], str(path), "must be a file, got a ")
    assert_wrong_use(capsys, ["pair", __file__, __file__, "--camera", path], str(path))
    assert_wrong_use(capsys, ["batch", path, "--output", pipe.parent / "x.parquet"], str(path))


@pytest.mark.parametrize("source", ["pipe", "/dev/zero"])
@pytest.mark.parametrize(
    "words",
    ["localize SOURCE a.jpg", "track SOURCE", "track . --mask SOURCE", "track . --camera SOURCE",
     "frames SOURCE out", "match . --pairs near --positions SOURCE", "match . --pairs SOURCE",
     "evaluate SOURCE truth.txt", "convert SOURCE out.db --verify"],
)  # fmt: skip
def test_the_other_commands_refuse_it_too(words, source, pipe, tmp_path, capsys, monkeypatch):
    from epi360.features.picture_writing import encode_picture

    pytest.importorskip("av")
    monkeypatch.chdir(tmp_path)
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(encode_picture(np.zeros((8, 16, 3), np.uint8), ".png"))
    path = str(pipe) if source == "pipe" else source
    words = [path if word == "SOURCE" else word for word in words.split()]
    assert cli.main(words) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("epi360: error: ") and path in said


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_a_full_device_is_named(tmp_path, capsys):
    (tmp_path / "a.txt").write_text("".join(f"{k} {k} {k % 2} 0 0 0 0 1\n" for k in range(9)))
    words = ["evaluate", tmp_path / "a.txt", tmp_path / "a.txt", "--json", "/dev/full"]
    assert cli.main([str(word) for word in words]) == 2
    assert (
        capsys.readouterr().err
        == "epi360: error: /dev/full: cannot write (No space left on device)\n"
    )


def test_match_leaves_out_what_is_no_file(pipe, tmp_path, capsys):
    assert cli.main(["match", str(tmp_path), "--output", str(tmp_path / "out")]) == 2
    assert "no file" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--pairs", "--mask", "--camera"])
def test_match_refuses_options_that_are_no_files(option, pipe, tmp_path, capsys):
    images = tmp_path / "images"
    images.mkdir()
    for name in ("a.png", "b.png"):
        from epi360.features.picture_writing import encode_picture

        (images / name).write_bytes(encode_picture(np.zeros((8, 16, 3), np.uint8), ".png"))
    words = ["match", images, "--output", tmp_path / "out", option, pipe]
    assert_wrong_use(capsys, words, f"{pipe}")
