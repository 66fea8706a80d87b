# SPDX-License-Identifier: BSD-3-Clause
"""The files of visitors: in a temporary folder each, bounded, and deleted when they go."""

import re
import secrets
import shutil
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path

from epi360.runs.whole_files import scratch_folder
from epi360_demo.limits import Limits, RefusedError, megabytes

SLOTS = ("1", "2", "lens")
LARGEST_LENS_FILE = 2**20
_LONGEST_NAME = 120
_SUFFIX = re.compile(r"\.[A-Za-z0-9]{1,5}")


@dataclass(frozen=True)
class Upload:
    """A file of a visitor under the name that the visitor gave it."""

    path: Path
    name: str
    num_bytes: int


@dataclass
class Visitor:
    """One open page with its files."""

    token: str
    folder: Path
    uploads: dict[str, Upload] = field(default_factory=dict)
    seen: float = field(default_factory=time.monotonic)
    on_change: Callable[[], None] = lambda: None  # an upload came, or went
    on_forgotten: Callable[[], None] = lambda: None

    @property
    def results(self) -> Path:
        """Folder of the report and the JSON of the latest estimate."""
        return self.folder / "results"

    def remove(self, slot: str) -> None:
        """Delete an uploaded file."""
        upload = self.uploads.pop(slot, None)
        if upload is not None:
            upload.path.unlink(missing_ok=True)

    def remove_all(self) -> None:
        """Delete every file of the visitor."""
        self.uploads.clear()
        shutil.rmtree(self.folder, ignore_errors=True)


class Visitors:
    """All open pages, and the one temporary folder that holds what they uploaded."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._visitors: dict[str, Visitor] = {}
        self._num_arriving_bytes = 0
        self.root = scratch_folder()

    def arrive(self) -> Visitor:
        """Return a new visitor; `RefusedError` where there are too many."""
        if len(self._visitors) >= self._limits.max_visitors:
            raise RefusedError(
                f"{len(self._visitors)} pages of this demo are open, as many as it may have; "
                "try again in some minutes."
            )
        token = secrets.token_urlsafe(24)
        visitor = Visitor(token, self.root / token)
        self._visitors[token] = visitor
        return visitor

    def find(self, token: str) -> Visitor:
        """Return the visitor of a token; `RefusedError` where the page is gone."""
        visitor = self._visitors.get(token)
        if visitor is None:
            raise RefusedError("This page is no longer connected to the demo; load it again.")
        visitor.seen = time.monotonic()
        return visitor

    def leave(self, visitor: Visitor) -> None:
        """Delete a visitor with all files; the page hears nothing more."""
        visitor.on_change = visitor.on_forgotten = lambda: None
        self._visitors.pop(visitor.token, None)
        visitor.remove_all()

    def forget_idle(self) -> None:
        """Delete the files of visitors who did nothing for long; their pages stay open."""
        for visitor in self._visitors.values():
            idle = time.monotonic() - visitor.seen
            if idle > self._limits.max_idle_s and visitor.folder.exists():
                visitor.remove_all()
                visitor.on_change()
                visitor.on_forgotten()

    def close(self) -> None:
        """Delete everything."""
        self._visitors.clear()
        shutil.rmtree(self.root, ignore_errors=True)

    async def receive(
        self, visitor: Visitor, slot: str, name: str, chunks: AsyncIterator[bytes]
    ) -> Upload:
        """Store an upload as it arrives, in place of what the slot held.

        Raises
        ------
        RefusedError
            If the slot is unknown, or the file is empty or larger than allowed.
        """
        if slot not in SLOTS:
            raise RefusedError("This demo takes two pictures and the file of a lens.")
        shown = _shown_name(name)
        largest = LARGEST_LENS_FILE if slot == "lens" else self._limits.max_file_bytes
        visitor.remove(slot)
        visitor.folder.mkdir(mode=0o700, exist_ok=True)
        suffix = Path(shown).suffix
        # A name of its own for each upload: of two that arrive at once, the later one counts.
        stem = f"{slot}-{secrets.token_hex(8)}"
        path = visitor.folder / (stem + (suffix if _SUFFIX.fullmatch(suffix) else ""))
        try:
            num_bytes = await self._write(path, shown, largest, chunks)
        except BaseException:  # also where the visitor goes away in the middle
            path.unlink(missing_ok=True)
            raise
        visitor.remove(slot)
        if visitor.token not in self._visitors:
            visitor.remove_all()
            raise RefusedError("This page is no longer connected to the demo; load it again.")
        visitor.uploads[slot] = Upload(path, shown, num_bytes)
        return visitor.uploads[slot]

    async def _write(
        self, path: Path, name: str, largest: int, chunks: AsyncIterator[bytes]
    ) -> int:
        num_bytes = 0
        try:
            with path.open("xb") as file:
                async for chunk in chunks:
                    num_bytes += len(chunk)
                    self._num_arriving_bytes += len(chunk)
                    if num_bytes > largest:
                        raise RefusedError(
                            f"{name} is larger than {megabytes(largest)}, the limit."
                        )
                    if self._num_stored_bytes() > self._limits.max_stored_bytes:
                        raise RefusedError(
                            "The demo holds as many pictures of its visitors as it may; "
                            "try again in some minutes."
                        )
                    file.write(chunk)
        finally:
            self._num_arriving_bytes -= num_bytes
        if not num_bytes:
            raise RefusedError(f"{name} is empty.")
        return num_bytes

    def _num_stored_bytes(self) -> int:
        uploads = (each for visitor in self._visitors.values() for each in visitor.uploads.values())
        return self._num_arriving_bytes + sum(upload.num_bytes for upload in uploads)


def _shown_name(name: str) -> str:
    """Return the last part of a name on one line, not too long, whatever a browser sends."""
    last = re.split(r"[/\\]", name)[-1]
    printable = "".join(letter for letter in last if letter.isprintable()).strip()
    if len(printable) > _LONGEST_NAME:
        printable = printable[: _LONGEST_NAME // 2] + "..." + printable[-_LONGEST_NAME // 2 :]
    return printable or "the file"
