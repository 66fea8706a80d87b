# SPDX-License-Identifier: BSD-3-Clause
"""What a run has left: its pages, and the paper's errors beside ours read back from them."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from epi360_paper import EXPERIMENTS
from epi360_paper.options import ProtocolName

ERRORS, GAINS = "error of eq. 16 (1e-3)", "reduction of the median error (%)"


@dataclass(frozen=True)
class ResultPage:
    """The page that an experiment has written, and its figure."""

    name: str  # of the experiment
    title: str  # names a protocol other than "printed"
    text: str  # Markdown without the title
    figure: Path | None


@dataclass(frozen=True)
class ComparedErrors:
    """Rotation (R) and translation errors (T) of one table, or what one method gains on another."""

    title: str
    axis: str
    rows: tuple[str, ...]
    series: dict[str, tuple[float, ...]]  # "paper R", "ours R", "paper T", "ours T"


def read_page(folder: Path) -> ResultPage:
    """Return the page in a folder of results."""
    text = (folder / "table.md").read_text(encoding="utf-8").strip()
    title, _, rest = text.partition("\n")
    protocol = folder.name.rpartition("-")[2]
    name = folder.name.partition("-")[0]
    titled = title.removeprefix("## ")
    if protocol in get_args(ProtocolName):
        titled += f" ({protocol})"
    figure = folder / "figure.png"
    return ResultPage(name, titled, rest.strip(), figure if figure.is_file() else None)


def read_pages(out: Path) -> list[ResultPage]:
    """Return all pages of a run in the paper's order; ``ValueError`` if there are none."""
    folders = [page.parent for page in out.glob("*/table.md")]
    known = [each for each in folders if each.name.partition("-")[0] in EXPERIMENTS]
    if not known:
        raise ValueError(f"{out} must hold tables, found none; run epi360 reproduce all first")
    known.sort(key=lambda each: (EXPERIMENTS.index(each.name.partition("-")[0]), each.name))
    return [read_page(folder) for folder in known]


def compared_errors(pages: Sequence[ResultPage]) -> list[ComparedErrors]:
    """Return all errors and gains that pages give beside the paper's, one entry a table."""
    return [each for page in pages for each in _of_page(page)]


def _of_page(page: ResultPage) -> Iterator[ComparedErrors]:
    title = page.title.partition(":")[0] + _variant(page.title)
    quartiles: dict[str, dict[str, tuple[float, ...]]] = {}
    heading = ""
    for block in re.split(r"\n\s*\n", page.text):
        if block.startswith("#"):
            heading = block.lstrip("# ").split(":")[0].split(" (paper")[0]
        if not block.startswith("|") or ": paper" not in block:
            continue
        cells = [_cells(line) for line in block.splitlines()]
        names, body = cells[0], cells[2:]
        rows = tuple(row[0] for row in body)
        numbers = {name: tuple(_number(row[k]) for row in body) for k, name in enumerate(names)}
        label = f"{title}, {heading.lower()}" if heading else title
        if names[0].startswith(("Rot-e", "Tran-e")):  # Table 3: a table for R and one for T
            quartiles.setdefault(heading, {})[names[0][:1]] = _median_row(names, body)
            methods = tuple(name.removesuffix(": paper") for name in names[1::2])
            if len(quartiles[heading]) == 2:
                yield _quartile_entry(label, methods, quartiles[heading])
        else:
            yield from _columns(label, rows, numbers)


def _variant(title: str) -> str:
    """Return what tells apart two pages of one experiment, to stand behind its number."""
    where = title.partition(": ")[2].partition(", ")[2]
    protocol = re.search(r" \((\w+)\)$", title)
    if where:
        return f", {where}"
    return f" ({protocol[1]})" if protocol and protocol[1] in get_args(ProtocolName) else ""


def _columns(
    label: str, rows: tuple[str, ...], numbers: dict[str, tuple[float, ...]]
) -> Iterator[ComparedErrors]:
    if "Rot-e, 1e-3: ours" in numbers:
        series = {
            f"{who} {letter}": numbers[f"{word}, 1e-3: {who}"]
            for letter, word in (("R", "Rot-e"), ("T", "Tran-e"))
            for who in ("paper", "ours")
        }
        yield ComparedErrors(label, ERRORS, rows, series)
    for name in numbers:
        pair, found, _ = name.partition(", R: ours")
        if found and " vs " in pair:
            series = {
                f"{who} {letter}": numbers[f"{pair}, {letter}: {who}"]
                for letter in ("R", "T")
                for who in ("paper", "ours")
            }
            yield ComparedErrors(f"{label}: {pair}", GAINS, rows, series)


def _median_row(names: list[str], body: list[list[str]]) -> tuple[float, ...]:
    row = next(row for row in body if row[0] == "Q50")
    return tuple(_number(cell) for cell in row[1:])


def _quartile_entry(
    label: str, methods: tuple[str, ...], medians: dict[str, tuple[float, ...]]
) -> ComparedErrors:
    series = {
        f"{who} {letter}": medians[letter][k::2]
        for letter in ("R", "T")
        for k, who in enumerate(("paper", "ours"))
    }
    return ComparedErrors(f"{label}, medians", ERRORS, methods, series)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
