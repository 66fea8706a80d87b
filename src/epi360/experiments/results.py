# SPDX-License-Identifier: BSD-3-Clause
"""Results of an experiment as files: raw trials, and a page with *paper | ours* tables."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from epi360.experiments.options import ReproduceOptions
from epi360.experiments.parts import TIMING_PREFIX, Trials
from epi360.runs.whole_files import write_file

# What a Markdown table shows where the paper has no number.
NO_NUMBER = "–"


@dataclass(frozen=True)
class Compared:
    """A number of the paper beside ours.

    Attributes
    ----------
    paper : float or None
        As printed; None where the paper has none.
    ours : float
        Computed from our trials, never copied.
    """

    paper: float | None
    ours: float


def save_trials(folder: Path, trials: Trials) -> tuple[Path, ...]:
    """Files of the raw trials: ``trials.csv``, and ``trials.parquet`` where pyarrow is installed.

    Parameters
    ----------
    folder : Path
        Of the experiment; it exists.
    trials : Trials
        Columns that start with ``time_`` are measured times.

    Returns
    -------
    files : tuple of Path
    """
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(trials.columns)
    lines.writerows(zip(*(_texts(values) for values in trials.columns.values()), strict=True))
    write_file(folder / "trials.csv", text.getvalue().encode())
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
    """Markdown table with two columns, *paper* and *ours*, for each quantity.

    Parameters
    ----------
    title : str
        Heading of the first column.
    columns : sequence of str
        Names of the quantities, with their units.
    rows : mapping of str to sequence of Compared
        Numbers of each row by its name, one a quantity.
    formats : sequence of str, optional
        Format specification of each quantity; ``.3f`` by default.

    Returns
    -------
    table : str
        Without a line break at its end.

    Raises
    ------
    ValueError
        If one of our numbers is NaN: a table says what was measured.
    """
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
    """Markdown table; all columns but the first are aligned to the right.

    Parameters
    ----------
    heading : sequence of str
    rows : sequence of sequence of str
        As many cells each as the heading has.

    Returns
    -------
    table : str
        Without a line break at its end.
    """
    rule = ["---", *["---:"] * (len(heading) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heading, rule, *rows))


def save_page(
    folder: Path,
    title: str,
    sections: Sequence[str],
    options: ReproduceOptions,
    *,
    num_trials: int,
    trials: Trials | None = None,
    unit: str = "trials",
) -> tuple[Path, str]:
    """Write ``table.md``: what was run, then the sections.

    Parameters
    ----------
    folder : Path
        Of the experiment.
    title : str
        Heading, such as "Table 4: RANSAC at two thresholds".
    sections : sequence of str
        Tables and paragraphs.
    options : ReproduceOptions
        Of the run.
    num_trials : int
        Trials a cell.
    trials : Trials, optional
        For the computing time.
    unit : str
        What a trial is, in the plural.

    Returns
    -------
    path : Path
        Of the page.
    text : str
        Its content.
    """
    spent = f", {trials.seconds:.0f} s of processor time" if trials is not None else ""
    run = (
        f"Protocol `{options.protocol}`, {num_trials:,} {unit} a cell, seed {options.seed}{spent}."
    )
    text = "\n\n".join([f"## {title}", run, *sections]) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    write_file(folder / "table.md", text.encode())
    return folder / "table.md", text


def in_thousandths(errors: ArrayLike, quantile: float = 0.5) -> float:
    """Quantile of errors in the paper's unit: eq. 16 is a share of half a turn, printed in 1e-3.

    Parameters
    ----------
    errors : array_like
        Errors of eq. 16 (angle / pi); NaN is a trial without a pose and counts as the worst
        error, 1.
    quantile : float
        In [0, 1]; the median by default.

    Returns
    -------
    value : float
    """
    values = np.asarray(errors, dtype=np.float64)
    return float(1e3 * np.quantile(np.where(np.isnan(values), 1.0, values), quantile))


def is_timing(column: str) -> bool:
    """Whether a column holds measured times, which change from run to run.

    Parameters
    ----------
    column : str
        Name of the column.

    Returns
    -------
    is_timing : bool
    """
    return column.startswith(TIMING_PREFIX)


def _texts(values: np.ndarray[Any, Any]) -> list[str]:
    if values.dtype.kind == "f":
        return [f"{value:.9g}" for value in values.tolist()]
    return [str(value) for value in values.tolist()]
