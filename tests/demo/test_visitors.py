# SPDX-License-Identifier: BSD-3-Clause
"""Uploaded files: bounded, under names of our own, and gone when their visitor is."""

import asyncio
import os
import signal
import subprocess
import sys
import tempfile

import pytest

from epi360_demo.limits import Limits, RefusedError
from epi360_demo.visitors import Visitors

LIMITS = Limits(max_file_bytes=1000, max_stored_bytes=2500, max_visitors=3, max_idle_s=0.0)


@pytest.fixture
def visitors():
    visitors = Visitors(LIMITS)
    yield visitors
    visitors.close()


async def chunks(*parts, error=None):
    for part in parts:
        yield part
    if error is not None:
        raise error


def receive(visitors, visitor, slot="1", name="a.jpg", parts=(b"abc",), error=None):
    return asyncio.run(visitors.receive(visitor, slot, name, chunks(*parts, error=error)))


def files_under(folder):
    return [path for path in folder.rglob("*") if path.is_file()]


def test_an_upload_is_kept_under_a_name_of_ours_with_its_own_suffix(visitors):
    upload = receive(visitors, visitors.arrive(), name="../../etc/my room.JPG", parts=(b"ab", b"c"))
    assert upload.path.read_bytes() == b"abc"
    assert upload.path.is_relative_to(visitors.root)
    assert (upload.name, upload.path.suffix) == ("my room.JPG", ".JPG")


@pytest.mark.parametrize("name", ["", "..", "a/b\\", "\n\0", "x" * 5000, "a.b c", "a.tooolong"])
def test_any_name_gives_a_file_in_the_folder_of_the_visitor(visitors, name):
    visitor = visitors.arrive()
    upload = receive(visitors, visitor, name=name)
    assert upload.path.parent == visitor.folder
    assert 0 < len(upload.name) <= 130
    assert upload.name.isprintable()


def test_a_new_upload_replaces_the_one_in_its_place(visitors):
    visitor = visitors.arrive()
    first, second = (receive(visitors, visitor, parts=(text,)) for text in (b"one", b"two"))
    assert files_under(visitor.folder) == [second.path]
    assert not first.path.exists()


@pytest.mark.parametrize(
    ("slot", "parts", "sentence"),
    [
        ("1", (b"x" * 600, b"x" * 600), "is larger than .* MB, the limit"),
        ("1", (), "is empty"),
        ("3", (b"x",), "takes two pictures and the file of a lens"),
    ],
)
def test_what_is_refused_leaves_no_file(visitors, slot, parts, sentence):
    visitor = visitors.arrive()
    with pytest.raises(RefusedError, match=sentence):
        receive(visitors, visitor, slot=slot, parts=parts)
    assert files_under(visitors.root) == []


def test_an_upload_that_breaks_off_leaves_no_file(visitors):
    with pytest.raises(ConnectionError):
        receive(visitors, visitors.arrive(), error=ConnectionError())
    assert files_under(visitors.root) == []


def test_all_visitors_together_are_bounded(visitors):
    first, second, third = (visitors.arrive() for _ in range(3))
    with pytest.raises(RefusedError, match="3 pages of this demo are open"):
        visitors.arrive()
    receive(visitors, first, parts=(b"x" * 1000,))
    receive(visitors, second, parts=(b"x" * 1000,))
    with pytest.raises(RefusedError, match="as many pictures of its visitors as it may"):
        receive(visitors, third, parts=(b"x" * 1000,))
    visitors.leave(first)
    receive(visitors, third, parts=(b"x" * 1000,))


def test_files_go_when_the_visitor_goes_and_nobody_finds_them_again(visitors):
    visitor, other = visitors.arrive(), visitors.arrive()
    receive(visitors, visitor)
    kept = receive(visitors, other)
    visitors.leave(visitor)
    assert files_under(visitors.root) == [kept.path]
    with pytest.raises(RefusedError, match="no longer connected"):
        visitors.find(visitor.token)


def test_files_of_a_visitor_who_does_nothing_for_long_go_and_the_page_hears_of_it(visitors):
    visitor, heard = visitors.arrive(), []
    visitor.on_change = lambda: heard.append(dict(visitor.uploads))
    receive(visitors, visitor)
    visitors.forget_idle()
    assert (files_under(visitors.root), heard) == ([], [{}])
    receive(visitors, visitor)  # the page is still there


def test_everything_goes_when_the_demo_ends(visitors):
    receive(visitors, visitors.arrive())
    visitors.close()
    assert not visitors.root.exists()


KILLED = """
import os, signal
from epi360_demo.limits import Limits
from epi360_demo.visitors import Visitors
visitors = Visitors(Limits())
(visitors.root / "1-picture.jpg").write_bytes(b"somebody's room")
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such signal")
def test_what_a_killed_demo_has_left_goes_when_the_next_one_starts(tmp_path, monkeypatch):
    ended = subprocess.run(
        [sys.executable, "-c", KILLED], env=os.environ | {"TMPDIR": str(tmp_path)}
    )
    assert ended.returncode == -signal.SIGKILL
    assert [path.name for path in files_under(tmp_path)] == ["1-picture.jpg"]
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    first = Visitors(LIMITS)
    second = Visitors(LIMITS)  # one that runs keeps its own
    assert list(tmp_path.iterdir()) and first.root.exists() and second.root.exists()
    assert files_under(tmp_path) == []
    assert first.root.stat().st_mode & 0o777 == 0o700
    for visitors in (first, second):
        visitors.close()
    assert list(tmp_path.iterdir()) == []


def test_an_upload_that_ends_after_its_page_was_closed_leaves_no_file(visitors):
    visitor = visitors.arrive()

    async def slow():
        yield b"ab"
        visitors.leave(visitor)
        yield b"c"

    with pytest.raises(RefusedError, match="no longer connected"):
        asyncio.run(visitors.receive(visitor, "1", "a.jpg", slow()))
    assert files_under(visitors.root) == []
