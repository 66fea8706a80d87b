# SPDX-License-Identifier: BSD-3-Clause
"""Inputs that are no files: pipes are read whole or refused, devices are refused, at once."""

import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from epi360.runs.input_files import as_file, check_is_file, read_beginning, read_file, read_text

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and devices are POSIX")
LARGE = bytes(range(256)) * 4096  # more than a pipe holds


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


@pytest.fixture
def written():
    """Path of an unnamed pipe into which a slow program writes, as a shell's <(program)."""
    reading, writing = os.pipe()

    def write():
        time.sleep(0.05)
        with suppress(BrokenPipeError), os.fdopen(writing, "wb") as file:
            file.write(LARGE[:5000])
            file.flush()
            time.sleep(0.05)
            file.write(LARGE[5000:])

    writer = threading.Thread(target=write)
    writer.start()
    yield f"/dev/fd/{reading}"
    os.close(reading)
    writer.join()


def test_a_pipe_is_read_to_its_end(written):
    assert read_file(written) == LARGE


def test_the_beginning_of_a_slow_pipe_is_waited_for(written, tmp_path):
    assert read_beginning(written, 6000) == LARGE[:6000]
    (tmp_path / "a").write_bytes(b"short")
    assert read_beginning(tmp_path / "a", 6000) == b"short"


def test_a_pipe_is_copied_for_those_who_look_twice(written):
    with as_file(Path(written)) as copy:
        assert copy.read_bytes() == copy.read_bytes() == LARGE
    assert not copy.exists()


def test_an_error_about_the_copy_names_the_pipe(written):
    with pytest.raises(ValueError, match=f"^{written} is bad$"), as_file(Path(written)) as copy:
        raise ValueError(f"{copy} is bad")


def test_a_file_is_itself(tmp_path):
    (tmp_path / "a").write_bytes(b"\xef\xbb\xbfone\r\ntwo")
    with as_file(tmp_path / "a") as path:
        assert path == tmp_path / "a"
    assert read_text(tmp_path / "a") == "one\ntwo"
    check_is_file(tmp_path / "a")


def test_a_pipe_that_nobody_writes_into_is_refused_at_once(pipe):
    with pytest.raises(ValueError, match="is a pipe that nobody writes into"):
        read_file(pipe)
    with pytest.raises(ValueError, match="must be a file, got a pipe"):
        check_is_file(pipe)


def test_a_device_is_refused():
    with pytest.raises(ValueError, match="/dev/zero must be a file, got a device"):
        read_file("/dev/zero")
    with pytest.raises(ValueError, match="/dev/zero must be a file, got a device"):
        check_is_file("/dev/zero")


def test_more_than_the_limit_is_refused(tmp_path, written):
    (tmp_path / "a").write_bytes(bytes(101))
    assert len(read_file(tmp_path / "a", largest=101)) == 101
    for path in (tmp_path / "a", written):
        with pytest.raises(ValueError, match="must have 100 bytes at most"):
            read_file(path, largest=100)


def test_a_missing_file_and_a_folder_are_what_they_are_elsewhere(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "missing")
    with pytest.raises(IsADirectoryError):
        read_file(tmp_path)
