# SPDX-License-Identifier: BSD-3-Clause
"""Documents whose blocks run.

Blocks run from top to bottom in the current folder: ``python`` is executed, ``epi360`` lines of
``bash`` go through the command, a ``text`` block behind either is what it prints, and a block
behind ``<!-- file: NAME -->`` is written to that file. A block behind ``<!-- not run: REASON -->``
is not run; that its programs and options exist is checked in any case.
"""

import contextlib
import io
import re
import shlex
import tomllib
from functools import cache
from pathlib import Path

import pytest

from epi360 import cli

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(
    r"(?:<!-- file: (?P<file>\S+) -->\n|<!-- not run: (?P<reason>[^\n]+) -->\n)?"
    r"^```(?P<language>\w*)\n(?P<body>.*?)^```$",
    re.M | re.S,
)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
DURATION = re.compile(r"[\d.,]+ ?(?=s\b|/s|pairs/s)")
LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")


# Options of other programs that the documents name, as their sources have them.
OTHERS = {
    "../gsplat/examples/simple_trainer.py": {"--data_dir", "--data_factor", "--result_dir"},
    "../gaussian-splatting/train.py": {"-s", "-m", "-r"},
    "../OpenSfM/bin/opensfm": set(),
    "../OpenSplat/build/opensplat": {"-n", "-o"},
    "ns-train": {
        "--data", "--colmap-path", "--masks-path", "--downscale-factor", "--orientation-method",
    },
}  # fmt: skip


def text_of(document):
    return document.read_text(encoding="utf-8")


def blocks_of(document):
    return list(BLOCK.finditer(text_of(document)))


def command_lines(body):
    """The lines of a bash block, each with its words; a line that ends in a backslash goes on."""
    for line in body.replace("\\\n", " ").splitlines():
        if words := shlex.split(line, comments=True):
            yield line, words


def run_bash(body):
    for line, words in command_lines(body):
        if words[0] == "epi360":
            assert cli.main(words[1:]) == (1 if "exit code 1" in line else 0), line
        else:
            check_command(words)


def check_command(words):
    """That a line can be typed, for lines that are not run: programs, targets, extras, options."""
    program = words[1] if words[0] == "python" else words[0]
    if words[0] == "epi360" or words[0].endswith("/epi360"):
        options = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert options <= options_of(words[1]), words
    elif program in OTHERS:
        assert {word for word in words if word.startswith("-")} <= OTHERS[program], words
    elif words[0] == "make":
        assert f"\n{words[1]}: " in text_of(ROOT / "Makefile"), words
    elif words[:2] == ["pip", "install"] or words[1:4] == ["-m", "pip", "install"]:
        check_extras(words)
    elif Path(words[0]).name == "python":
        assert (ROOT / words[1]).is_file(), words
    else:
        assert words[:3] == ["sudo", "apt", "install"] or words[0].startswith(".venv/"), words


@cache
def options_of(command):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert cli.main([command, "--help"]) == 0, command
    return set(re.findall(r"--[a-z][\w-]*", printed.getvalue()))


def check_extras(words):
    project = tomllib.loads(text_of(ROOT / "pyproject.toml"))["project"]
    for extras in re.findall(r"\[([\w,]+)\]", " ".join(words)):
        assert set(extras.split(",")) <= set(project["optional-dependencies"]), words


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
    printed, expected = DURATION.sub("", printed), DURATION.sub("", expected)
    assert [line.split() for line in NUMBER.sub("#", printed).strip().splitlines()] == [
        line.split() for line in NUMBER.sub("#", expected).strip().splitlines()
    ]
    for new, old in zip(NUMBER.findall(printed), NUMBER.findall(expected), strict=True):
        assert float(new) == pytest.approx(float(old), rel=0.25, abs=0.1), (new, old)


def check_block(block):
    """Check a block that is not run."""
    if block["language"] == "bash":
        for _, words in command_lines(block["body"]):
            check_command(words)
    else:
        compile(block["body"], "block", "exec")


def run_document(document):
    """Run the blocks of a document in the current folder."""
    printed, names, num_run = "", {}, 0
    for block in blocks_of(document):
        language, body = block["language"], block["body"]
        if block["file"]:
            Path(block["file"]).write_text(body, encoding="utf-8")
        elif block["reason"]:
            check_block(block)
        elif language == "text":
            assert_prints_about(printed, body)
        else:
            assert language in ("bash", "python"), f"{language} block without a file name"
            printed = run_block(language, body, names)
            num_run += 1
    assert num_run > 0


def check_links(document):
    """Every link of a document leads to a file, and to a title in it."""
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
