# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 reproduce``: words, exit codes, what is written."""

from dataclasses import asdict
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from command_line import assert_help_names, assert_wrong_use

import epi360_paper
from epi360 import cli
from epi360.cli.reproduce import Name, ReproduceChoice
from epi360_paper import protocols
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.parts import Trials


@pytest.fixture
def calls(monkeypatch):
    """Options that experiments were run with; each of them does nothing."""
    seen = {}

    def load(name):
        def run(options, progress):
            seen[name] = options
            progress(name, 1, 1)
            return Outcome(name, (Path(f"{name}.csv"),), f"summary of {name}")

        return run

    monkeypatch.setattr(epi360_paper, "load_experiment", load)
    return seen


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        ([], "NAME"),
        (["fig9"], "fig9"),
        (["fig4a", "--protocol", "wrong"], "--protocol"),
        (["fig4a", "--trials", "0"], "trials must be 1 or more, got 0"),
        (["fig4a", "--trials", "many"], "--trials"),
        (["fig4a", "--jobs", "0"], "jobs must be 1 or more"),
        (["fig4a", "--into", "doc.md"], "--into"),
        (["fig4a", "--nope"], "--nope"),
        (["report", "--out", "nowhere"], "nowhere"),
        (["fig1", "--report", "page.pdf"], "--report must end in .html"),
        (["fig1", "--picture", "page.html"], "--picture must end in"),
        (["fig1", "--picture", "nowhere/a.png"], "--picture: folder nowhere"),
    ],
)
def test_wrong_words_are_one_line_and_exit_2(capsys, tmp_path, monkeypatch, words, fragment):
    monkeypatch.chdir(tmp_path)
    assert_wrong_use(capsys, ["reproduce", *words], fragment)
    assert list(tmp_path.iterdir()) == []


def test_the_names_are_those_of_the_registry_in_the_papers_order():
    assert get_args(Name) == (*epi360_paper.EXPERIMENTS, "all", "report")
    with pytest.raises(ValueError, match="fig9"):
        epi360_paper.load_experiment("fig9")


def test_the_words_of_the_command_are_the_options_of_the_experiments_with_their_defaults():
    assert asdict(ReproduceChoice()) == asdict(ReproduceOptions())


def test_options_reach_the_experiment(calls, tmp_path, capsys):
    words = ["--protocol", "authors", "--trials", "7", "--seed", "3", "--jobs", "2", "--landmarks"]
    folders = ["--mp3d-vo", "m", "--tum-vi", "t", "--image-width", "512", "--out", str(tmp_path)]
    assert cli.main(["reproduce", "table1", *words, *folders]) == 0
    assert calls["table1"] == ReproduceOptions(
        protocol="authors",
        trials=7,
        seed=3,
        jobs=2,
        out=tmp_path,
        landmarks=True,
        mp3d_vo=Path("m"),
        tum_vi=Path("t"),
        image_width=512,
    )
    assert capsys.readouterr() == ("summary of table1\nwrote table1.csv\n", "")


def test_all_goes_on_after_a_failure_and_exits_1(monkeypatch, tmp_path, capsys):
    ran = []

    def load(name):
        if name == "fig2":
            raise ImportError("fig2 needs\n a thing")
        return lambda options, progress: ran.append(name) or Outcome(name, ())

    monkeypatch.setattr(epi360_paper, "load_experiment", load)
    assert cli.main(["reproduce", "all", "--out", str(tmp_path)]) == 1
    assert ran == [name for name in epi360_paper.EXPERIMENTS if name != "fig2"]
    assert capsys.readouterr().err == "epi360: fig2 failed: fig2 needs a thing\n"


def test_a_killed_worker_is_an_honest_failure(monkeypatch, tmp_path, capsys):
    def run(options, progress):
        raise ChildProcessError("a worker process was killed")

    monkeypatch.setattr(epi360_paper, "load_experiment", lambda name: run)
    assert cli.main(["reproduce", "fig4a", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == "epi360: fig4a failed: a worker process was killed\n"


def test_all_is_success_when_all_succeed(calls, tmp_path):
    assert cli.main(["reproduce", "all", "--out", str(tmp_path)]) == 0
    assert tuple(calls) == epi360_paper.EXPERIMENTS


def test_parts_of_another_run_are_wrong_use_in_one_line(capsys, tmp_path, monkeypatch):
    cloud = np.random.default_rng(0).normal(size=(5000, 3))  # at once: no room is rendered
    monkeypatch.setattr(protocols, "landmark_clouds", lambda density: (cloud,))
    base = ["reproduce", "fig4a", "--jobs", "1", "--trials", "2", "--out", str(tmp_path)]
    assert cli.main(base) == 0
    capsys.readouterr()
    assert_wrong_use(capsys, [*base, "--seed", "1"], "another run (seed 0, not 1)")


def test_help_names_every_option(capsys):
    assert_help_names(
        capsys, "reproduce", "--protocol", "--trials", "--seed", "--jobs", "--out", "--landmarks",
        "--mp3d-vo", "--tum-vi", "--image-width", "--into",
    )  # fmt: skip


def test_empty_trials_have_no_rows():
    assert len(Trials()) == 0


def test_page_and_picture_show_what_a_run_has_made(tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--trials", "20", "--jobs", "1", "--out", str(out)]
    page, picture = tmp_path / "page.html", tmp_path / "all.png"
    shown = ["--report", str(page), "--picture", str(picture)]
    assert cli.main(["reproduce", "table4", *words, *shown]) == 0
    text = page.read_text(encoding="utf-8")
    assert "<h2>Table 4: RANSAC at two thresholds</h2>" in text
    assert "Look at the outliers that are left" in text
    assert "Fig. 1" not in text
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert capsys.readouterr().out.splitlines()[-2:] == [f"wrote {picture}", f"wrote {page}"]
    page.unlink()
    assert cli.main(["reproduce", "report", "--out", str(out), "--report", str(page)]) == 0
    assert "Table 4" in page.read_text(encoding="utf-8")
