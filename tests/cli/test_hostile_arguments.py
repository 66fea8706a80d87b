# SPDX-License-Identifier: BSD-3-Clause
"""Arguments that no machine can do, and an interrupt before anything has begun."""

import subprocess
import sys

import pytest
from command_line import assert_wrong_use

from epi360 import cli

HUGE = "99999999999999999999"
NUMBERS = {
    "pair a.jpg b.jpg": ["--max-width"],
    "match images": ["--jobs", "--num-threads", "--overlap", "--max-width", "--max-features"],
    "map images": ["--jobs", "--mapper-threads", "--face-size", "--jpeg-quality", "--overlap"],
    "batch in.db --output out.parquet": ["--threads", "--num-threads", "--pairs-per-part"],
    "render out": ["--width", "--num-frames", "--supersample"],
    "localize map new.png": ["--max-views"],
    "track frames": ["--max-width", "--max-points"],
    "frames walk.mp4 out": ["--every", "--jpeg-quality"],
    "demo --no-open": ["--port", "--workers", "--max-waiting"],
    "cubemap model images out": ["--face-size", "--jpeg-quality"],
    "reproduce table1": ["--trials", "--jobs", "--image-width"],
}


@pytest.mark.parametrize(
    ("command", "option"),
    [(command, option) for command, options in NUMBERS.items() for option in options],
)
@pytest.mark.parametrize("value", [HUGE, f"-{HUGE}"])
def test_a_huge_number_is_wrong_use(command, option, value, capsys):
    name = "--num-threads" if option in ("--jobs", "--threads") else option
    name = "--jobs" if command.startswith("reproduce") and option == "--jobs" else name
    assert_wrong_use(capsys, [*command.split(), f"{option}={value}"], f"{name} must be")


@pytest.mark.parametrize("command", NUMBERS)
def test_a_number_longer_than_numbers_may_be_is_wrong_use(command, capsys):
    option = NUMBERS[command][0]
    assert_wrong_use(capsys, [*command.split(), f"{option}={'9' * 5000}"])


def test_seeds_may_be_large(capsys, tmp_path):
    words = ["pair", tmp_path / "a.jpg", tmp_path / "b.jpg", "--seed", HUGE]
    assert_wrong_use(capsys, words, "a.jpg does not exist")


@pytest.mark.parametrize("width", ["2000000", "23172"])
def test_a_picture_that_no_command_would_read_is_not_rendered(width, capsys, tmp_path):
    words = ["render", tmp_path / "out", "--num-frames", "1", "--width", width]
    assert_wrong_use(capsys, words, "--width may give 268435456 pixels at most")
    assert not (tmp_path / "out").exists()


def test_a_lack_of_memory_is_one_line(capsys, monkeypatch):
    def fail(*_, **__):
        raise MemoryError("Unable to allocate 7.28 TiB for an array")

    monkeypatch.setattr("epi360.interop.formats.format_of_name", fail)
    assert_wrong_use(capsys, ["convert", "a", "b"], "not enough memory: Unable to allocate 7.28")


def test_a_long_argument_is_shortened_in_the_message(capsys):
    for words in (["pair", "x" * 5000, "b"], ["x" * 5000], ["convert", "a", "b." + "y" * 5000]):
        assert cli.main(words) == 2
        assert len(capsys.readouterr().err) < 1100


@pytest.mark.parametrize("module", ["cyclopts", "epi360.cli.match", "epi360.cli.command"])
def test_an_interrupt_while_the_program_loads_is_one_line(module):
    program = f"""
import sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from epi360.cli import main
"""
    command = [sys.executable, "-c", program]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (answer.returncode, answer.stdout) == (130, "")
    assert answer.stderr == "epi360: interrupted\n"
