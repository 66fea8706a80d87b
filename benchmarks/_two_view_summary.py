# SPDX-License-Identifier: BSD-3-Clause
"""Figures of the two-view benchmark: rows to medians and rates, and those to tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from _two_view_methods import FAST_PEER, METHODS, ORACLE, OURS_AUTO, OURS_FIXED
from _two_view_problems import Cell
from _two_view_records import Row

FAILURE_DEG, GROSS_DEG = 5.0, 10.0
AUC_DEG = (1.0, 5.0, 10.0)
Rows = list[list[str]]


@dataclass(frozen=True)
class Summary:
    """One method in one cell; rates are shares, NaN where the cell has no such figure."""

    cell: Cell
    method: str
    num_problems: int
    auc: tuple[float, ...]  # at AUC_DEG, of the larger of the two errors
    rotation_deg: tuple[float, float]  # median and 90th percentile
    translation_deg: tuple[float, float]
    translation_over_oracle: float
    failure_rate: float
    best_failure_rate: float  # of the better of the pose and its alternatives
    wrong_accept_rate: float
    normalised_squared_error: float  # mean over accepted poses within GROSS_DEG
    median_ms: float
    median_cpu_ms: float
    times_faster: float  # than the fast peer
    times_faster_cpu: float
    statuses: Counter[str]
    num_warned: int


def summarise(cell: Cell, rows: Iterable[Row]) -> list[Summary]:
    """Summaries of every method that ran in a cell, in the order of ``METHODS``."""
    by_method: dict[str, dict[int, Row]] = {}
    for row in rows:
        if row.cell == cell.name:
            by_method.setdefault(row.method, {})[row.problem] = row
    return [
        _summary(cell, name, list(by_method[name].values()), by_method)
        for name in METHODS
        if name in by_method
    ]


def _summary(
    cell: Cell, method: str, own: list[Row], by_method: dict[str, dict[int, Row]]
) -> Summary:
    worst = np.array([_error(cell, row) for row in own])
    accepted = [row for row in own if row.accepted]
    good = [r.normalised_squared_error for r in accepted if _error(cell, r) <= GROSS_DEG]
    calibration = [value for value in good if math.isfinite(value)]
    fast = by_method.get(FAST_PEER, {})
    nan = float("nan")
    return Summary(
        cell=cell,
        method=method,
        num_problems=len(own),
        auc=tuple(_auc(worst, limit) if cell.has_truth else nan for limit in AUC_DEG),
        rotation_deg=_middle_and_tail([row.rotation_error_deg for row in own], cell.has_truth),
        translation_deg=_middle_and_tail(
            [row.translation_error_deg for row in own], cell.has_direction
        ),
        translation_over_oracle=(
            _ratio(own, by_method.get(ORACLE, {}), lambda row: row.translation_error_deg)
            if cell.has_direction
            else nan
        ),
        failure_rate=float(np.mean(worst > FAILURE_DEG)) if cell.has_truth else nan,
        best_failure_rate=(
            float(np.mean([not row.best_error_deg <= FAILURE_DEG for row in own]))
            if cell.has_truth
            else nan
        ),
        wrong_accept_rate=sum(_is_wrong_accept(cell, row) for row in own) / len(own),
        normalised_squared_error=float(np.mean(calibration)) if calibration else nan,
        median_ms=1e3 * float(np.median([row.seconds for row in own])),
        median_cpu_ms=1e3 * float(np.median([row.cpu_seconds for row in own])),
        times_faster=1.0 / _ratio(own, fast, lambda row: row.seconds),
        times_faster_cpu=1.0 / _ratio(own, fast, lambda row: row.cpu_seconds),
        statuses=Counter(row.status for row in own),
        num_warned=sum(row.accepted and row.has_warnings for row in own),
    )


def _error(cell: Cell, row: Row) -> float:
    """Larger of the errors that the cell has; infinite where the method gave no pose."""
    parts = [row.rotation_error_deg, row.translation_error_deg if cell.has_direction else 0.0]
    return max(math.inf if math.isnan(part) else part for part in parts)


def _is_wrong_accept(cell: Cell, row: Row) -> bool:
    """Whether the method stands behind a pose that is far off, or behind what is not there."""
    if cell.scene == "patch":
        return row.accepted and not row.has_warnings
    if not cell.has_direction:
        return row.accepted
    return row.accepted and _error(cell, row) > GROSS_DEG


def _auc(errors: np.ndarray, limit: float) -> float:
    """Area under the share of errors below x, x from 0 to the limit, over the limit."""
    return float(np.mean(np.clip(1.0 - errors / limit, 0.0, 1.0)))


def _middle_and_tail(errors: Sequence[float], is_known: bool) -> tuple[float, float]:
    if not is_known:
        return math.nan, math.nan
    values = np.array([math.inf if math.isnan(error) else error for error in errors])
    return float(np.median(values)), float(np.percentile(values, 90, method="higher"))


def _ratio(own: list[Row], others: dict[int, Row], value: Callable[[Row], float]) -> float:
    """Median over another method's median on the problems that both have."""
    pairs = [(value(row), value(others[row.problem])) for row in own if row.problem in others]
    if not pairs:
        return math.nan
    mine, theirs = (
        np.median([math.inf if math.isnan(x) else x for x in column])
        for column in zip(*pairs, strict=True)
    )
    return float(mine / theirs)


# Rows of the project's aims: cell, largest error over the oracle's, largest failure rate, least
# times faster than pycolmap; NaN: stated, not asked for. The cone's failures count over the
# oracle's.
_NO = math.nan
AIMS = {
    "room-400-20-0.1": (1.05, 0.0, 3.0),
    "room-400-50-0.1": (1.10, 0.0, 5.0),
    "room-400-50-k500": (1.40, 0.02, 4.0),
    "room-1000-50-0.1": (1.10, 0.0, 5.0),
    "room-5000-50-0.1": (1.10, 0.0, 6.0),
    "room-400-70-0.5": (1.45, 0.01, 6.0),
    "room-400-80-0.5": (_NO, 0.02, _NO),
    "cone-400-0-k500": (1.15, 0.02, _NO),
    "cone-400-30-k500": (1.15, 0.02, _NO),
    "plane-400-30-0.5": (_NO, 0.05, _NO),
}


def aims_table(summaries: Sequence[Summary]) -> Rows:
    """Table, header first: the aims, what was measured, and pycolmap beside it."""
    header = ["cell", "noise deg: sigma (mean angle)", "error / oracle", "aim", "pycolmap"]
    header += ["failures > 5 deg", "aim", "pycolmap", "oracle", "times faster", "aim"]
    table = [[*header, "in CPU time", "epi360 ms", "pycolmap ms"]]
    found = {(item.cell.name, item.method): item for item in summaries}
    for name, (error, failures, faster) in AIMS.items():
        ours, peer = found.get((name, OURS_AUTO)), found.get((name, FAST_PEER))
        floor = found.get((name, ORACLE))
        if ours is None:
            continue
        is_cone = name.startswith("cone")
        table.append(
            [
                name,
                noise_text(ours.cell),
                _number(ours.translation_over_oracle),
                _limit("<=", error),
                "-" if peer is None else _number(peer.translation_over_oracle),
                _percent(ours.failure_rate),
                ("oracle + " if is_cone else "<= ") + _percent(failures),
                "-" if peer is None else _percent(peer.failure_rate),
                "-" if floor is None else _percent(floor.failure_rate),
                _number(ours.times_faster),
                _limit(">=", faster),
                _number(ours.times_faster_cpu),
                _number(ours.median_ms),
                "-" if peer is None else _number(peer.median_ms),
            ]
        )
    return table


def cell_table(summaries: Sequence[Summary]) -> Rows:
    """Table, header first, with one row for each method of a cell."""
    header = ["method", "problems", *(f"AUC@{limit:g}" for limit in AUC_DEG)]
    header += ["R median", "R p90", "t median", "t p90", "t / oracle"]
    header += ["> 5 deg", "wrong accepted", "ms", "CPU ms"]
    table = [[*header, "times faster", "in CPU time"]]
    for item in summaries:
        table.append(
            [
                item.method,
                str(item.num_problems),
                *(_number(value) for value in item.auc),
                *(_number(value) for value in (*item.rotation_deg, *item.translation_deg)),
                _number(item.translation_over_oracle),
                _percent(item.failure_rate),
                _percent(item.wrong_accept_rate),
                _number(item.median_ms),
                _number(item.median_cpu_ms),
                _number(item.times_faster),
                _number(item.times_faster_cpu),
            ]
        )
    return table


def verdict_table(summaries: Sequence[Summary]) -> Rows:
    """Table, header first: what epi360 says of its own poses, and how right it is."""
    header = ["cell", "method", "statuses", "ok with a warning", "pure rotation"]
    table = [[*header, "> 5 deg", "of the best alternative", "wrong accepted", "calibration"]]
    for item in summaries:
        if item.method not in (OURS_AUTO, OURS_FIXED):
            continue
        statuses = ", ".join(f"{name} {count}" for name, count in item.statuses.most_common())
        table.append(
            [
                item.cell.name,
                item.method,
                statuses,
                str(item.num_warned),
                _percent(item.statuses["pure_rotation"] / item.num_problems),
                _percent(item.failure_rate),
                _percent(item.best_failure_rate),
                _percent(item.wrong_accept_rate),
                _number(item.normalised_squared_error),
            ]
        )
    return table


def noise_text(cell: Cell) -> str:
    """Both numbers of a cell's noise."""
    return f"{cell.noise_deg:.3g} ({cell.mean_angle_deg:.3g})"


def _limit(sign: str, value: float) -> str:
    return "state" if math.isnan(value) else f"{sign} {value:g}"


def _percent(rate: float) -> str:
    return "-" if math.isnan(rate) else f"{100.0 * rate:.3g} %"


def _number(value: float) -> str:
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "none"
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"
