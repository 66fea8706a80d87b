# SPDX-License-Identifier: BSD-3-Clause
"""Files appear whole or not at all, and what killed runs leave goes with the next run."""

import os
import subprocess
import sys

import pytest

from epi360.runs import whole_files
from epi360.runs.whole_files import (
    remove_leftovers,
    whole_file,
    whole_folder,
    whole_path,
    whole_paths,
    write_file,
)


@pytest.fixture(autouse=True)
def another_run():
    remove_leftovers.cache_clear()


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_replaced_when_the_block_ends(tmp_path):
    target = tmp_path / "file"
    target.write_bytes(b"old")
    with whole_file(target) as file:
        file.write(b"new")
        file.flush()
        assert target.read_bytes() == b"old"
    assert target.read_bytes() == b"new"
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize("error", [RuntimeError("stop"), KeyboardInterrupt()])
def test_a_block_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, error):
    target = tmp_path / "file"
    target.write_bytes(b"old")
    with pytest.raises(type(error)), whole_file(target) as file:
        file.write(b"half")
        raise error
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["file"]


def test_a_symbolic_link_stays_and_its_target_is_replaced(tmp_path):
    (tmp_path / "there").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "there" / "file")
    write_file(link, b"new")
    assert link.is_symlink()
    assert (tmp_path / "there" / "file").read_bytes() == b"new"


@pytest.mark.skipif(os.name != "posix", reason="needs a device")
def test_a_device_is_written_to_and_not_replaced():
    write_file(os.devnull, b"gone")
    assert not os.path.isfile(os.devnull)


def test_a_folder_is_made_only_where_it_is_asked_for(tmp_path):
    with pytest.raises(FileNotFoundError, match="cannot write") as error:
        write_file(tmp_path / "new" / "file", b"x")
    assert error.value.filename == str(tmp_path / "new" / "file")
    with whole_file(tmp_path / "new" / "file", make_folder=True) as file:
        file.write(b"x")
    assert names(tmp_path / "new") == ["file"]


def test_an_error_names_the_file_that_was_asked_for_and_why(tmp_path):
    with pytest.raises(OSError, match="cannot write .No space left") as error:
        with whole_path(tmp_path / "file"):
            raise OSError(28, "No space left on device")
    assert (error.value.errno, error.value.filename) == (28, str(tmp_path / "file"))


def test_an_error_of_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError) as error, whole_path(tmp_path / "file"):
        (tmp_path / "input").read_bytes()
    assert error.value.filename == str(tmp_path / "input")


def test_a_name_as_long_as_the_file_system_takes_can_be_written(tmp_path):
    write_file(tmp_path / ("n" * 255), b"x")
    assert names(tmp_path) == ["n" * 255]


def test_files_that_belong_together_appear_together(tmp_path):
    paths = tmp_path / "a", tmp_path / "b"
    with whole_paths(*paths) as temporaries:
        for temporary in temporaries:
            temporary.write_bytes(b"x")
        assert not any(path.exists() for path in paths)
    assert names(tmp_path) == ["a", "b"]


def test_if_one_of_several_files_is_not_written_none_appears(tmp_path):
    with pytest.raises(FileNotFoundError) as error:
        with whole_paths(tmp_path / "a", tmp_path / "b") as (first, _):
            first.write_bytes(b"x")
    assert error.value.filename == str(tmp_path / "b")
    assert names(tmp_path) == []


def test_a_folder_is_replaced_with_all_that_was_in_it(tmp_path):
    (tmp_path / "models" / "7").mkdir(parents=True)
    with whole_folder(tmp_path / "models") as temporary:
        (temporary / "0").mkdir()
    assert names(tmp_path) == ["models"]
    assert names(tmp_path / "models") == ["0"]


KILLED = """
import os, signal, sys
from epi360.runs.whole_files import whole_folder, whole_path
with whole_path(sys.argv[1]) as path, whole_folder(path.with_name("folder")) as folder:
    path.write_text("half")
    open(f"{path}-wal", "w").close()
    (folder / "part").touch()
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
def test_what_a_killed_run_leaves_is_removed_by_the_next_one(tmp_path):
    target = tmp_path / "file"
    subprocess.run([sys.executable, "-c", KILLED, str(target)], check=False, timeout=60)
    assert len(names(tmp_path)) == 3
    write_file(target, b"whole")
    assert names(tmp_path) == ["file"]
    assert target.read_bytes() == b"whole"


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
def test_a_scratch_folder_of_a_killed_process_is_removed_by_the_next_one(tmp_path, monkeypatch):
    program = (
        "import os, signal; from epi360.runs.whole_files import scratch_folder;"
        "(scratch_folder() / 'upload.jpg').touch(); os.kill(os.getpid(), signal.SIGKILL)"
    )
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    for _ in range(2):
        subprocess.run([sys.executable, "-c", program], check=False, timeout=60)
        (left,) = tmp_path.iterdir()
        assert left.stat().st_mode & 0o777 == 0o700


def test_what_another_run_is_writing_stays(tmp_path):
    theirs = [
        f".epi360-{whole_files._machine()}-{os.getpid()}-00000000.tmp",  # a process that runs
        ".epi360-00000000-1-00000000.tmp",  # another machine
        ".file.12.tmp",  # not ours
    ]
    for name in theirs:
        (tmp_path / name).touch()
    write_file(tmp_path / "file", b"x")
    assert names(tmp_path) == sorted([*theirs, "file"])
