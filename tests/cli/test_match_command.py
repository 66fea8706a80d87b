# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 match` as a user types it."""

import csv
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use
from documents import ROOT, text_of
from rendered_views import NAMES, pictures, write_png, write_views

from epi360.cli import FAILURE, SUCCESS, main


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_views(tmp_path / "tour", NAMES[:2])
    return tmp_path


def test_images_without_a_mask_are_said_in_one_line(here, capsys):
    for name in (NAMES[0], "other.png"):
        path = (here / "masks" / name).with_suffix(".png")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_png(path, np.full_like(pictures()[0], 255))
    assert main(["match", "tour", "--mask", "masks"]) == SUCCESS
    said = capsys.readouterr().err
    assert "images have no mask in masks, and 1 masks there belong to no image" in said
    assert "UserWarning" not in said


def documented_columns():
    section = text_of(ROOT / "docs" / "conventions.md").split("## Columns of `pairs.csv`\n")[1]
    first_columns = re.findall(r"^\| (`.+?`) \|", section.split("\n## ")[0], re.M)
    return re.findall(r"`(\w+)`", " ".join(first_columns))


def test_a_folder_gives_a_table_and_a_summary(here, capsys):
    assert main(["match", "tour"]) == SUCCESS
    printed = capsys.readouterr().out
    assert "Pairs         1 (exhaustive)" in printed
    assert "Accepted      1" in printed
    assert "\n1 new pair in " in printed
    assert "wrote tour-epi360/pairs.csv" in printed.replace("\\", "/")
    with (here / "tour-epi360" / "pairs.csv").open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert list(row) == documented_columns()
    assert (row["image1"], row["image2"]) == tuple(NAMES[:2])
    assert (row["status"], row["accepted"]) == ("ok", "yes")
    translation = [float(row[name]) for name in ("tx", "ty", "tz")]
    assert np.linalg.norm(translation) == pytest.approx(1.0, abs=1e-8)


def test_a_report_is_written_where_it_is_asked_for_with_every_pair_and_picture(here, capsys):
    assert main(["match", "tour", "--report", "tour.html"]) == SUCCESS
    assert "wrote tour.html" in capsys.readouterr().out
    text = (here / "tour.html").read_text(encoding="utf-8")
    assert "The accepted pairs join all images." in text
    assert text.count("data:image/jpeg") == 2


def test_a_report_that_cannot_be_written_is_refused_before_the_work(here, capsys):
    words = ["match", "tour", "--report"]
    assert_wrong_use(capsys, [*words, "tour.txt"], "--report must end in .html")
    assert_wrong_use(capsys, [*words, "missing/tour.html"], "--report", "does not exist")
    assert not (here / "tour-epi360").exists()


def test_inside_the_image_folder_the_default_output_is_beside_it(here, monkeypatch):
    monkeypatch.chdir(here / "tour" / "Zimmer")
    assert main(["match", str(here / "tour")]) == SUCCESS
    assert (here / "tour-epi360" / "pairs.csv").is_file()


def test_upright_panoramas_are_said_to_be_in_the_table(here):
    assert main(["match", "tour", "--upright", "20"]) == SUCCESS
    with (here / "tour-epi360" / "pairs.csv").open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["prior"] == "upright"
    assert float(row["probability"]) > 0.85
    explanations = [float(row[name]) for name in row if name.startswith("probability_")]
    assert len(explanations) == 5 and sum(explanations) == pytest.approx(1.0, abs=1e-6)


def test_no_pose_at_all_is_an_honest_failure(here, capsys):
    write_png(here / "tour" / NAMES[1], np.zeros_like(pictures()[1]))
    assert main(["match", "tour"]) == FAILURE
    printed = capsys.readouterr().out
    assert "1 had too few matches (too_few_matches)" in printed
    assert f"No pair       {NAMES[0]}" in printed


@pytest.mark.parametrize(("seconds", "rate"), [(5.0, ", 0.2/s"), (60.0, "")])
def test_a_rate_is_said_where_it_says_something(here, capsys, monkeypatch, seconds, rate):
    times = iter([0.0, seconds])
    monkeypatch.setattr("epi360.cli.match.time", SimpleNamespace(monotonic=lambda: next(times)))
    assert main(["match", "tour"]) == SUCCESS
    assert f"in {seconds} s with their features{rate}\n" in capsys.readouterr().out


def test_images_that_cannot_be_used_are_named_with_the_reason(here, capsys):
    (here / "tour" / "empty.jpg").write_bytes(b"")
    assert main(["match", "tour"]) == SUCCESS
    assert re.search("^Not used      empty.jpg: .+", capsys.readouterr().out, re.M)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "nowhere"),
        (
            ["tour", "--pairs", "exaustive"],
            "exaustive does not exist; give a pairs file, or auto, exhaustive, sequential, "
            "retrieval or near",
        ),
        (["tour", "--max-width", "1"], " --max-width must be at least 64 pixels, got 1"),
        (["tour", "--num-threads", "0"], " --num-threads must be at least 1, got 0"),
        (["tour", "--jobs", "0"], " --num-threads must be at least 1, got 0"),
        (["tour", "--mask-nadir-deg=-1"], " --mask-nadir-deg must be in [0, 180)"),
        (
            ["tour", "--pairs", "exhaustive", "--overlap", "5"],
            ' --overlap must come with --pairs sequential or "auto", got --pairs exhaustive',
        ),
        (["tour", "--upright", "-1"], " --upright must be in (0, 45] degrees, got -1.0"),
        (["tour", "--upright", "1", "--camera", "camera.json"], " --upright needs panoramas"),
        (["tour", "--output", "tour"], "was not made by epi360 match"),
        (
            ["tour/Zimmer/küche 1.png"],
            "küche 1.png is one image, expected a folder of images or a video",
        ),
        (["tour", "--output", "taken"], "must be a folder"),
        (["tour", "--output", "taken/below"], "taken"),
    ],
)
def test_wrong_use_is_one_line(here, capsys, words, message):
    (here / "taken").write_text("x")
    camera = {"model": "Pinhole", "width": 512, "height": 256}
    camera |= {"fx": 99, "fy": 99, "cx": 256, "cy": 128}
    (here / "camera.json").write_text(json.dumps(camera))
    assert_wrong_use(capsys, ["match", *words], message)


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "match", "--camera", "--mask", "--mask-nadir-deg", "--pairs", "--overlap",
        "--max-width", "--max-features", "--seed", "--num-threads", "--output", "--restart",
        "--upright", "--report",
    )  # fmt: skip
