# SPDX-License-Identifier: BSD-3-Clause
"""Files are read once while they stay as they are."""

import os
import time
from hashlib import blake2b

import pytest

from epi360.runs import file_digests
from epi360.runs.file_digests import FileDigests


@pytest.fixture
def image(tmp_path):
    path = tmp_path / "ä.jpg"
    path.write_bytes(b"one")
    return path


@pytest.fixture
def settled(monkeypatch):
    """Files count as settled at once."""
    monkeypatch.setattr(file_digests, "_SETTLED_NS", -(10**18))


@pytest.fixture
def reads(monkeypatch):
    seen = []
    monkeypatch.setattr(file_digests, "blake2b", lambda data: seen.append(data) or blake2b(data))
    return seen


def remembered(image, memory):
    digests = FileDigests(memory)
    digest = digests.digest_of(image)
    digests.save()
    return digest


def test_a_file_is_read_once_in_all_runs(image, tmp_path, settled, reads):
    memory = tmp_path / "digests.json"
    assert remembered(image, memory) == blake2b(b"one").digest()
    assert remembered(image, memory) == blake2b(b"one").digest()
    assert len(reads) == 1


def test_a_change_that_keeps_size_and_time_is_seen(image, tmp_path, settled):
    memory = tmp_path / "digests.json"
    remembered(image, memory)
    before = image.stat()
    time.sleep(0.02)  # a tick of the file system's clock
    image.write_bytes(b"two")
    os.utime(image, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert image.stat().st_mtime_ns == before.st_mtime_ns
    assert remembered(image, memory) == blake2b(b"two").digest()


def test_a_file_that_just_changed_is_not_trusted(image, tmp_path, reads):
    memory = tmp_path / "digests.json"
    for _ in range(2):
        remembered(image, memory)
    assert len(reads) == 2


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"a": 1}', '{"a": [[1], "no hash"]}'])
def test_a_damaged_memory_counts_as_missing(image, tmp_path, settled, content):
    memory = tmp_path / "digests.json"
    memory.write_text(content)
    assert remembered(image, memory) == blake2b(b"one").digest()
    assert remembered(image, memory) == blake2b(b"one").digest()


def test_a_missing_file_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        FileDigests().digest_of(tmp_path / "none")
