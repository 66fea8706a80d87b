# SPDX-License-Identifier: BSD-3-Clause
"""What the commands share: the application, exit codes, the line that says what is being done."""

from __future__ import annotations

import reprlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Annotated, Any

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


@contextmanager
def options_as_typed() -> Iterator[None]:
    """Errors that begin with the name of a parameter begin with that of the option."""
    try:
        yield
    except ValueError as error:
        name, must, rest = str(error).partition(" must ")
        if not (must and name.isidentifier()):
            raise
        raise ValueError(f"--{name.replace('_', '-')} must {rest}") from None


class _BarPerStage:
    """A `Progress` that shows one bar for each stage."""

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._begun: dict[str, tuple[TaskID, float, int]] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if stage not in self._begun:
            # What an earlier run has left is no measure of the rate: it is there from the start.
            task = self._bars.add_task(stage, total=total, completed=done, rate="")
            self._begun[stage] = task, now, done
        task, since, before = self._begun[stage]
        rate = f"{(done - before) / (now - since):,.1f}/s" if done > before else ""
        self._bars.update(task, completed=done, total=total, rate=rate)


class _LinePerStage:
    """A `Progress` that prints a line when a stage ends, and every half minute until then."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, int]] = {}
        self._last: dict[str, int] = {}
        self._said = time.monotonic()

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        last, self._last[stage] = self._last.get(stage, done), done
        if done < last:  # it is done once more
            del self._begun[stage]
        since, before = self._begun.setdefault(stage, (now, done))
        ends = before < done == total and last < done
        if not ends and now - self._said < SECONDS_BETWEEN_LINES:
            return
        self._said = now
        print(f"epi360: {_line(stage, done, total, before, now - since)}", file=sys.stderr)


def _line(stage: str, done: int, total: int, before: int, seconds: float) -> str:
    """How far a stage is, its rate and the time that the rest will take."""
    line = f"{stage}: {done} of {total}"
    if before:
        line += f" ({before} were there)"
    if done > before and seconds > 0:
        rate = (done - before) / seconds
        minutes, rest = divmod(round((total - done) / rate), 60)
        line += f", {rate:,.2f}/s" + (f", {minutes}:{rest:02d} min left" if done < total else "")
    return line
