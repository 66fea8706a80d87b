# SPDX-License-Identifier: BSD-3-Clause
"""What every command keeps to: its help is on stdout, wrong use is one line on stderr."""

from epi360 import cli


def assert_wrong_use(capsys, arguments, *fragments):
    """Exit code 2, nothing on stdout and one line on stderr that holds all fragments."""
    assert cli.main([str(word) for word in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("epi360: error: ")
    assert captured.err.count("\n") == 1
    assert captured.err.endswith("\n")
    assert "Traceback" not in captured.err
    for fragment in fragments:
        assert fragment in captured.err


def assert_help_names(capsys, command, *words):
    """Exit code 0, nothing on stderr, and all words (options, arguments) in the help."""
    assert cli.main([command, "--help"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    missing = [word for word in words if word not in captured.out]
    assert missing == [] and words
