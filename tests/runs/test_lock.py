# SPDX-License-Identifier: BSD-3-Clause
"""One run at a time writes an output."""

import os
import subprocess
import sys

import pytest

from epi360.runs.lock import only_run

pytest.importorskip("filelock")
HOLD = """
import os, sys
from epi360.runs.lock import only_run
with only_run(sys.argv[1]):
    print(os.getpid(), flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", HOLD, tmp_path / "out"], **pipes) as process:
        assert process.stdout.readline().strip() == str(process.pid)
        yield process
        process.stdin.close()


@pytest.mark.skipif(os.name != "posix", reason="Windows lets nobody read a locked file")
def test_the_run_that_holds_the_output_is_named_to_each_that_asks(tmp_path, holder):
    for _ in range(2):  # asking must not make the holder forgotten
        with pytest.raises(ValueError, match=f"another run .process {holder.pid} on .* is writing"):
            with only_run(tmp_path / "out"):
                pass


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
def test_a_killed_run_holds_nothing(tmp_path, holder):
    holder.kill()
    holder.wait()
    with only_run(tmp_path / "out"):
        assert [path.name for path in tmp_path.iterdir()] == [".out.lock"]
    assert list(tmp_path.iterdir()) == []


def test_another_output_in_the_same_folder_is_free(tmp_path, holder):
    with only_run(tmp_path / "other"):
        pass
    assert [path.name for path in tmp_path.iterdir()] == [".out.lock"]
