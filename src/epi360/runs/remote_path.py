# SPDX-License-Identifier: BSD-3-Clause
"""A place in an object store, with what a `Path` has and our folders need."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from epi360.extras import extra_library


@dataclass(frozen=True, order=True)
class RemotePath:
    """A URL that fsspec understands; folders are there when something is in them.

    What is written replaces a file in one step, as object stores do it.
    """

    url: str

    def __str__(self) -> str:
        return self.url

    def __truediv__(self, name: str) -> RemotePath:
        return RemotePath(f"{self.url.rstrip('/')}/{name}")

    @property
    def name(self) -> str:
        """Last part of the URL."""
        return self.url.rstrip("/").rpartition("/")[2]

    def absolute(self) -> RemotePath:
        """Return the path as it is: a URL means the same everywhere."""
        return self

    def exists(self) -> bool:
        """Whether there is such a file or folder."""
        files, name = self._filesystem()
        return bool(files.exists(name))

    def is_dir(self) -> bool:
        """Whether there are files below."""
        files, name = self._filesystem()
        return bool(files.isdir(name))

    def is_file(self) -> bool:
        """Whether there is such a file."""
        files, name = self._filesystem()
        return bool(files.isfile(name))

    def iterdir(self) -> Iterator[RemotePath]:
        """Files and folders in this folder; none where it is not there."""
        files, name = self._filesystem()
        entries = files.ls(name, detail=False) if files.exists(name) else []
        for entry in entries:
            yield self / str(entry).rstrip("/").rpartition("/")[2]

    def glob(self, pattern: str) -> Iterator[RemotePath]:
        """Files and folders in this folder whose names are like the pattern."""
        return (path for path in self.iterdir() if fnmatch(path.name, pattern))

    def mkdir(self, *, parents: bool = False, exist_ok: bool = False) -> None:
        """Do nothing: a folder is there when something is in it."""

    def unlink(self, *, missing_ok: bool = False) -> None:
        """Remove a file."""
        files, name = self._filesystem()
        if not missing_ok or files.exists(name):
            files.rm_file(name)

    def read_bytes(self) -> bytes:
        """Content of a file."""
        files, name = self._filesystem()
        return bytes(files.cat_file(name))

    def write_bytes(self, data: bytes) -> None:
        """Write a file; its folders are made where the storage has such."""
        files, name = self._filesystem()
        files.makedirs(name.rpartition("/")[0], exist_ok=True)
        files.pipe_file(name, data)

    def _filesystem(self) -> tuple[Any, str]:
        return filesystem_of(self.url)


AnyPath = Path | RemotePath


def is_remote(path: str) -> bool:
    """Whether a path is a URL; ``file://`` is a file of this machine."""
    return "://" in path and not path.startswith("file://")


def path_of(path: str | os.PathLike[str] | RemotePath) -> AnyPath:
    """Path on this machine, or URL."""
    if isinstance(path, RemotePath):
        return path
    text = os.fspath(path)
    return RemotePath(text) if is_remote(text) else Path(text.removeprefix("file://"))


def filesystem_of(url: str) -> tuple[Any, str]:
    """File system of a URL, and the name of the file in it."""
    core = extra_library("fsspec.core", extra="batch", purpose="paths with ://")
    files, name = core.url_to_fs(url)
    # Another machine may have written since this process last listed the folder.
    files.invalidate_cache()
    return files, name
