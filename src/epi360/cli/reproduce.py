# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 reproduce``: the figures and tables of the paper, made again."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclopts import Parameter

from epi360.cli.command import FAILURE, SUCCESS, app, show_bars

if TYPE_CHECKING:
    from epi360_paper.options import Outcome, ReproduceOptions

Name = Literal[
    "fig1", "fig2", "fig3", "fig4a", "fig4b", "fig4c",
    "table1", "table2", "table3", "table4", "all", "report",
]  # fmt: skip


@Parameter(name="*", negative=())
@dataclass(frozen=True)
class ReproduceChoice:
    """Words of the command; they become the `ReproduceOptions` of the experiments."""

    protocol: Literal["printed", "authors", "corrected"] = "printed"
    """Follow the paper's text, the authors' code, or what is right."""
    trials: int | None = None
    """Trials a cell; by default the paper's count."""
    seed: int = 0
    """Seed of all random numbers."""
    jobs: int | None = None
    """Worker processes, by default one a core; the numbers do not depend on it."""
    out: Path = Path("out/reproduce")
    """Folder of the results; an experiment writes into its own folder in it."""
    landmarks: bool = False
    """Tables 1 and 2 on synthetic landmarks instead of tracks in rendered images."""
    mp3d_vo: Path | None = None
    """Folder of the data set 360-MP3D-VO, for Table 3."""
    tum_vi: Path | None = None
    """Folder of the data set TUM-VI, for Table 3."""
    image_width: int = 1024
    """Width of rendered panoramas in pixels."""


DEFAULTS = ReproduceChoice()


@app.command
def reproduce(
    name: Name, /, *, choice: ReproduceChoice = DEFAULTS, into: Path | None = None
) -> int:
    """Make a figure or a table of Robust 360-8PA (2021) again: paper's number | ours.

    Writes raw trials (CSV, Parquet where pyarrow is installed), the table as Markdown and the
    figure as PNG into a folder of its own. Interrupted, it keeps what is finished and goes on from
    there. Exit code 1 where one of "all" failed.

    Parameters
    ----------
    name
        Figure or table; "all" makes one after the other; "report" collects the tables that are
        there.
    into
        With "report": the document whose part between the marks is replaced, instead of printing.
    """
    # Read by NumPy's libraries when they load: one worker process is one thread.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if into is not None and name != "report":
        raise ValueError("--into needs the name report: it says where the collected tables go")
    from epi360_paper import EXPERIMENTS
    from epi360_paper.options import ReproduceOptions

    options = ReproduceOptions(**asdict(choice))
    if name == "report":
        return _report(options.out, into)
    options.out.mkdir(parents=True, exist_ok=True)
    if name == "all":
        codes = [_attempt(each, options) for each in EXPERIMENTS]
        return max(codes)
    try:
        _show(_run(name, options))
    except ChildProcessError as error:
        return _failed(name, error)
    return SUCCESS


def _attempt(name: str, options: ReproduceOptions) -> int:
    try:
        _show(_run(name, options))
    except Exception as error:
        return _failed(name, error)
    return SUCCESS


def _failed(name: str, error: Exception) -> int:
    words = " ".join(str(error).split()) or type(error).__name__
    print(f"epi360: {name} failed: {words}", file=sys.stderr)
    return FAILURE


def _run(name: str, options: ReproduceOptions) -> Outcome:
    from epi360_paper import load_experiment

    with show_bars() as progress:
        return load_experiment(name)(options, progress)


def _show(outcome: Outcome) -> None:
    if outcome.summary:
        print(outcome.summary)
    for path in outcome.files:
        print(f"wrote {path}")
    sys.stdout.flush()


def _report(out: Path, into: Path | None) -> int:
    from epi360_paper.report import collect_tables, insert_tables

    tables = collect_tables(out)
    if into is None:
        print(tables)
    else:
        insert_tables(into, tables)
        print(f"wrote {into}")
    return SUCCESS
