# SPDX-License-Identifier: BSD-3-Clause
"""Hashes of files, remembered while the files stay as they are."""

import json
import time
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path

from epi360.runs.input_files import read_file
from epi360.runs.made_from import read_record
from epi360.runs.remote_path import AnyPath
from epi360.runs.whole_files import write_file

# A file that changed so shortly before it was read may change again within the same tick of its
# file system's clock: FAT counts in two seconds.
_SETTLED_NS = 3 * 10**9
Entry = tuple[list[int], str]


class FileDigests:
    """Hashes of the contents of files, which ``memory``, a JSON file, keeps for later runs.

    A file counts as unchanged while its size, its time of change and its inode's time of change,
    which nobody can set, are the same.
    """

    def __init__(self, memory: AnyPath | None = None) -> None:
        self._memory = memory
        self._known: dict[str, Entry] = {}
        self._read: dict[str, Entry] = {}
        with suppress(ValueError, TypeError):
            found = memory and read_record(memory, remedy="it is made again")
            self._known = {
                path: (was, bytes.fromhex(digest).hex())
                for path, (was, digest) in (found or {}).items()
            }

    def digest_of(self, path: Path) -> bytes:
        """Hash of the content of a file."""
        status = path.stat()
        now = [status.st_size, status.st_mtime_ns, status.st_ctime_ns]
        name = str(path.absolute())
        was, digest = self._read.get(name) or self._known.get(name) or ([], "")
        if was != now:
            digest = blake2b(read_file(path)).hexdigest()
        if time.time_ns() - max(now[1:]) > _SETTLED_NS:
            self._read[name] = now, digest
        return bytes.fromhex(digest)

    def save(self) -> None:
        """Keep what this run has read."""
        if self._memory is not None and self._read != self._known:
            write_file(self._memory, json.dumps(self._read, sort_keys=True).encode())
