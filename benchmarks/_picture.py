# SPDX-License-Identifier: BSD-3-Clause
"""The option ``--picture`` of the benchmarks: one overview picture, drawn in one way for all."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from epi360.report.files import check_figure_name, check_writable
from epi360.report.overview import Overview, Panel, write_overview

Entry = tuple[str, str, float]
"""Row, series and value of one dot."""


def add_picture_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--picture`` to the options."""
    parser.add_argument("--picture", type=Path, help="file for an overview: .png, .svg, .pdf")


def check_picture(path: Path | None) -> None:
    """Raise ``ValueError`` before the work where the picture could not be written."""
    if path is not None:
        check_figure_name(path, name="--picture")
        check_writable(path, name="--picture")


def panel_of(
    title: str,
    axis: str,
    entries: Iterable[Entry],
    *,
    powers: bool = False,
    aim: float | None = None,
) -> Panel:
    """Panel of dots, rows and series in the order in which they come."""
    values = {(row, series): value for row, series, value in entries}
    rows = list(dict.fromkeys(row for row, _ in values))
    names = dict.fromkeys(series for _, series in values)
    series = {name: [float(values.get((row, name), math.nan)) for row in rows] for name in names}
    return Panel(title, axis, rows, series, powers=powers, aim=aim)


def write_picture(
    path: Path | None,
    title: str,
    panels: Sequence[Panel],
    facts: Mapping[str, Any],
    *,
    hollow: Iterable[str] = (),
    columns: int = 3,
    remark: str = "",
) -> None:
    """Write the picture if one was asked for; its last line names commit, machine and load."""
    if path is None:
        return
    load = ", ".join(map(str, facts.get("load_average_at_end", facts.get("load_average", []))))
    note = f"{remark} Commit {facts['commit']}; {facts['cores']} cores of {facts['cpu']}"
    note += f"; load average {load}." if load else "."
    shown = [panel for panel in panels if _has_dots(panel)]
    write_overview(path, Overview(title, shown, note.strip(), frozenset(hollow), columns))
    print(f"wrote {path}", flush=True)


def _has_dots(panel: Panel) -> bool:
    return any(math.isfinite(value) for values in panel.series.values() for value in values)
