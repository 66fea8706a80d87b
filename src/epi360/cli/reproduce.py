# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 reproduce``: the figures and tables of the paper, made again."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from epi360.cli.command import FAILURE, OUT_NAMES, SUCCESS, TO_TRY, app, show_bars
from epi360.cli.report_option import check_report

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
    out: Annotated[Path, Parameter(name=OUT_NAMES)] = Path("out/reproduce")
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
_NOTE = (
    "R: rotation, T: direction of the translation; errors are medians. The scenes are not those of "
    "the paper: compare the order of the methods."
)


@app.command(group=TO_TRY, sort_key=3)
def reproduce(
    name: Name,
    /,
    *,
    choice: ReproduceChoice = DEFAULTS,
    into: Path | None = None,
    report: Path | None = None,
    picture: Path | None = None,
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
    report
        Write figures and tables with their captions as a page that a browser opens offline; .html.
    picture
        Write one picture of all errors that the paper prints beside ours; .png, .svg or .pdf.
    """
    # Read by NumPy's libraries when they load: one worker process is one thread.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if into is not None and name != "report":
        raise ValueError("--into needs the name report: it says where the collected tables go")
    _check_outputs(report, picture)
    from epi360_paper import EXPERIMENTS
    from epi360_paper.options import ReproduceOptions

    options = ReproduceOptions(**asdict(choice))
    if name == "report":
        code, folders = _report(options.out, into), None
    else:
        options.out.mkdir(parents=True, exist_ok=True)
        codes, folders = [], []
        for each in EXPERIMENTS if name == "all" else (name,):
            try:
                outcome = _run(each, options)
            except Exception as error:
                if name != "all" and not isinstance(error, ChildProcessError):
                    raise
                codes.append(_failed(each, error))
            else:
                _show(outcome)
                codes.append(SUCCESS)
                folders.append(options.folder(outcome.name))
        code = max(codes)
    if (report is not None or picture is not None) and folders != []:
        _write_pictures(options.out, folders, report, picture)
    return code


def _check_outputs(report: Path | None, picture: Path | None) -> None:
    from epi360.report.files import check_figure_name, check_writable

    if report is not None:
        check_report(report)
    if picture is not None:
        check_figure_name(picture, name="--picture")
        check_writable(picture, name="--picture")


def _write_pictures(
    out: Path, folders: list[Path] | None, report: Path | None, picture: Path | None
) -> None:
    """Write page and picture of the results in these folders, or of all there are."""
    from epi360.report.overview import Overview, Panel, overview_bytes, write_overview
    from epi360.report.reproduction_page import ExperimentShown, write_reproduction_report
    from epi360_paper.captions import CAPTIONS
    from epi360_paper.compared import GAINS, compared_errors, read_page, read_pages

    pages = read_pages(out) if folders is None else [read_page(folder) for folder in folders]
    panels = [
        Panel(each.title, each.axis, each.rows, each.series, powers=each.axis != GAINS)
        for each in compared_errors(pages)
    ]
    rings = frozenset(("paper R", "paper T"))
    overview = Overview("Robust 360-8PA: the paper's errors and ours", panels, _NOTE, rings)
    if picture is not None:
        if not panels:
            raise ValueError("--picture: there is no number of the paper in these results")
        write_overview(picture, overview)
        print(f"wrote {picture}")
    if report is None:
        return
    shown = [
        ExperimentShown(
            page.name,
            page.title,
            CAPTIONS[page.name].shows,
            CAPTIONS[page.name].verdict,
            page.text,
            page.figure.read_bytes() if page.figure else None,
            CAPTIONS[page.name].is_diagram,
        )
        for page in pages
    ]
    first = overview_bytes(overview, "png") if len(panels) > 1 else None
    write_reproduction_report(report, "Robust 360-8PA, made again", shown, first)
    print(f"wrote {report}", flush=True)


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
