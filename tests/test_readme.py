# SPDX-License-Identifier: BSD-3-Clause
"""README and docs: every block runs, every link and table is true.

A document's blocks run in a folder with the demo's panoramas a.jpg and b.jpg.
"""

import importlib
import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import get_args

import cv2
import pytest
from documents import ROOT, blocks_of, check_links, run_document, text_of

import epi360
from epi360 import cli
from epi360.cameras import load_cameras
from epi360.cameras.calibration.colmap import SUPPORTED as COLMAP_MODELS
from epi360.cameras.calibration.own import MODELS
from epi360.estimation import Status
from epi360_scenes import demo_pair

README, CONVENTIONS = ROOT / "README.md", ROOT / "docs" / "conventions.md"
ESTIMATOR = ROOT / "docs" / "estimator.md"
START, USAGE = ROOT / "docs" / "start.md", ROOT / "docs" / "usage.md"
VERDICTS = ROOT / "docs" / "verdicts.md"
HOW_IT_WORKS = ROOT / "docs" / "how_it_works.md"
DOCUMENTS = (README, START, VERDICTS, USAGE, CONVENTIONS, HOW_IT_WORKS, ESTIMATOR)
EXAMPLE = ROOT / "examples" / "01_two_images.py"
PAGES = (README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
SOURCES = ("src", "native", "tests", "benchmarks", "docs", "examples")


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


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_block_of_a_document_runs_and_prints_what_it_says(document, folder):
    run_document(document)


def test_make_commands_of_the_readme_are_targets():
    makefile = text_of(ROOT / "Makefile")
    commands = re.findall(r"^make (\w+)", text_of(README), re.M)
    assert {"demo", "test"} <= set(commands)
    for target in commands:
        assert re.search(rf"^{target}:", makefile, re.M), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_of_a_document_lead_somewhere(document):
    check_links(document)


def code_spans(document):
    """Words in code font, blocks of code left out."""
    text = re.sub(r"^```.*?^```", "", text_of(document), flags=re.M | re.S)
    return [
        word for span in re.findall(r"`([^`\n]+)`", text) for word in re.findall(r"[\w./]+", span)
    ]


def can_be_imported(name):
    """Whether a dotted name is a module, or something in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[count:]:
            if not hasattr(found, attribute):
                return False
            found = getattr(found, attribute)
        return True
    return False


@pytest.mark.parametrize("document", PAGES, ids=lambda path: path.name)
def test_source_files_and_modules_that_a_page_names_exist(document):
    files = [path.relative_to(ROOT) for top in SOURCES for path in (ROOT / top).rglob("*.*")]
    for word in code_spans(document):
        if re.search(r"\w\.(py|cpp|h)$", word):
            assert any(f"/{file}".endswith(f"/{word}") for file in files), word
        elif re.match(r"(epi360\w*|jobs|interop|runs)\.\w", word):
            full_name = word if word.startswith("epi360") else f"epi360.{word}"
            assert can_be_imported(full_name), word


def test_pictures_are_small_enough_for_a_page():
    pictures = list((ROOT / "docs" / "images").rglob("*.webp"))
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size < 300_000, picture


def test_the_json_table_names_every_field_and_no_other(folder, pair, monkeypatch):
    monkeypatch.setattr("epi360_scenes.room.demo_pair", lambda: pair)
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
    monkeypatch.setattr("epi360_scenes.demo_pair", lambda: pair)
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE)])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert_shows_a_pose(capsys.readouterr().out, with_truth=True)


def test_the_example_explains_wrong_use(folder):
    run = run_example("a.jpg")
    assert run.returncode == 1
    assert "[A.jpg B.jpg]" in run.stderr
