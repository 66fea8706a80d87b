# SPDX-License-Identifier: BSD-3-Clause
"""Files that appear whole or not at all: the one way in which this package writes.

A file is written under a temporary name beside it, ``.epi360-MACHINE-PROCESS-RANDOM.tmp``, brought
to the disk and renamed. A killed run leaves its temporary files behind; the next process that
writes into the folder removes those of processes of this machine that have ended.
"""

import os
import re
import secrets
import shutil
import socket
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import IO

from epi360.runs.remote_path import RemotePath

PathLike = str | os.PathLike[str]

# Two machines may write into one folder, and each has processes of its own. What SQLite puts beside
# a database has a name that goes on behind ".tmp".
_TEMPORARY = re.compile(r"\.epi360-([0-9a-f]{8})-(\d+)-[0-9a-f]{8}\.tmp(-\w+)?")
_ENDS = ("", "-journal", "-wal", "-shm")


def write_file(path: PathLike | RemotePath, data: bytes) -> None:
    """Write a file whole or not at all; a device or pipe is written to, missing folders stay so."""
    if isinstance(path, RemotePath):
        path.write_bytes(data)
        return
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():  # renaming would replace /dev/null
        with _named(path, target):
            target.write_bytes(data)
        return
    with whole_file(path) as file:
        file.write(data)


@contextmanager
def whole_file(path: PathLike, *, make_folder: bool = False) -> Iterator[IO[bytes]]:
    """Open a file that appears, with all that the block wrote, when the block ends well."""
    with whole_path(path, make_folder=make_folder) as temporary, temporary.open("wb") as file:
        yield file


@contextmanager
def whole_path(path: PathLike, *, make_folder: bool = False) -> Iterator[Path]:
    """Temporary path, for the block to write, that takes the place of a file when the block ends.

    If the block fails, nothing is left of it. A symbolic link is followed.
    """
    with whole_paths(path, make_folder=make_folder) as (temporary,):
        yield temporary


@contextmanager
def whole_paths(*paths: PathLike, make_folder: bool = False) -> Iterator[list[Path]]:
    """Temporary paths of several files that take their places together; see `whole_path`."""
    with ExitStack() as stack:
        pairs = [stack.enter_context(_replacement(path, make_folder)) for path in paths]
        yield [temporary for temporary, _ in pairs]
        for path, (temporary, _) in zip(paths, pairs, strict=True):
            with _named(path, temporary):
                _sync(temporary, os.O_RDWR)
        for path, (temporary, target) in zip(paths, pairs, strict=True):
            with _named(path, temporary):
                os.replace(temporary, target)
        for folder in {target.parent for _, target in pairs}:
            with suppress(OSError):  # Windows cannot open folders
                _sync(folder, os.O_RDONLY)


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Temporary folder that takes the place of a folder when the block ends well."""
    temporary = _temporary(path)
    try:
        temporary.mkdir()
        yield temporary
        shutil.rmtree(path, ignore_errors=True)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def _replacement(path: PathLike, make_folder: bool) -> Iterator[tuple[Path, Path]]:
    """Temporary path and its target; nothing is left of the temporary one in the end."""
    target = Path(os.path.realpath(path))
    if make_folder:
        target.parent.mkdir(parents=True, exist_ok=True)
    temporary = _temporary(target)
    try:
        with _named(path, temporary):
            yield temporary, target
    finally:
        for end in _ENDS:
            with suppress(OSError):
                Path(f"{temporary}{end}").unlink(missing_ok=True)


@contextmanager
def _named(path: PathLike, temporary: Path) -> Iterator[None]:
    """Errors of a temporary file name the path that was asked for."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(temporary)):
            raise  # the block reads another file
        reason = f"cannot write ({error.strerror or error})"
        raise OSError(error.errno, reason, os.fspath(path)) from error


def scratch_folder() -> Path:
    """New folder that only this user reads; if this process is killed, the next one removes it."""
    folder = _temporary(Path(tempfile.gettempdir(), "scratch"))
    folder.mkdir(mode=0o700)
    return folder


def _temporary(target: Path) -> Path:
    remove_leftovers(target.parent)
    name = f".epi360-{_machine()}-{os.getpid()}-{secrets.token_hex(4)}.tmp"
    return target.with_name(name)


@lru_cache
def _machine() -> str:
    """Hash of the machine, or of the container: each counts its processes by itself."""
    processes = ""
    with suppress(OSError):
        processes = os.readlink("/proc/self/ns/pid")  # on Linux
    return f"{zlib.crc32(f'{socket.gethostname()} {processes}'.encode()):08x}"


@cache  # once a process: a folder may have a hundred thousand files
def remove_leftovers(folder: Path) -> None:
    """Remove what processes of this machine that have ended were writing into a folder."""
    if os.name != "posix":  # Windows ends a process that is asked for like this
        return
    with suppress(OSError):
        for entry in list(os.scandir(folder)):
            found = _TEMPORARY.fullmatch(entry.name)
            if found and found[1] == _machine() and not _is_running(int(found[2])):
                _remove(Path(entry.path))


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True  # the process is somebody else's
    return True


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        path.unlink()


def _sync(path: Path, flags: int) -> None:
    """Bring a file, or the names in a folder, to the disk: they survive a power cut."""
    descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
