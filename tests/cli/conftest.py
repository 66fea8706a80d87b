# SPDX-License-Identifier: BSD-3-Clause
"""How the tests of a command run it."""

import pytest

from epi360.cli import main


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run ``epi360 convert`` in the test's folder: exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        code = main(["convert", *words])
        out, err = capsys.readouterr()
        return code, out.strip(), err.strip()

    return run
