# SPDX-License-Identifier: BSD-3-Clause
"""Files on a disk or in an object store: a path, or a URL that fsspec understands.

To a URL a file is written as a temporary local file and then put, which object stores do in one
step: there too it appears whole or not at all.
"""

import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

from epi360.runs.input_files import check_is_file
from epi360.runs.made_from import fingerprint
from epi360.runs.remote_path import filesystem_of
from epi360.runs.remote_path import is_remote as is_remote
from epi360.runs.whole_files import whole_file

_NUM_SAMPLES, _SAMPLE_BYTES = 16, 4096


def local_path(path: str) -> Path:
    """Path on this machine of a path or a ``file://`` URL."""
    return Path(path.removeprefix("file://"))


def is_same(path: str, other: str) -> bool:
    """Whether two paths are one file or folder that exists; of URLs, whether they are equal."""
    if is_remote(path) or is_remote(other):
        return path == other
    first, second = local_path(path), local_path(other)
    return first.exists() and second.exists() and first.samefile(second)


def exists(path: str) -> bool:
    """Whether there is such a file or folder."""
    if is_remote(path):
        files, name = filesystem_of(path)
        return bool(files.exists(name))
    return local_path(path).exists()


@contextmanager
def open_read(path: str) -> Iterator[IO[bytes]]:
    """Open a file for reading."""
    if is_remote(path):
        files, name = filesystem_of(path)
        # The reader asks for large pieces of several places in turn: reading ahead would fetch
        # most of the file several times.
        with files.open(name, "rb", cache_type="none") as file:
            yield file
        return
    check_is_file(local_path(path))
    with local_path(path).open("rb") as file:
        yield file


@contextmanager
def write_whole(path: str) -> Iterator[IO[bytes]]:
    """Open a file that appears when the block ends well; its folder is made."""
    if not is_remote(path):
        with whole_file(local_path(path), make_folder=True) as file:
            yield file
        return
    with tempfile.TemporaryDirectory(prefix="epi360-") as folder:
        temporary = Path(folder) / "file"
        with temporary.open("wb") as file:
            yield file
        files, name = filesystem_of(path)
        files.makedirs(name.rpartition("/")[0], exist_ok=True)
        files.put_file(str(temporary), name)


def read_ranges(path: str, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
    """Bytes of some places of a file, each from the first to before the last."""
    if is_remote(path):
        files, name = filesystem_of(path)
        starts, ends = [start for start, _ in ranges], [end for _, end in ranges]
        return cast("list[bytes]", files.cat_ranges([name] * len(ranges), starts, ends))
    pieces = []
    with local_path(path).open("rb") as file:
        for start, end in ranges:
            file.seek(start)
            pieces.append(file.read(end - start))
    return pieces


def file_size(path: str) -> int:
    """Bytes of a file."""
    if is_remote(path):
        files, name = filesystem_of(path)
        return int(files.size(name))
    return local_path(path).stat().st_size


def fingerprint_of_file(path: str, extra: Iterable[object] = ()) -> str:
    """Hash of a file's size, of 16 blocks of 4 KiB spread over it, and of the extra."""
    size = file_size(path)
    last = max(size - _SAMPLE_BYTES, 0)
    starts = sorted({last * k // (_NUM_SAMPLES - 1) for k in range(_NUM_SAMPLES)})
    ranges = [(start, min(start + _SAMPLE_BYTES, size)) for start in starts]
    return fingerprint((size,), *read_ranges(path, ranges), *extra)


def names_in(folder: str) -> list[str]:
    """Names of the files in a folder, sorted; none where there is no such folder."""
    if is_remote(folder):
        files, name = filesystem_of(folder)
        if not files.exists(name):
            return []
        return sorted(str(entry).rpartition("/")[2] for entry in files.ls(name, detail=False))
    path = local_path(folder)
    return sorted(entry.name for entry in path.iterdir()) if path.is_dir() else []


def remove_folder(folder: str) -> None:
    """Remove a folder with its files, if it is there."""
    if not exists(folder):
        return
    if is_remote(folder):
        files, name = filesystem_of(folder)
        files.rm(name, recursive=True)
        return
    shutil.rmtree(local_path(folder))
