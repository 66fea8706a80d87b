# SPDX-License-Identifier: BSD-3-Clause
"""Input files: a device, or a pipe that nobody writes into, is refused instead of waited for.

A pipe can be read once only, from its start to its end. A command that looks at its input twice
copies it first, see `as_file`.
"""

import errno
import os
import select
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from epi360.runs.remote_path import AnyPath, RemotePath
from epi360.runs.whole_files import PathLike

LARGEST_INPUT = 2**34  # bytes, 16 GB: more than any memory that is asked to hold a text
_BLOCK = 2**20


def read_file(path: PathLike, *, largest: int = LARGEST_INPUT) -> bytes:
    """Content of a file or pipe; ValueError for a device and beyond so many bytes."""
    with open_input(path) as file:
        if is_pipe(file):
            return b"".join(_blocks(path, file, largest))
        if os.fstat(file.fileno()).st_size > largest:
            raise _too_large(path, largest)
        return file.read()


def read_text(path: PathLike, *, largest: int = LARGEST_INPUT) -> str:
    """Content of a text file in UTF-8, with or without byte order mark and with any line ends."""
    text = read_file(path, largest=largest).decode("utf-8-sig")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_beginning(path: PathLike, size: int) -> bytes:
    """First bytes of a file or pipe, fewer where it is shorter; of a pipe, they are gone then."""
    with open_input(path) as file:
        if not is_pipe(file):
            return file.read(size)
        data = b""
        for block in _blocks(path, file, LARGEST_INPUT):
            data += block
            if len(data) >= size:
                break
        return data[:size]


def open_input(path: PathLike) -> IO[bytes]:
    """Open a file or pipe for reading, without waiting; ValueError for anything else."""
    return open(path, "rb", opener=_opener)


def check_is_file(path: PathLike) -> None:
    """Raise for what a library that opens files by itself would wait for, or read without end."""
    kind = stat.S_IFMT(os.stat(path).st_mode)
    if kind not in (stat.S_IFREG, stat.S_IFDIR):
        raise ValueError(f"{os.fspath(path)} must be a file, got {_kind(kind)}")


def is_pipe(file: IO[bytes]) -> bool:
    """Whether an open file is a pipe."""
    return stat.S_ISFIFO(os.fstat(file.fileno()).st_mode)


@contextmanager
def as_file(path: AnyPath) -> Iterator[Path]:
    """Path of a file or folder; for the block, a pipe or a file behind a URL is copied."""
    try:
        piped = isinstance(path, Path) and stat.S_ISFIFO(path.stat().st_mode)
    except OSError:
        piped = False  # whoever reads it says why
    if isinstance(path, Path) and not piped:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="epi360-") as folder:
        copy = Path(folder) / "input"
        _copy(path, copy)
        try:
            yield copy
        except ValueError as error:
            raise ValueError(str(error).replace(str(copy), str(path))) from error


def _copy(path: AnyPath, copy: Path) -> None:
    if isinstance(path, RemotePath):
        copy.write_bytes(path.read_bytes())
        return
    with open_input(path) as pipe, copy.open("wb") as file:
        for block in _blocks(path, pipe, LARGEST_INPUT):
            file.write(block)


def _opener(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
    kind = stat.S_IFMT(os.fstat(descriptor).st_mode)
    if kind in (stat.S_IFREG, stat.S_IFIFO):
        return descriptor
    os.close(descriptor)
    if kind == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), path)
    raise ValueError(f"{path} must be a file, got {_kind(kind)}")


def _blocks(path: PathLike, pipe: IO[bytes], largest: int) -> Iterator[bytes]:
    """Content of a pipe to its end; a writer may take its time, but there must be one."""
    size = 0
    while True:
        try:
            block = os.read(pipe.fileno(), _BLOCK)
        except BlockingIOError:
            select.select([pipe], [], [])
            continue
        if not block:
            break
        size += len(block)
        if size > largest:
            raise _too_large(path, largest)
        yield block
    if not size:
        raise ValueError(f"{os.fspath(path)} is a pipe that nobody writes into")


def _too_large(path: PathLike, largest: int) -> ValueError:
    return ValueError(f"{os.fspath(path)} must have {largest} bytes at most, got more")


def _kind(kind: int) -> str:
    names = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    return names.get(kind, "a device")
