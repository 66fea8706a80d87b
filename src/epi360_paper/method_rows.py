# SPDX-License-Identifier: BSD-3-Clause
"""What Tables 1 to 3 share: rows of methods on the pairs of a trial, and what pages say of them."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from epi360.poses import rotation_error_deg
from epi360.progress import Progress
from epi360_paper.methods import estimate_pose, pose_errors
from epi360_paper.options import Outcome, ProtocolName, ReproduceOptions
from epi360_paper.parts import Row, Trials
from epi360_paper.protocols import PROTOCOLS
from epi360_paper.rendered import PAIRS_PER_SEQUENCE, Lens, RenderedTracks
from epi360_paper.results import Compared, comparison_table, in_thousandths, run_line, save_outcome
from epi360_paper.sources import LandmarkPairs, PairSource, pair_rule
from epi360_paper.tracks import BearingPair
from epi360_paper.trials import Trial, run_trials

Measure = Callable[[BearingPair, str], Mapping[str, float]]

PAPERS_PAIRS = 2000  # paper, section 5.2: "over 2K different environments"
# Tracks further out of their true epipolar plane are counted: about three pixels of the rendered
# panoramas.
FAR_OFF_DEG = 1.0
NORMAL_MEDIAN = 0.6745  # median absolute value of a normal variable of unit standard deviation


@dataclass(frozen=True)
class PrintedRow:
    """A method's row of the paper's table: errors in 1e-3."""

    title: str
    rotation: float
    translation: float
    time_ms: float


@dataclass(frozen=True)
class Cell:
    """What a trial of the tables needs."""

    source: PairSource  # where the pairs come from
    protocol: ProtocolName  # details of the methods


def rendered_cell(lens: Lens, options: ReproduceOptions) -> Cell:
    """Cell of rendered sequences, whose tracks are kept in the folder ``tracks`` of the run."""
    rule = pair_rule(options.protocol)
    source = RenderedTracks(lens, options.image_width, rule, options.out / "tracks")
    return Cell(source, options.protocol)


def num_sequences(options: ReproduceOptions) -> int:
    """Least number of rendered sequences that can give the wanted number of pairs."""
    return math.ceil(options.num_trials(PAPERS_PAIRS) / PAIRS_PER_SEQUENCE)


def run_sequences(
    name: str,
    cells: Mapping[str, Cell],
    trial_function: Callable[[Cell, Trial], Sequence[Row]],
    num_trials: int,
    options: ReproduceOptions,
    progress: Progress,
) -> Trials:
    """Rows of the trials of some sequences that had pairs."""
    return with_pairs(
        run_trials(name, cells, trial_function, num_trials, options, progress, chunk_size=1)
    )


def pair_rows(
    pairs: Sequence[BearingPair],
    methods: Sequence[str],
    protocol: ProtocolName,
    measure: Measure | None = None,
    measured: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """One row for each pair and method; a trial without pairs gives one row with the pair -1."""
    rows: list[dict[str, Any]] = []
    for index, pair in enumerate(pairs):
        residuals_deg = np.degrees(pair.true_residuals_rad())
        place = {
            "pair": index,
            "num_tracks": len(residuals_deg),
            "turn_deg": rotation_error_deg(pair.cam2_from_cam1, np.eye(3)),
            "off_share": float(np.mean(residuals_deg > FAR_OFF_DEG)),
            "noise_deg": float(np.median(residuals_deg)) / NORMAL_MEDIAN,
        }
        for method in methods:
            more = measure(pair, method) if measure is not None else {}
            rows.append({**place, "method": method, **more, **_errors(pair, method, protocol)})
    return rows or [_empty_row(measured)]


def with_pairs(trials: Trials) -> Trials:
    """Rows of the trials that had pairs; ``ValueError`` if none had."""
    kept = trials["pair"] >= 0
    if not kept.any():
        raise ValueError(
            "the sequences must hold pairs of frames 0.5 m apart with 50 tracks alive, got none; "
            "take larger images or longer sequences"
        )
    return Trials({name: column[kept] for name, column in trials.columns.items()}, trials.seconds)


def pairs_line(trials: Trials, what: str) -> str:
    """Sentence on the pairs behind a table."""
    one = trials.where(method=trials["method"][0])
    count = len(set(zip(one["cell"].tolist(), one["trial"].tolist(), strict=True)))
    return (
        f"{len(one):,} pairs of {count:,} {what}; medians: {np.median(one['num_tracks']):.0f} "
        f"matches, {np.median(one['turn_deg']):.1f}° of turn, {np.median(one['noise_deg']):.2f}° "
        "of noise out of the true epipolar plane; "
        f"{100 * np.mean(one['off_share']):.1f} % of the matches are more than "
        f"{FAR_OFF_DEG:g}° out of it."
    )


def agreement_line(quantity: str, paper: Mapping[str, float], ours: Mapping[str, float]) -> str:
    """Sentence on how many pairs of methods are ordered as in the paper."""
    pairs = [(a, b) for a, b in combinations(paper, 2) if paper[a] != paper[b]]
    agree = [(a, b) for a, b in pairs if (paper[a] < paper[b]) == (ours[a] < ours[b])]
    order = " < ".join(sorted(ours, key=lambda name: ours[name]))
    return (
        f"{quantity}: {len(agree)} of {len(pairs)} pairs of methods are ordered as in the paper; "
        f"ours from the smallest: {order}."
    )


@dataclass(frozen=True)
class Comparison:
    """What tells Table 1 from Table 2."""

    name: str
    title: str
    evaluate: Callable[[Cell, Trial], Sequence[Row]]  # gives the rows of a trial
    printed: Mapping[str, PrintedRow]  # the paper's row of each method
    columns: Mapping[str, str]  # title of each quantity; the paper may lack some
    measured: Sequence[str] = ()  # columns beside errors and time
    notes: Sequence[str] = ()


def run_comparison(table: Comparison, options: ReproduceOptions, progress: Progress) -> Outcome:
    """Run Table 1 or 2: on landmarks, or on tracks in rendered panoramas."""
    if options.landmarks:
        name, where, unit = f"{table.name}-landmarks", "synthetic landmarks", "scenes"
        cells = {"landmarks": Cell(LandmarkPairs(options.protocol), options.protocol)}
        count = options.num_trials(PAPERS_PAIRS)
        trials = run_trials(name, cells, table.evaluate, count, options, progress)
    else:
        name, where, unit = table.name, "tracks in rendered panoramas", "rendered sequences"
        cells = {"rendered-360": rendered_cell("360", options)}
        count = num_sequences(options)
        trials = run_sequences(name, cells, table.evaluate, count, options, progress)
    sections = [*_comparison_sections(table, trials, unit), *table.notes]
    run = run_line(options, int(trials["trial"].max()) + 1, trials, unit)
    return save_outcome(name, f"{table.title}, {where}", run, sections, trials, options)


def _comparison_sections(table: Comparison, trials: Trials, unit: str) -> list[str]:
    printed = table.printed
    ours = {method: _medians(trials.where(method=method), table.measured) for method in printed}
    rows = {
        row.title: [
            Compared(getattr(row, name, None), ours[method][name]) for name in table.columns
        ]
        for method, row in printed.items()
    }
    orders = [
        agreement_line(
            quantity.capitalize(),
            {row.title: getattr(row, quantity) for row in printed.values()},
            {row.title: ours[method][quantity] for method, row in printed.items()},
        )
        for quantity in ("rotation", "translation")
    ]
    compared = comparison_table("method", list(table.columns.values()), rows)
    return [compared, pairs_line(trials, unit), " ".join(orders)]


def _medians(trials: Trials, measured: Sequence[str]) -> dict[str, float]:
    return {
        **{name: float(np.nanmedian(trials[name])) for name in measured},
        "rotation": in_thousandths(trials["rotation_error"]),
        "translation": in_thousandths(trials["translation_error"]),
        "time_ms": float(np.median(trials["time_ms"])),
    }


def _errors(pair: BearingPair, method: str, protocol: ProtocolName) -> dict[str, float]:
    began = time.perf_counter()
    pose = estimate_pose(method, pair.bearings1, pair.bearings2, PROTOCOLS[protocol])
    seconds = time.perf_counter() - began
    rotation, translation = pose_errors(pose, pair.cam2_from_cam1)
    return {"rotation_error": rotation, "translation_error": translation, "time_ms": 1e3 * seconds}


def _empty_row(measured: Sequence[str]) -> dict[str, Any]:
    place = {
        "pair": -1,
        "num_tracks": 0,
        **dict.fromkeys(("turn_deg", "off_share", "noise_deg"), np.nan),
    }
    errors = ("rotation_error", "translation_error", "time_ms")
    return {**place, "method": "", **dict.fromkeys((*measured, *errors), np.nan)}
