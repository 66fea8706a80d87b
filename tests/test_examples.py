# SPDX-License-Identifier: BSD-3-Clause
"""The examples run and print what they promise; test_readme.py holds the first one."""

import re
import runpy
import sys
from pathlib import Path

import pytest

from epi360.estimation import PAPER_METHODS

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def printed_by(name, monkeypatch, capsys, *arguments):
    path = str(EXAMPLES / name)
    monkeypatch.setattr(sys, "argv", [path, *arguments])
    runpy.run_path(path, run_name="__main__")
    return capsys.readouterr().out


def test_matches_to_pose_prints_only_what_the_matches_determine(monkeypatch, capsys):
    printed = printed_by("02_matches_to_pose.py", monkeypatch, capsys)
    good, turned, hopeless = printed.strip().split("\n\n")
    assert "status       ok" in good and "translation  error" in good
    assert "status       pure_rotation" in turned
    assert "rotation     error" in turned and "translation" not in turned
    assert "status       too_few" in hopeless and "error" not in hopeless
    assert "nan" not in printed
    errors = [float(number) for number in re.findall(r"error (\d+\.\d+) deg", printed)]
    # 0.1 deg of noise on hundreds of matches; measured 0.06 at most.
    assert len(errors) == 3 and max(errors) < 0.3


def test_matches_of_a_place_tell_twin_rooms_apart(monkeypatch, capsys):
    lines = printed_by("04_matches_of_a_place.py", monkeypatch, capsys).splitlines()
    for line in lines[:15]:
        first, second = line.split(":")[0].split()
        assert ("accepted" in line) == (first[0] == second[0])
    assert lines[15] == "Verified      15 pairs"
    with pytest.raises(SystemExit, match=re.escape("[FOLDER]")):
        printed_by("04_matches_of_a_place.py", monkeypatch, capsys, "a", "b")


def test_paper_methods_prints_a_row_for_every_method(monkeypatch, capsys):
    lines = printed_by("03_paper_methods.py", monkeypatch, capsys, "3").splitlines()
    assert lines[0].startswith("median of 3 problems")
    assert [line.split()[0] for line in lines[1:]] == list(PAPER_METHODS)
    assert all(float(line.split()[1]) < 90.0 for line in lines[1:])


@pytest.mark.parametrize("arguments", [("0",), ("many",), ("1", "2")])
def test_paper_methods_explains_wrong_use(arguments, monkeypatch, capsys):
    with pytest.raises(SystemExit, match=re.escape("[PROBLEMS]")):
        printed_by("03_paper_methods.py", monkeypatch, capsys, *arguments)
