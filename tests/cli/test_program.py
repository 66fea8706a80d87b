# SPDX-License-Identifier: BSD-3-Clause
"""The program `epi360` itself: its commands, its version, how it starts and how it fails."""

import subprocess
import sys

import numpy as np
import pytest
from command_line import assert_wrong_use

from epi360 import cli
from epi360.cli.command import app, show_bars
from epi360.features.picture_writing import encode_picture

COMMANDS = (
    "pair", "frames", "match", "map", "localize", "track", "evaluate", "batch", "convert",
    "cubemap", "render", "reproduce", "demo", "completion",
)  # fmt: skip
COMPLETE = ("demo",)  # does its work without another word


def test_the_environment_may_ask_where_an_error_comes_from(monkeypatch, tmp_path):
    words = ["pair", str(tmp_path / "a.png"), str(tmp_path / "b.png")]
    assert cli.main(words) == 2
    monkeypatch.setenv("EPI360_TRACEBACK", "1")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        cli.main(words)


def test_the_commands_are_the_documented_ones():
    assert {name for name in app if not name.startswith("-")} == set(COMMANDS)


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_help_names_every_command(capsys, arguments):
    assert cli.main(arguments) == 0
    captured = capsys.readouterr()
    assert [name for name in COMMANDS if name not in captured.out] == []
    assert captured.err == ""


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in COMPLETE])
def test_a_command_without_its_words_is_wrong_use(capsys, command):
    assert_wrong_use(capsys, [command])


@pytest.mark.parametrize("command", COMMANDS)
def test_an_unknown_option_is_named(capsys, command):
    assert_wrong_use(capsys, [command, "--nope"], "--nope")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [(["match", "in", "out"], "'out'"), (["match", "in", "-o", "out"], "-o")],
)
def test_words_that_a_command_does_not_know_are_named_with_where_to_look(capsys, arguments, named):
    assert_wrong_use(capsys, arguments, named, "'epi360 match --help' lists what it takes")


@pytest.mark.parametrize(
    ("arguments", "fragment"), [(["pare", "a.jpg", "b.jpg"], "pair"), (["--nope"], "--nope")]
)
def test_an_unknown_command_is_one_line_and_exit_2(capsys, arguments, fragment):
    assert_wrong_use(capsys, arguments, fragment)


def test_the_version_is_one_line(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out.count("\n") == 1


def test_the_help_of_every_command_comes_without_the_heavy_libraries():
    helps = "; ".join(f"epi360.cli.main(['{name}', '--help'])" for name in COMMANDS)
    heavy = "('numpy', 'cv2', 'matplotlib', 'scipy', 'pycolmap', 'pyarrow', 'ray', 'h5py')"
    code = f"import sys, epi360.cli; {helps}; print([m for m in {heavy} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.endswith("\n[]\n")


def test_commands_are_listed_in_the_order_in_which_they_are_looked_for(capsys):
    cli.main(["--help"])
    shown = capsys.readouterr().out
    places = [shown.index(f" {name} ") for name in ("pair", "match", "map", "frames", "demo")]
    assert places == sorted(places)


@pytest.mark.parametrize("command", ["match", "map", "batch", "track", "localize", "reproduce"])
def test_a_folder_of_results_may_be_called_out_or_output(command):
    words = {"localize": ["a", "b"], "reproduce": ["fig1"]}.get(command, ["a"])
    places = {
        str(app.parse_args([command, *words, name, "place"], exit_on_error=False)[1].arguments)
        for name in ("--out", "--output")
    }
    assert len(places) == 1 and "place" in places.pop()


@pytest.mark.parametrize(
    ("words", "job", "left"),
    [
        (["match", "in"], "jobs.matching.match_folder.match_images", "goes on from there"),
        (["map", "in"], "jobs.mapping.map_folder.map_images", "goes on from there"),
        (["frames", "in.mp4", "out"], "jobs.frames.frames_job.extract_frames", "goes on"),
        (["track", "in"], "jobs.tracking.track_job.track_frames", "begins again"),
        (["evaluate", "a", "b"], "jobs.trajectories.read_trajectory", ""),
    ],
)
def test_an_interrupted_command_says_what_it_leaves(
    tmp_path, monkeypatch, capsys, words, job, left
):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    for name in ("a", "b", "in/a.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(encode_picture(np.zeros((32, 64, 3), np.uint8), ".png"))
    monkeypatch.setattr(f"epi360.{job}", interrupt)
    assert cli.main(words) == 130
    said = capsys.readouterr().err
    assert said.startswith("epi360: interrupted") and said.count("\n") == 1
    assert left in said and (left or said == "epi360: interrupted\n")


def test_the_end_of_a_stage_is_said_once_and_again_where_it_is_done_again(capsys):
    with show_bars() as progress:
        for done in (0, 1, 2, 2, 0, 2):
            progress("frames", done, 2)
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(",")[0] for line in lines] == ["epi360: frames: 2 of 2"] * 2
