# SPDX-License-Identifier: BSD-3-Clause
"""`epi360 completion`: the scripts know every command, and bash completes with them."""

import shutil
import subprocess

import pytest
from command_line import assert_wrong_use

from epi360 import cli
from epi360.cli.command import app

COMMANDS = [name for name in app if not name.startswith("-")]
BASH = shutil.which("bash")
needs_bash = pytest.mark.skipif(BASH is None, reason="bash is not installed")


def completion_script(capsys, shell):
    assert cli.main(["completion", shell]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return captured.out


def completed_by_bash(script, *words):
    """What bash offers for the last of the words, with nothing but the script loaded."""
    line = " ".join(f"'{word}'" for word in ("epi360", *words))
    ask = f"COMP_WORDS=({line}); COMP_CWORD={len(words)}; _epi360; echo ${{COMPREPLY[@]}}"
    run = subprocess.run(
        [BASH, "--norc", "-c", f"{script}\n{ask}"], capture_output=True, text=True, check=True
    )
    return set(run.stdout.split())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_names_every_command(capsys, shell):
    script = completion_script(capsys, shell)
    assert [name for name in COMMANDS if name not in script] == [] and COMMANDS


@needs_bash
def test_bash_completes_the_commands_that_begin_so(capsys):
    script = completion_script(capsys, "bash")
    assert completed_by_bash(script, "ma") == {"map", "match"}


@needs_bash
def test_bash_completes_the_options_of_a_command(capsys):
    script = completion_script(capsys, "bash")
    assert completed_by_bash(script, "pair", "--fig") == {"--figure"}


def test_another_shell_is_wrong_use(capsys):
    assert_wrong_use(capsys, ["completion", "tcsh"], "tcsh", "bash")
