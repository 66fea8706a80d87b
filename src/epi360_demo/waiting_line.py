# SPDX-License-Identifier: BSD-3-Clause
"""A line of bounded length before a bounded number of workers."""

import asyncio
import traceback
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from epi360_demo.limits import Limits, RefusedError

State = Literal["waiting", "running", "done", "failed", "left"]
Record = dict[str, Any]


class Worker(Protocol):
    """What does one request at a time; `epi360_demo.worker_process` is the real one."""

    def run(self, request: Record, on_progress: Callable[[str], None]) -> Awaitable[Record]:
        """Do a request; `RefusedError` where it cannot be done."""
        ...

    def kill(self) -> None:
        """End the work at once; the next request starts anew."""
        ...

    async def close(self) -> None:
        """End the work for good."""
        ...


@dataclass(eq=False)
class Ticket:
    """A place in the line, and what became of it."""

    request: Record
    on_change: Callable[["Ticket"], None]
    state: State = "waiting"
    position: int = 0  # 1 is next
    progress: str = ""
    answer: Record | None = None
    sentence: str = ""  # why it failed
    job: asyncio.Task[Record] | None = None


class WaitingLine:
    """First come, first served; who comes to a full line is told so."""

    def __init__(self, limits: Limits, make_worker: Callable[[], Worker]) -> None:
        self._limits = limits
        self._waiting: list[Ticket] = []
        self._someone = asyncio.Event()
        self._workers = [make_worker() for _ in range(limits.num_workers)]
        self._servers = [asyncio.create_task(self._serve(worker)) for worker in self._workers]

    def join(self, request: Record, on_change: Callable[[Ticket], None]) -> Ticket:
        """Return a place at the end; `RefusedError` where the line is full."""
        if len(self._waiting) >= self._limits.max_waiting:
            count = len(self._waiting)
            raise RefusedError(f"The waiting line is full ({count}); try again in some minutes.")
        ticket = Ticket(request, on_change)
        self._waiting.append(ticket)
        self._number()
        self._someone.set()
        return ticket

    def leave(self, ticket: Ticket) -> None:
        """Give up a place; an estimate that runs is ended."""
        if ticket.state == "waiting":
            self._waiting.remove(ticket)
            ticket.state = "left"
            self._number()
        elif ticket.state == "running" and ticket.job is not None:
            ticket.state = "left"
            ticket.job.cancel()

    async def close(self) -> None:
        """End all workers."""
        for task in self._servers:
            task.cancel()
        await asyncio.gather(*self._servers, return_exceptions=True)
        await asyncio.gather(*(worker.close() for worker in self._workers))

    def _number(self) -> None:
        for place, ticket in enumerate(self._waiting, start=1):
            if ticket.position != place:
                ticket.position = place
                _tell(ticket)

    async def _serve(self, worker: Worker) -> None:
        while True:
            while not self._waiting:
                self._someone.clear()
                await self._someone.wait()
            ticket = self._waiting.pop(0)
            self._number()
            await self._run(worker, ticket)

    async def _run(self, worker: Worker, ticket: Ticket) -> None:
        def on_progress(words: str) -> None:
            ticket.progress = words
            _tell(ticket)

        ticket.state = "running"
        _tell(ticket)
        ticket.job = asyncio.ensure_future(worker.run(ticket.request, on_progress))
        try:
            done, _ = await asyncio.wait([ticket.job], timeout=self._limits.time_limit_s)
        except asyncio.CancelledError:  # the demo ends
            ticket.job.cancel()
            worker.kill()
            raise
        if not done or ticket.job.cancelled():
            ticket.job.cancel()
            worker.kill()
        self._settle(ticket, in_time=bool(done))

    def _settle(self, ticket: Ticket, in_time: bool) -> None:
        assert ticket.job is not None
        if ticket.state == "left":
            return
        if not in_time:
            limit = f"{self._limits.time_limit_s:g} seconds"
            ticket.sentence = f"This took longer than {limit}, the limit; try smaller pictures."
        elif error := ticket.job.exception():
            ticket.sentence = str(error) if isinstance(error, RefusedError) else _surprise(error)
        else:
            ticket.answer = ticket.job.result()
        ticket.state = "failed" if ticket.answer is None else "done"
        _tell(ticket)


def _tell(ticket: Ticket) -> None:
    """Let a page hear of its ticket; a mistake in it must not stop the line."""
    try:
        ticket.on_change(ticket)
    except Exception:
        traceback.print_exc()


def _surprise(error: BaseException) -> str:
    return f"Something went wrong in the demo itself ({type(error).__name__})."
