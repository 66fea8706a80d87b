# SPDX-License-Identifier: BSD-3-Clause
"""The benchmarks' overview pictures: every one has the option, and it draws what was measured."""

import math
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
NAMES = (
    "two_view", "real_pairs", "trust", "odometry", "batch", "mapping", "paper_methods",
    "estimator_choices",
)  # fmt: skip


@pytest.fixture
def picture(monkeypatch):
    """The module that all benchmarks draw with."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import _picture

    return _picture


@pytest.mark.parametrize("name", NAMES)
def test_every_benchmark_checks_the_picture_before_it_works(name):
    text = (BENCHMARKS / f"{name}.py").read_text(encoding="utf-8")
    assert "add_picture_option(parser)" in text
    assert "check_picture(options.picture)" in text


def test_rows_and_series_come_in_the_order_of_their_numbers(picture):
    panel = picture.panel_of("t", "s", [("b", "ours", 1.0), ("a", "peer", 2.0), ("b", "peer", 3.0)])
    assert list(panel.rows) == ["b", "a"]
    assert panel.series["peer"] == [3.0, 2.0]
    assert panel.series["ours"][0] == 1.0 and math.isnan(panel.series["ours"][1])


def test_the_picture_names_commit_and_machine_and_leaves_out_what_was_not_measured(
    picture, tmp_path, monkeypatch
):
    drawn = []
    monkeypatch.setattr(picture, "write_overview", lambda path, overview: drawn.append(overview))
    empty = picture.panel_of("none", "s", [("a", "ours", math.nan)])
    full = picture.panel_of("some", "s", [("a", "ours", 1.0)])
    facts = {"commit": "abc", "cores": 2, "cpu": "a CPU", "load_average": [1.0]}
    picture.write_picture(tmp_path / "a.png", "T", [empty, full], facts)
    (overview,) = drawn
    assert [panel.title for panel in overview.panels] == ["some"]
    assert overview.note == "Commit abc; 2 cores of a CPU; load average 1.0."
    picture.write_picture(None, "T", [full], facts)
    assert len(drawn) == 1


def test_a_picture_of_an_unknown_format_is_refused_before_the_work(picture, tmp_path):
    with pytest.raises(ValueError, match="--picture must end in"):
        picture.check_picture(tmp_path / "a.txt")


def test_a_short_run_draws_its_picture(tmp_path):
    path = tmp_path / "paper.png"
    words = ["--points", "100", "--scenes", "1", "--repeat", "1", "--picture", str(path)]
    command = [sys.executable, str(BENCHMARKS / "paper_methods.py"), *words]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.endswith(f"wrote {path}\n")
    height, width = cv2.imread(str(path)).shape[:2]
    assert width > 500 and height > 400
