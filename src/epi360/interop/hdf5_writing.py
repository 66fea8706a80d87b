# SPDX-License-Identifier: BSD-3-Clause
"""HDF5 files that are written whole or not at all, also where the disk gets full.

HDF5 ends the process (a segmentation fault in version 2.0) if it cannot write what it holds back
until a file is closed. It therefore writes through `_Disk`, which keeps the error to itself.
"""

import io
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from epi360.extras import extra_library
from epi360.runs.whole_files import whole_paths


@contextmanager
def new_hdf5_files(*paths: Path) -> Iterator[list[Any]]:
    """HDF5 files under temporary names, which get the real names together."""
    h5py = extra_library("h5py", extra="hloc", purpose="hloc's files")
    for path in paths:
        if path.is_dir():
            raise IsADirectoryError(f"{path} must be a file to write, it is a folder")
    with whole_paths(*paths) as temporaries, ExitStack() as files:
        disks = [_Disk(files.enter_context(each.open("w+b", buffering=0))) for each in temporaries]
        try:
            with ExitStack() as opened:
                yield [opened.enter_context(h5py.File(disk, "w")) for disk in disks]
        finally:
            for disk, path in zip(disks, paths, strict=True):
                if disk.error is not None:  # instead of what HDF5 made of it
                    raise OSError(disk.error.errno, disk.error.strerror, str(path)) from None


class _Disk(io.RawIOBase):
    """A file that says nothing when it cannot be written, but remembers the first error."""

    def __init__(self, file: io.FileIO) -> None:
        self._file = file
        self.error: OSError | None = None

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readinto(self, buffer: Any, /) -> int:
        return self._file.readinto(buffer) or 0

    def write(self, data: Any, /) -> int:
        rest = memoryview(data).cast("B")
        try:
            while rest and self.error is None:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self.error = error
        return memoryview(data).nbytes

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return self._file.truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0
