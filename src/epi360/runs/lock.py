# SPDX-License-Identifier: BSD-3-Clause
"""One run at a time for an output."""

import errno
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from epi360.extras import extra_library
from epi360.runs.whole_files import PathLike

# What a file system that has no locks answers, as some network disks do.
_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)


@contextmanager
def only_run(output: PathLike) -> Iterator[None]:
    """Hold the lock of an output: a file beside it, which is removed at the end.

    If another run holds it, a ValueError says which process on which machine. On a disk without
    locks the run goes on without: since files appear whole, two runs at once cannot mix their
    results, but one of them may miss parts.
    """
    filelock = extra_library("filelock", extra="batch", purpose="batches")
    target = Path(os.path.realpath(output))
    target.parent.mkdir(parents=True, exist_ok=True)
    path = target.with_name(f".{target.name}.lock")
    lock = filelock.FileLock(path, mode=0o666, blocking=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except filelock.Timeout:
        raise ValueError(
            f"another run{_holder(path)} is writing {output}; wait for it or stop it"
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
    else:
        with suppress(OSError):  # a full disk
            path.write_text(f" (process {os.getpid()} on {socket.gethostname()})")
    try:
        yield
    finally:
        with suppress(OSError):  # Windows removes no file that is open
            path.unlink()
        lock.release()


def _holder(path: Path) -> str:
    try:
        return path.read_text(errors="replace")[:200]
    except OSError:  # the other run has just ended, or Windows lets nobody read a locked file
        return ""
