# SPDX-License-Identifier: BSD-3-Clause
"""Files of a batch, on a disk or in an object store: a path, or a URL that fsspec understands.

A file is written whole or not at all. On a disk: temporary name beside it, fsync, rename. For a
URL: a temporary local file, then one put, which object stores do in one step.
"""

from __future__ import annotations

import glob
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, cast

from epi360.extras import extra_library


def is_remote(path: str) -> bool:
    """Whether a path is a URL that fsspec opens, and not a file of this machine.

    Parameters
    ----------
    path : str
        Path or URL; ``file://`` is a file of this machine.
    """
    return "://" in path and not path.startswith("file://")


def local_path(path: str) -> Path:
    """Path on this machine of a path or a ``file://`` URL.

    Parameters
    ----------
    path : str
        Not remote.
    """
    return Path(path.removeprefix("file://"))


def exists(path: str) -> bool:
    """Whether there is such a file or folder.

    Parameters
    ----------
    path : str
        Path or URL.
    """
    if is_remote(path):
        files, name = _filesystem(path)
        return bool(files.exists(name))
    return local_path(path).exists()


@contextmanager
def open_read(path: str) -> Iterator[IO[bytes]]:
    """Open a file for reading.

    Parameters
    ----------
    path : str
        Path or URL.

    Yields
    ------
    file : binary file

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    """
    if is_remote(path):
        files, name = _filesystem(path)
        # The reader asks for large pieces of several places in turn: reading ahead would fetch
        # most of the file several times.
        with files.open(name, "rb", cache_type="none") as file:
            yield file
        return
    with local_path(path).open("rb") as file:
        yield file


@contextmanager
def write_whole(path: str) -> Iterator[IO[bytes]]:
    """Write a file that appears when the block ends well, and not at all where it does not.

    Parameters
    ----------
    path : str
        Path or URL; what is there is replaced. Its folder is made.

    Yields
    ------
    file : binary file

    Raises
    ------
    OSError
        If it cannot be written, for example because the disk is full.
    """
    if is_remote(path):
        with tempfile.TemporaryDirectory(prefix="epi360-") as folder:
            temporary = Path(folder) / "file"
            with temporary.open("wb") as file:
                yield file
            files, name = _filesystem(path)
            files.makedirs(name.rpartition("/")[0], exist_ok=True)
            files.put_file(str(temporary), name)
        return
    # The target of a symbolic link is what is replaced.
    target = Path(os.path.realpath(local_path(path)))
    target.parent.mkdir(parents=True, exist_ok=True)
    # Not the process id: two machines may write into one folder.
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
        _sync_folder(target.parent)
    except OSError as error:
        if error.filename not in (None, str(temporary)):  # of a file that is read in the block
            raise
        raise OSError(error.errno, f"cannot write ({error.strerror or error})", path) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_leftovers(path: str) -> None:
    """Remove the temporary files that killed runs have left beside a file.

    Parameters
    ----------
    path : str
        Path or URL of the file that they wanted to write; nobody else may be writing it.
    """
    if is_remote(path):
        return
    target = Path(os.path.realpath(local_path(path)))
    # SQLite has files of its own beside a database, whose names go on behind its name.
    for leftover in target.parent.glob(f".{glob.escape(target.name)}.*.tmp*"):
        leftover.unlink(missing_ok=True)


def read_ranges(path: str, ranges: Sequence[tuple[int, int]]) -> list[bytes]:
    """Bytes of some places of a file, without reading the rest.

    Parameters
    ----------
    path : str
        Path or URL.
    ranges : sequence of (int, int)
        First byte and the one after the last.
    """
    if is_remote(path):
        files, name = _filesystem(path)
        starts, ends = [start for start, _ in ranges], [end for _, end in ranges]
        return cast("list[bytes]", files.cat_ranges([name] * len(ranges), starts, ends))
    pieces = []
    with local_path(path).open("rb") as file:
        for start, end in ranges:
            file.seek(start)
            pieces.append(file.read(end - start))
    return pieces


def file_size(path: str) -> int:
    """Bytes of a file.

    Parameters
    ----------
    path : str
        Path or URL.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    """
    if is_remote(path):
        files, name = _filesystem(path)
        return int(files.size(name))
    return local_path(path).stat().st_size


def names_in(folder: str) -> list[str]:
    """Names of the files in a folder, sorted; none where there is no such folder.

    Parameters
    ----------
    folder : str
        Path or URL.
    """
    if is_remote(folder):
        files, name = _filesystem(folder)
        if not files.exists(name):
            return []
        return sorted(str(entry).rpartition("/")[2] for entry in files.ls(name, detail=False))
    path = local_path(folder)
    return sorted(entry.name for entry in path.iterdir()) if path.is_dir() else []


def remove_folder(folder: str) -> None:
    """Remove a folder with its files.

    Parameters
    ----------
    folder : str
        Path or URL; nothing happens where it is not there.
    """
    if not exists(folder):
        return
    if is_remote(folder):
        files, name = _filesystem(folder)
        files.rm(name, recursive=True)
        return
    shutil.rmtree(local_path(folder))


def _filesystem(url: str) -> tuple[Any, str]:
    """File system of a URL and the name of the file in it."""
    core = extra_library("fsspec.core", extra="batch", purpose="paths with ://")
    files, name = core.url_to_fs(url)
    # Another machine may have written since this process last listed the folder.
    files.invalidate_cache()
    return files, name


def _sync_folder(folder: Path) -> None:
    """Make a rename survive a power cut; where folders cannot be opened (Windows) it is left."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
