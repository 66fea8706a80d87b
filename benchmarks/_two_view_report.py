# SPDX-License-Identifier: BSD-3-Clause
"""Report of the two-view benchmark: Markdown and one picture from the raw rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from _machine import fact_lines
from _summary import markdown_table, text_table
from _two_view_methods import FAST_PEER, METHODS, REMARKS
from _two_view_plots import write_overview
from _two_view_problems import GATE_PER_SIGMA, Cell
from _two_view_records import Row
from _two_view_run import SLOW_METHODS, SLOW_PROBLEMS, SLOW_SECONDS
from _two_view_summary import (
    FAILURE_DEG,
    GROSS_DEG,
    Summary,
    aims_table,
    cell_table,
    noise_text,
    summarise,
    verdict_table,
)

from epi360.runs.whole_files import write_file

NOTES = f"""\
- **Noise** is von Mises-Fisher, in view 2 only as in the paper (`-both`: in both views). Its number
  is the standard deviation per tangent axis in degrees; the mean angle, {1.2533:g} times it, stands
  behind. `k500` is kappa = 500: 2.56 per axis, a mean angle of 3.21.
- **Gate** of every method that is given one: {GATE_PER_SIGMA:g} sigma, turned to its own unit.
- **Outliers** are exactly the share in the name: view 2 looks anywhere in its field of view.
- **Scenes**: `room` (walls of a room around both cameras, t uniform in [-1, 1]^3 m, Euler angles
  within 45 deg), `uniform` (directions over the sphere, 1 to 10 m), `cone` (half angle 30 deg),
  `near` (the room with a baseline of 0.2 m), `rotation` (none), `plane` (one plane), `patch` (only
  matches within 12 deg of one direction agree, the others are random everywhere: nobody should
  accept that without a word), `uniform-...-100` (random matches). `-fisheye180`: only what both
  lenses of that field of view see.
- **AUC@x** is the area under the share of problems whose larger error is below e, e from 0 to x
  degrees, over x. R and t are degrees. `none` is a method without a pose.
- **t / oracle** is the median direction error over the oracle's on the same problems.
- **> 5 deg**: larger error above {FAILURE_DEG:g} degrees, or no pose. **Wrong accepted**: the
  method stands behind a pose more than {GROSS_DEG:g} degrees off; behind any direction after a pure
  rotation, any pose of random matches, and a patch without a warning.
- **Calibration** is the mean normalised squared error over 5 of accepted poses up to {GROSS_DEG:g}
  degrees: 1 is right, more is overconfident.
- **ms** is the median wall time of the call, one thread, methods in turn on each problem; times
  faster is against `{FAST_PEER}` on the same problems. CPU time is the fairer one where other
  programs share the machine.
- A method with a median over {SLOW_SECONDS:g} s a pair gets {SLOW_PROBLEMS} problems of a cell, and
  {", ".join(SLOW_METHODS)} five cells only.
- The paper's pipeline answers with a pose always; so do the peers without a verdict."""


def write_report(
    out: Path,
    cells: Sequence[Cell],
    rows: Iterable[Row],
    facts: dict[str, Any],
    picture: Path | None = None,
) -> None:
    """Write ``report.md`` and ``overview.png``, and print the table of the aims."""
    rows = list(rows)
    summaries = {cell.name: summarise(cell, rows) for cell in cells}
    everything = [item for items in summaries.values() for item in items]
    aims, verdicts = aims_table(everything), verdict_table(everything)
    for path in filter(None, (out / "overview.png", picture)):
        write_overview(path, everything, facts)
    blocks = [
        "# Two-view benchmark",
        "\n".join(f"- {line}" for line in fact_lines(facts)),
        "![Error over the oracle's, failures and time of every method](overview.png)",
        "## How to read it",
        NOTES,
        "## Methods",
        "\n".join(f"- **{name}**: {REMARKS[name]}." for name in METHODS),
        "## The project's aims, `epi360 auto`",
        markdown_table(aims),
        "## The verdict",
        markdown_table(verdicts),
        "## Every cell",
        *(block for items in summaries.values() if items for block in _cell_blocks(items)),
    ]
    write_file(out / "report.md", ("\n\n".join(blocks) + "\n").encode())
    print(f"\n{text_table(aims)}\n\n{text_table(verdicts)}", flush=True)
    print(f"\nreport.md, overview.png and raw.csv are in {out}", flush=True)


def _cell_blocks(summaries: Sequence[Summary]) -> list[str]:
    cell = summaries[0].cell
    heading = f"### {cell.name}"
    facts = f"Noise {noise_text(cell)} degrees, gate {cell.gate_deg:.3g} degrees."
    return [heading, facts, markdown_table(cell_table(summaries))]
