# SPDX-License-Identifier: BSD-3-Clause
"""README and docs: every block runs, every link and table is true.

In a document, blocks run from top to bottom in a folder with the demo's panoramas a.jpg and b.jpg:
``python`` is executed, ``epi360`` lines of ``bash`` go through the command, a ``text`` block behind
either is what it prints, and a block behind ``<!-- file: NAME -->`` is written to that file.
"""

import contextlib
import io
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path
from typing import get_args

import cv2
import pytest

import epi360
from epi360 import cli
from epi360.cameras import load_cameras
from epi360.cameras.calibration.colmap import SUPPORTED as COLMAP_MODELS
from epi360.cameras.calibration.own import MODELS
from epi360.estimation import Status
from epi360.synthetic import demo_pair

ROOT = Path(__file__).resolve().parents[1]
README, CONVENTIONS = ROOT / "README.md", ROOT / "docs" / "conventions.md"
ESTIMATOR = ROOT / "docs" / "estimator.md"
HOW_IT_WORKS = ROOT / "docs" / "how_it_works.md"
DOCUMENTS = (README, CONVENTIONS, HOW_IT_WORKS, ESTIMATOR)
EXAMPLE = ROOT / "examples" / "01_two_images.py"
BLOCK = re.compile(
    r"(?:<!-- file: (?P<file>\S+) -->\n)?^```(?P<language>\w+)\n(?P<body>.*?)^```$", re.M | re.S
)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")


def text_of(document):
    return document.read_text(encoding="utf-8")


def blocks_of(document):
    return list(BLOCK.finditer(text_of(document)))


@pytest.fixture(scope="module")
def pair():
    """The demo's panoramas and their truth, rendered once."""
    return demo_pair()


@pytest.fixture
def folder(tmp_path, monkeypatch, pair):
    """Current folder, with the panoramas in it."""
    monkeypatch.chdir(tmp_path)
    for name, image in (("a.jpg", pair.image1), ("b.jpg", pair.image2)):
        assert cv2.imwrite(name, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    return tmp_path


def run_bash(body):
    for line in body.splitlines():
        words = shlex.split(line, comments=True)
        if words and words[0] == "epi360":
            assert cli.main(words[1:]) == (1 if "exit code 1" in line else 0), line


def run_block(language, body, names):
    """Standard output of a block."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        if language == "bash":
            run_bash(body)
        elif language == "python":
            exec(body, names)
    return printed.getvalue()


def assert_prints_about(printed, expected):
    """Words are equal; numbers agree roughly, as another OpenCV finds other key points."""
    assert [line.split() for line in NUMBER.sub("#", printed).strip().splitlines()] == [
        line.split() for line in NUMBER.sub("#", expected).strip().splitlines()
    ]
    for new, old in zip(NUMBER.findall(printed), NUMBER.findall(expected), strict=True):
        assert float(new) == pytest.approx(float(old), rel=0.25, abs=0.1), (new, old)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_block_of_a_document_runs_and_prints_what_it_says(document, folder):
    printed, names, num_run = "", {}, 0
    for block in blocks_of(document):
        language, body = block["language"], block["body"]
        if block["file"]:
            Path(block["file"]).write_text(body, encoding="utf-8")
        elif language == "text":
            assert_prints_about(printed, body)
        else:
            assert language in ("bash", "python"), f"{language} block without a file name"
            printed = run_block(language, body, names)
            num_run += 1
    assert num_run > 0


def test_make_commands_of_the_readme_are_targets():
    makefile = text_of(ROOT / "Makefile")
    commands = re.findall(r"^make (\w+)", text_of(README), re.M)
    assert {"demo", "test"} <= set(commands)
    for target in commands:
        assert re.search(rf"^{target}:", makefile, re.M), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_of_a_document_lead_somewhere(document):
    links = [first or second for first, second in LINK.findall(text_of(document))]
    for link in links:
        if link.startswith("https://"):
            continue
        name, _, anchor = link.partition("#")
        target = (document.parent / name).resolve() if name else document
        assert target.exists(), link
        if anchor:
            titles = re.findall(r"^#+ (.+)$", text_of(target), re.M)
            assert anchor in [re.sub(r"[^\w-]", "", t.lower().replace(" ", "-")) for t in titles]


def test_pictures_are_small_enough_for_a_page():
    for picture in (ROOT / "docs" / "images").glob("*.png"):
        assert picture.stat().st_size < 600_000, picture


def test_the_json_table_names_every_field_and_no_other(folder, pair, monkeypatch):
    monkeypatch.setattr("epi360.synthetic.room.demo_pair", lambda: pair)
    cli.main(["pair", "--demo", "--json", "record.json"])
    section = text_of(CONVENTIONS).split("## JSON of `--json`")[1]
    first_columns = re.findall(r"^\| (`.+?`) \|", section, re.M)
    documented = {key for column in first_columns for key in re.findall(r"`(\w+)`", column)}
    assert documented == set(json.loads(Path("record.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize("document", [CONVENTIONS, HOW_IT_WORKS], ids=lambda path: path.name)
def test_the_status_table_has_every_status(document):
    cells = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", text_of(document), re.M)
    assert set(get_args(Status)) <= set(re.findall(r"`(\w+)`", " ".join(cells)))


def test_the_camera_files_of_the_conventions_show_every_model(tmp_path):
    shown = set()
    for block in blocks_of(CONVENTIONS):
        if block["file"]:
            path = tmp_path / block["file"]
            path.write_text(block["body"], encoding="utf-8")
            shown |= {type(camera).__name__ for camera in load_cameras(path).values()}
    assert shown == set(MODELS)
    for model in COLMAP_MODELS.split(", "):
        assert f"`{model}`" in text_of(CONVENTIONS), model


def run_example(*images):
    package = str(Path(epi360.__file__).parents[1])  # found also where PYTHONPATH is relative
    environment = {**os.environ, "PYTHONPATH": package}
    command = [sys.executable, str(EXAMPLE), *images]
    return subprocess.run(command, capture_output=True, text=True, env=environment)


def assert_shows_a_pose(printed, *, with_truth):
    assert printed.startswith("Status        ok: ")
    assert ("truth" in printed) == with_truth
    assert "quaternion (w, x, y, z): [" in printed
    assert Path("out", "01_two_images.jpg").read_bytes().startswith(b"\xff\xd8")


def test_the_example_prints_the_pose_of_two_files_and_draws_it(folder):
    run = run_example("a.jpg", "b.jpg")
    assert run.stderr == ""
    assert_shows_a_pose(run.stdout, with_truth=False)


def test_the_example_without_files_shows_the_demo(folder, pair, monkeypatch, capsys):
    monkeypatch.setattr("epi360.synthetic.demo_pair", lambda: pair)
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert_shows_a_pose(capsys.readouterr().out, with_truth=True)


def test_the_example_explains_wrong_use(folder):
    run = run_example("a.jpg")
    assert run.returncode == 1
    assert "[A.jpg B.jpg]" in run.stderr
