# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 batch``: the matches of many pairs to their relative poses."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from epi360.cli.command import FAILURE, OUTPUT_NAMES, POSES, SUCCESS, app, show_bars
from epi360.cli.engine_options import LOCAL_ENGINE, EngineOptions
from epi360.cli.report_option import check_report

if TYPE_CHECKING:
    from epi360.jobs.batch import BatchSummary, MatchSource


@Parameter(name="*", group=Group("Input", sort_key=1))
@dataclass(frozen=True)
class BatchInput:
    """What belongs to the matches."""

    camera: str | None = None
    """Calibration file, for pixels: one camera for all images, or one a folder, called like it;
    FILE:NAME where it holds several and all images are of one."""
    features: str | None = None
    """With hloc's matches: the file of the key points."""
    pairs: str | None = None
    """With hloc's matches: a text file of the pairs that are wanted, two names a line."""


@Parameter(name="*", group=Group("Work", sort_key=2))
@dataclass(frozen=True)
class BatchOptions:
    """How the work is done."""

    num_threads: Annotated[int | None, Parameter(name=("--num-threads", "--threads"))] = None
    """Threads of the local engine; one per core by default. --threads is the older name."""
    seed: int = 0
    """Random seed; a pair's own seed is a hash of it and of the images' names."""
    upright: float | None = None
    """The cameras stand upright to so many degrees (one sigma; 1 is usual): their images are
    panoramas, or the bearings have the y axis down."""
    pairs_per_part: int = 1000
    """The most pairs that are held in memory and written at once."""


NO_MORE_INPUT, DEFAULT_OPTIONS = BatchInput(), BatchOptions()


@app.command(group=POSES, sort_key=6)
def batch(
    source: Annotated[str, Parameter(name="INPUT")],
    /,
    *,
    output: Annotated[str, Parameter(name=OUTPUT_NAMES)],
    write_database: str | None = None,
    given: BatchInput = NO_MORE_INPUT,
    options: BatchOptions = DEFAULT_OPTIONS,
    engine: EngineOptions = LOCAL_ENGINE,
    report: Path | None = None,
) -> int:
    """Relative poses of many pairs of images, from their matches.

    Each pair is judged by its matches alone; poses that a database holds are not read. First all
    rows are checked. Finished parts are kept in OUTPUT.parts until all are there: a run that was
    stopped goes on from there. Exit code 0 when the output is written, 1 if not one of its pairs is
    ok, 2 for wrong use.

    Parameters
    ----------
    source
        Parquet (columns image1, image2, bearings1, bearings2, or pixels1, pixels2), a COLMAP
        database, or hloc's matches. Parquet may be a URL of an object store.
    output
        Parquet file of the poses, one row a pair; may be a URL.
    write_database
        Write a copy of the COLMAP database with the two-view geometries.
    report
        Write a page that a browser opens offline: how many pairs are ok, how certain they are, and
        a table that sorts and filters; .html.

    Returns
    -------
    code
        Exit code.
    """
    from epi360.jobs.batch import BatchJob, run_batch

    if report is not None:
        check_report(report)
    engine.check(options.num_threads)
    job = BatchJob(
        _source(source, given, options), output, seed=options.seed, upright_deg=options.upright
    )
    with show_bars() as progress:
        summary = run_batch(
            job,
            engine=engine.engine,
            num_threads=options.num_threads,
            address=engine.address,
            database=write_database,
            progress=progress,
        )
    _print_summary(summary, output)
    if report is not None:
        from epi360.report.batch_page import write_batch_report

        write_batch_report(report, output)
        print(f"wrote {report}", flush=True)
    return SUCCESS if summary.statuses.get("ok") else FAILURE


def _source(path: str, given: BatchInput, options: BatchOptions) -> MatchSource:
    from epi360.jobs.batch.sources import MatchSource, kind_of

    kind = kind_of(path)
    if kind != "hloc" and (given.features or given.pairs):
        raise ValueError(f"--features and --pairs go with hloc's matches, {path} is {kind}")
    return MatchSource(
        kind,
        path,
        given.camera,
        given.features,
        given.pairs,
        options.pairs_per_part,
        upright=options.upright is not None,
    )


def _print_summary(summary: BatchSummary, output: str) -> None:
    line = f"{summary.num_pairs} pairs"
    before = summary.num_pairs - summary.num_estimated
    if before:
        line += f", {before} were there already"
    if summary.num_estimated:
        line += f"; {summary.num_estimated / summary.seconds:,.1f} pairs/s"
    print(line)
    for status, count in summary.statuses.items():
        print(f"  {status}: {count}")
    for path in summary.files:
        print(f"wrote {path}")
    for path in summary.left:
        print(f"{path} is {'complete' if path == output else 'there already'}, it is left as it is")
    sys.stdout.flush()
