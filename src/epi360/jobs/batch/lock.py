# SPDX-License-Identifier: BSD-3-Clause
"""One run at a time for an output."""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from epi360.jobs.batch import storage

# A file system that has no locks, as some network disks.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)


@contextmanager
def only_run(output: str) -> Iterator[None]:
    """Hold the lock of an output, a file beside it that goes at the end.

    The system gives the lock back when the process ends, however it ends: what a killed run leaves
    blocks nobody. Not guarded are URLs, Windows and disks without locks; there, two runs at once
    cannot mix poses either, since files appear whole, but one of them may miss parts.

    Parameters
    ----------
    output : str
        Path or URL; the folder is made.

    Raises
    ------
    ValueError
        If another run holds it.
    OSError
        If the folder cannot be written.
    """
    if storage.is_remote(output) or os.name != "posix":
        yield
        return
    target = Path(os.path.realpath(storage.local_path(output)))
    target.parent.mkdir(parents=True, exist_ok=True)
    path = target.with_name(f".{target.name}.lock")
    descriptor = _locked(path, output)
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(descriptor)


def _locked(path: Path, output: str) -> int:
    """Open and lock the file of that path; says who has it where that fails."""
    import fcntl

    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.read(descriptor, 200).decode(errors="replace")
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise ValueError(
                    f"another run{holder} is writing {output}; wait for it or stop it"
                ) from None
        with suppress(OSError):  # removed meanwhile by the run that had it
            if os.stat(path).st_ino == os.fstat(descriptor).st_ino:
                break
        os.close(descriptor)
    with suppress(OSError):  # a full disk
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f" (process {os.getpid()} on {socket.gethostname()})".encode())
    return descriptor
