# SPDX-License-Identifier: BSD-3-Clause
"""Measurements of single pairs to tables: per pair, per set, as text, Markdown and JSON values."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from _data import PairSet, Requirement

GROSS_ERROR_DEG = 10.0  # an accepted pose further off than this is a lie, not an inaccuracy

Rows = list[list[str]]


@dataclass(frozen=True)
class PairRun:
    """One method on one pair with one seed."""

    set: str
    pair: str
    kind: str
    reference: str
    method: str
    seed: int
    rotation_error_deg: float
    translation_error_deg: float
    num_inliers: int
    num_matches: int
    seconds: float
    cpu_seconds: float  # of all threads of the process: other work on the machine counts less
    status: str
    accepted: bool
    rotation_sigma_deg: float
    translation_sigma_deg: float

    def is_within(self, requirement: Requirement) -> bool:
        """Whether the pose is accepted and both errors are within the bounds."""
        direction_is_free = math.isinf(requirement.translation_deg)
        return (
            self.accepted
            and self.rotation_error_deg <= requirement.rotation_deg
            and (direction_is_free or self.translation_error_deg <= requirement.translation_deg)
        )

    @property
    def is_grossly_wrong(self) -> bool:
        """Whether the pose is accepted and more than 10 degrees off."""
        worst = max(self.rotation_error_deg, self.translation_error_deg)
        return self.accepted and worst > GROSS_ERROR_DEG

    def cells(self) -> list[str]:
        """Errors, inliers, seconds and status for a table."""
        return [
            f"{self.rotation_error_deg:.3f}",
            f"{self.translation_error_deg:.3f}",
            f"{self.num_inliers}/{self.num_matches}",
            f"{self.seconds:.3f}",
            self.status,
        ]

    def record(self) -> dict[str, Any]:
        """Values for JSON; NaN is None."""
        return {
            key: None if isinstance(value, float) and math.isnan(value) else value
            for key, value in dataclasses.asdict(self).items()
        }


def summarise(pair_set: PairSet, runs: Sequence[PairRun], method: str) -> dict[str, Any]:
    """Figures of one method on one set.

    Parameters
    ----------
    pair_set : PairSet
        What was run, and what is asked of it.
    runs : sequence of PairRun
        Of any set and method.
    method : str
        Name of the method.

    Returns
    -------
    summary : dict
        Counts per seed; medians and quartiles over all pairs and seeds, errors in degrees.
    """
    own = [run for run in runs if run.set == pair_set.name and run.method == method]
    return {
        "set": pair_set.name,
        "method": method,
        "requirements": _requirement_records(pair_set, own),
        "num_accepted": _per_seed(own, [run.accepted for run in own]),
        "num_grossly_wrong": _per_seed(own, [run.is_grossly_wrong for run in own]),
        "rotation_error_deg": _quartiles([run.rotation_error_deg for run in own]),
        "translation_error_deg": _quartiles([run.translation_error_deg for run in own]),
        "rotation_error_over_sigma": _quartiles(
            [run.rotation_error_deg / run.rotation_sigma_deg for run in own if run.accepted]
        ),
        "translation_error_over_sigma": _quartiles(
            [run.translation_error_deg / run.translation_sigma_deg for run in own if run.accepted]
        ),
        "seconds": _quartiles([run.seconds for run in own]),
        "cpu_seconds": _quartiles([run.cpu_seconds for run in own]),
    }


def _requirement_records(pair_set: PairSet, runs: Sequence[PairRun]) -> list[dict[str, Any]]:
    """One record for each requirement that concerns at least one of the pairs."""
    records = [_requirement_record(pair_set, item, runs) for item in pair_set.requirements]
    return [record for record in records if record["num_pairs"]]


def _requirement_record(
    pair_set: PairSet, requirement: Requirement, runs: Sequence[PairRun]
) -> dict[str, Any]:
    concerned = [run for run in runs if requirement.kind in ("", run.kind)]
    ids = {run.pair for run in concerned}
    failing = {run.pair for run in concerned if not run.is_within(requirement)}
    within = _per_seed(concerned, [run.is_within(requirement) for run in concerned])
    is_whole = len(pair_set.pairs) == pair_set.num_available
    needed = len(ids) - requirement.allowed_failures if is_whole else None
    return {
        "bounds": str(requirement),
        "num_pairs": len(ids),
        "num_needed": needed,
        "num_within": within,
        "is_met": None if needed is None else bool(within) and min(within) >= needed,
        "failing_pairs": sorted(failing),
    }


def _per_seed(runs: Sequence[PairRun], flags: Sequence[bool]) -> list[int]:
    """Count the raised flags of each seed."""
    seeds = sorted({run.seed for run in runs})
    return [
        sum(flag for run, flag in zip(runs, flags, strict=True) if run.seed == seed)
        for seed in seeds
    ]


def _quartiles(values: Sequence[float]) -> list[float | None]:
    """Lower quartile, median and upper quartile of the values that are not NaN."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return [None, None, None]
    return [float(value) for value in np.percentile(known, [25, 50, 75])]


def summary_rows(summaries: Sequence[dict[str, Any]]) -> Rows:
    """Table, header first, with one row for each requirement and method."""
    header = ["set", "asked deg", "method", "within", "needed", "met", "median R", "median t"]
    rows = [[*header, "R, t / sigma", ">10 deg", "s (quartiles)", "CPU s"]]
    for summary in summaries:
        for index, item in enumerate(summary["requirements"]):
            verdict = {True: "yes", False: "NO", None: "-"}[item["is_met"]]
            rows.append(
                [
                    summary["set"],
                    item["bounds"],
                    summary["method"],
                    f"{_range(item['num_within'])} of {item['num_pairs']}",
                    "-" if item["num_needed"] is None else str(item["num_needed"]),
                    verdict,
                    *(_figures(summary) if index == 0 else [""] * 6),
                ]
            )
    return rows


def _figures(summary: dict[str, Any]) -> list[str]:
    low, middle, high = (_number(value) for value in summary["seconds"])
    return [
        _number(summary["rotation_error_deg"][1]),
        _number(summary["translation_error_deg"][1]),
        ", ".join(
            _number(summary[f"{part}_error_over_sigma"][1]) for part in ("rotation", "translation")
        ),
        _range(summary["num_grossly_wrong"]),
        f"{middle} ({low}-{high})",
        _number(summary["cpu_seconds"][1]),
    ]


def speed_rows(summaries: Sequence[dict[str, Any]], ours: str, peer: str) -> Rows:
    """Table, header first, of the median seconds of two methods and their ratios."""
    rows = [["set", f"{ours} s", f"{peer} s", "times faster", "in CPU time"]]
    by_method = {(item["set"], item["method"]): item for item in summaries}
    for name in dict.fromkeys(item["set"] for item in summaries):
        pair = [by_method.get((name, method)) for method in (ours, peer)]
        wall = [None if item is None else item["seconds"][1] for item in pair]
        cpu = [None if item is None else item["cpu_seconds"][1] for item in pair]
        rows.append([name, *(_number(value) for value in wall), _ratio(*wall), _ratio(*cpu)])
    return rows


def pair_rows(runs: Sequence[PairRun]) -> Rows:
    """Table, header first, with one row for each run."""
    header = ["set", "pair", "method", "seed", "R deg", "t deg", "inliers", "s", "status"]
    return [header, *([r.set, r.pair, r.method, str(r.seed), *r.cells()] for r in runs)]


def _ratio(ours: float | None, peer: float | None) -> str:
    return "-" if ours is None or peer is None or ours == 0 else f"{peer / ours:.2f}"


def _range(counts: Sequence[int]) -> str:
    if not counts:
        return "-"
    low, high = min(counts), max(counts)
    return str(low) if low == high else f"{low}-{high}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def text_table(rows: Rows) -> str:
    """Rows as columns of equal width."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        for row in rows
    ]
    return "\n".join(line.rstrip() for line in lines)


def markdown_table(rows: Rows) -> str:
    """Rows as a Markdown table."""
    header, *body = rows
    return "\n".join(
        "| " + " | ".join(row) + " |" for row in (header, ["---"] * len(header), *body)
    )
