# SPDX-License-Identifier: BSD-3-Clause
"""Results of an experiment as files: raw trials, and a page with *paper | ours* tables."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from epi360.runs.whole_files import write_file
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.parts import Trials, csv_bytes

# What a Markdown table shows where the paper has no number.
NO_NUMBER = "–"


@dataclass(frozen=True)
class Compared:
    """A number of the paper beside ours."""

    paper: float | None  # as printed; None where the paper has none
    ours: float  # computed from our trials, never copied


def save_trials(folder: Path, trials: Trials) -> tuple[Path, ...]:
    """Write ``trials.csv``, and ``trials.parquet`` where pyarrow is installed."""
    rows = zip(*(_texts(values) for values in trials.columns.values()), strict=True)
    write_file(folder / "trials.csv", csv_bytes(trials.columns, rows))
    if find_spec("pyarrow") is None:
        return (folder / "trials.csv",)
    table = import_module("pyarrow").table(dict(trials.columns))
    sink = io.BytesIO()
    import_module("pyarrow.parquet").write_table(table, sink)
    write_file(folder / "trials.parquet", sink.getvalue())
    return folder / "trials.csv", folder / "trials.parquet"


def comparison_table(
    title: str,
    columns: Sequence[str],
    rows: Mapping[str, Sequence[Compared]],
    *,
    formats: Sequence[str] | None = None,
) -> str:
    """Markdown table with two columns, *paper* and *ours*, for each quantity."""
    formats = formats or [".3f"] * len(columns)
    heading = [title, *(f"{name}: {who}" for name in columns for who in ("paper", "ours"))]
    body = []
    for name, numbers in rows.items():
        cells = [name]
        for column, number, form in zip(columns, numbers, formats, strict=True):
            if np.isnan(number.ours):
                raise ValueError(f"{column} of {name} is NaN: no trial has given a number")
            paper = NO_NUMBER if number.paper is None else format(number.paper, form)
            cells += [paper, format(number.ours, form)]
        body.append(cells)
    return markdown_table(heading, body)


def markdown_table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown table; all columns but the first are aligned to the right."""
    rule = ["---", *["---:"] * (len(heading) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heading, rule, *rows))


def run_line(
    options: ReproduceOptions, num_trials: int, trials: Trials | None = None, unit: str = "trials"
) -> str:
    """Sentence on how many trials were run, with the processor time that they took."""
    spent = f", {trials.seconds:.0f} s of processor time" if trials is not None else ""
    return (
        f"Protocol `{options.protocol}`, {num_trials:,} {unit} a cell, seed {options.seed}{spent}."
    )


def save_page(folder: Path, title: str, run: str, sections: Sequence[str]) -> tuple[Path, str]:
    """Write ``table.md``: how it was run, then the sections."""
    text = "\n\n".join([f"## {title}", run, *sections]) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    write_file(folder / "table.md", text.encode())
    return folder / "table.md", text


def save_outcome(
    name: str,
    title: str,
    run: str,
    sections: Sequence[str],
    trials: Trials,
    options: ReproduceOptions,
    *,
    tables: Mapping[str, bytes] | None = None,
    figure: bytes | None = None,
) -> Outcome:
    """Write raw trials, further tables (content by file name), the page and the figure."""
    folder = options.folder(name)
    folder.mkdir(parents=True, exist_ok=True)
    files = [*save_trials(folder, trials)]
    for table, content in (tables or {}).items():
        write_file(folder / table, content)
        files.append(folder / table)
    page, text = save_page(folder, title, run, sections)
    files.append(page)
    if figure is not None:
        write_file(folder / "figure.png", figure)
        files.append(folder / "figure.png")
    return Outcome(name, tuple(files), text)


def in_thousandths(errors: ArrayLike, quantile: float = 0.5) -> float:
    """Quantile of errors of eq. 16, shares of half a turn, in 1e-3 as the paper prints them."""
    # A trial without a pose is NaN and counts as the worst error, 1.
    values = np.asarray(errors, dtype=np.float64)
    return float(1e3 * np.quantile(np.where(np.isnan(values), 1.0, values), quantile))


def _texts(values: np.ndarray[Any, Any]) -> list[str]:
    if values.dtype.kind == "f":
        return [f"{value:.9g}" for value in values.tolist()]
    return [str(value) for value in values.tolist()]
