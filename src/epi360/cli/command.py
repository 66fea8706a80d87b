# SPDX-License-Identifier: BSD-3-Clause
"""What the commands share: the application, exit codes, the line that says what is being done."""

from __future__ import annotations

import reprlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import App, Group, Parameter

from epi360.cli.exit_codes import FAILURE as FAILURE
from epi360.cli.exit_codes import SUCCESS as SUCCESS
from epi360.cli.exit_codes import WRONG_USE as WRONG_USE
from epi360.progress import Progress

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

Say = Callable[[str], None]
SECONDS_BETWEEN_LINES = 30.0
Flag = Annotated[bool, Parameter(negative=(), show_default=False)]
# Either name is understood everywhere; the first of them is the one in the documents.
OUTPUT_NAMES, OUT_NAMES = ("--output", "--out"), ("--out", "--output")
# The parts of the list of commands, in the order in which they are looked for.
POSES = Group("Poses", sort_key=1)
FILES = Group("Files", sort_key=2)
TO_TRY = Group("To try", sort_key=3)
REST = Group("Commands", sort_key=4)


def _version() -> str:
    from epi360.extras import package_version

    return package_version()


# Larger numbers are slips, and what they do depends on the machine: threads are started at once.
LARGEST_NUMBER = 2**31 - 1
LARGEST_OF = {"num_threads": 1024, "jobs": 1024, "mapper_threads": 1024, "seed": 2**128}


def check_numbers(arguments: Mapping[str, Any]) -> None:
    """Raise ``ValueError`` for a whole number that no machine can do; options may be in groups."""
    for name, value in arguments.items():
        if is_dataclass(value):
            check_numbers(vars(value))
        elif isinstance(value, int) and not isinstance(value, bool):
            largest = LARGEST_OF.get(name, LARGEST_NUMBER)
            if abs(value) > largest:
                option = f"--{name.replace('_', '-')}"
                raise ValueError(f"{option} must be at most {largest}, got {reprlib.repr(value)}")


app = App(
    name="epi360",
    help="Relative pose of 360° and other wide-angle images.",
    version=_version,
    suppress_keyboard_interrupt=False,
    group_commands=REST,
)


@contextmanager
def show_progress() -> Iterator[Say]:
    """Show what is being done on stderr while that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda message: None
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status("starting") as status:
        yield lambda message: status.update(Text(message))


@contextmanager
def show_bars() -> Iterator[Progress]:
    """Show rate and remaining time on stderr: bars on a terminal, now and then a line elsewhere."""
    if not sys.stderr.isatty():
        yield _LinePerStage()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        yield _BarPerStage(bars)


class _Pace(NamedTuple):
    """How a stage goes: whether it begins or has grown, what was there before, its rate."""

    begins: bool
    grows: bool
    before: int
    per_second: float  # 0 if nothing has been done since


class _Paces:
    """The pace of each stage; one that is done once more begins again."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, int]] = {}
        self._last: dict[str, int] = {}

    def pace(self, stage: str, done: int) -> _Pace:
        now, last = time.monotonic(), self._last.get(stage)
        self._last[stage] = done
        begins = last is None or done < last
        if begins:
            # What an earlier run has left is no measure of the rate: it is there from the start.
            self._begun[stage] = now, done
        since, before = self._begun[stage]
        seconds = now - since  # none, where the clock is coarse
        rate = (done - before) / seconds if seconds > 0 else 0.0
        return _Pace(begins, last is not None and done > last, before, rate)


class _BarPerStage:
    """A `Progress` that shows one bar for each stage."""

    def __init__(self, bars: Bars) -> None:
        self._bars, self._paces = bars, _Paces()
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        pace = self._paces.pace(stage, done)
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total, completed=done, rate="")
        elif pace.begins:
            self._bars.reset(self._tasks[stage], total=total, completed=done)
        rate = f"{pace.per_second:,.1f}/s" if pace.per_second else ""
        self._bars.update(self._tasks[stage], completed=done, total=total, rate=rate)


class _LinePerStage:
    """A `Progress` that prints a line when a stage ends, and every half minute until then."""

    def __init__(self) -> None:
        self._paces = _Paces()
        self._said = time.monotonic()

    def __call__(self, stage: str, done: int, total: int) -> None:
        now, pace = time.monotonic(), self._paces.pace(stage, done)
        ends = pace.grows and done == total
        if not ends and now - self._said < SECONDS_BETWEEN_LINES:
            return
        self._said = now
        print(f"epi360: {_line(stage, done, total, pace)}", file=sys.stderr)


def _line(stage: str, done: int, total: int, pace: _Pace) -> str:
    """How far a stage is, its rate and the time that the rest will take."""
    line = f"{stage}: {done} of {total}"
    if pace.before:
        line += f" ({pace.before} were there)"
    if pace.per_second:
        minutes, rest = divmod(round((total - done) / pace.per_second), 60)
        line += f", {pace.per_second:,.2f}/s"
        line += f", {minutes}:{rest:02d} min left" if done < total else ""
    return line
