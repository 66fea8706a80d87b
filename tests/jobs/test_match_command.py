# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 match` as a user types it."""

import csv

import numpy as np
import pytest
from rendered_views import NAMES, pictures, write_png, write_views

from epi360.cli import FAILURE, SUCCESS, WRONG_USE, main
from epi360.report.match_table import COLUMNS


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_views(tmp_path / "tour", NAMES[:2])
    return tmp_path


def test_a_folder_gives_a_table_and_a_summary(here, capsys):
    assert main(["match", "tour"]) == SUCCESS
    printed = capsys.readouterr().out
    assert "Pairs         1 (exhaustive)" in printed
    assert "Accepted      1" in printed
    assert "wrote tour-epi360/pairs.csv" in printed.replace("\\", "/")
    with (here / "tour-epi360" / "pairs.csv").open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert tuple(row) == COLUMNS
    assert (row["image1"], row["image2"]) == tuple(NAMES[:2])
    assert (row["status"], row["accepted"]) == ("ok", "yes")
    translation = [float(row[name]) for name in ("tx", "ty", "tz")]
    assert np.linalg.norm(translation) == pytest.approx(1.0, abs=1e-8)


def test_inside_the_image_folder_the_default_output_is_beside_it(here, monkeypatch):
    monkeypatch.chdir(here / "tour" / "Zimmer")
    assert main(["match", str(here / "tour")]) == SUCCESS
    assert (here / "tour-epi360" / "pairs.csv").is_file()


def test_no_pose_at_all_is_an_honest_failure(here, capsys):
    write_png(here / "tour" / NAMES[1], np.zeros_like(pictures()[1]))
    assert main(["match", "tour"]) == FAILURE
    printed = capsys.readouterr().out
    assert "1 too_few_matches" in printed
    assert f"No pair       {NAMES[0]}" in printed


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "nowhere"),
        (["tour", "--pairs", "none.txt"], "none.txt"),
        (["tour", "--max-width", "1"], " --max-width must be at least 64 pixels, got 1"),
        (["tour", "--jobs", "0"], " --jobs must be at least 1, got 0"),
        (["tour", "--mask-nadir-deg=-1"], " --mask-nadir-deg must be in [0, 180)"),
        (["tour", "--output", "tour"], "was not made by epi360 match"),
        (["tour", "--output", "taken"], "must be a folder"),
        (["tour", "--output", "taken/below"], "taken"),
    ],
)
def test_wrong_use_is_one_line(here, capsys, words, message):
    (here / "taken").write_text("x")
    assert main(["match", *words]) == WRONG_USE
    error = capsys.readouterr().err
    assert error.startswith("epi360: error: ")
    assert message in error
    assert error.count("\n") == 1
