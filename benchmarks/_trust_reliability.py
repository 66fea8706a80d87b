# SPDX-License-Identifier: BSD-3-Clause
"""Whether stated probabilities are kept: a table, and a reliability diagram."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _trust_records import RIGHT_DEG, WRONG_DEG, Judged
from _trust_synthetic import Trial

EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 0.999, 1.0)
# A pose is right if it is within 5 degrees of the truth, or as near as it says itself: three sigma,
# or one in a hundred of chi^2 with five degrees of freedom. Others count if they are over 10
# degrees off; what lies between may be an error of the reference.
SIGMAS, LARGEST_SQUARE = 3.0, 15.09 / 5.0
CLOSEST = 5e-4  # to 0 and 1, as far as the diagram shows them
ONE_SIGMA = 1.0


class Stated(NamedTuple):
    """A stated probability, on which data, and whether the pose was right."""

    group: str
    probability: float
    is_right: bool


class Held(NamedTuple):
    """The poses of a group whose probability lies between two edges."""

    group: str
    low: float
    high: float
    count: int
    mean: float
    right: float
    bounds: tuple[float, float]  # of the share that is right, one sigma


def stated_probabilities(judged: Iterable[Judged], trials: Iterable[Trial]) -> list[Stated]:
    """Every right or wrong pose, accepted or refused, that comes with a probability."""
    pairs = [
        Stated(_group_of(run), run.probability, _is_right(run))
        for run in judged
        if (_is_right(run) or run.is_wrong) and not math.isnan(run.probability)
    ]
    synthetic = [
        Stated("synthetic", trial.probability, _is_right_trial(trial))
        for trial in trials
        if (_is_right_trial(trial) or trial.error_deg > WRONG_DEG)
        and not math.isnan(trial.probability)
    ]
    return pairs + synthetic


def _is_right(run: Judged) -> bool:
    errors = run.rotation_error_deg, run.translation_error_deg
    sigmas = run.rotation_sigma_deg, run.translation_sigma_deg
    return all(
        error < RIGHT_DEG or error < SIGMAS * sigma  # NaN where none is stated
        for error, sigma in zip(errors, sigmas, strict=True)
    )


def _is_right_trial(trial: Trial) -> bool:
    return trial.error_deg < RIGHT_DEG or trial.squared_error < LARGEST_SQUARE


def _group_of(run: Judged) -> str:
    name = run.set.split(" ")[0].rstrip(",")  # all ratios of the learned matches together
    _, comma, how = run.method.partition(", ")
    return f"{name}{comma}{how}"


def held(stated: Sequence[Stated]) -> list[Held]:
    """What became of the probabilities between each two edges, group by group."""
    found = []
    for group in dict.fromkeys(each.group for each in stated):
        for low, high in zip(EDGES[:-1], EDGES[1:], strict=True):
            inside = [
                each
                for each in stated
                if each.group == group
                and (low <= each.probability < high or low < each.probability == high == 1)
            ]
            if inside:
                right = float(np.mean([each.is_right for each in inside]))
                mean = float(np.mean([each.probability for each in inside]))
                bounds = wilson_bounds(right, len(inside))
                found.append(Held(group, low, high, len(inside), mean, right, bounds))
    return found


def wilson_bounds(share: float, count: int) -> tuple[float, float]:
    """Between which shares the true one lies, one sigma (Wilson 1927)."""
    z = ONE_SIGMA
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    spread = math.sqrt(share * (1 - share) / count + z * z / (4 * count**2))
    half = z / (1 + z * z / count) * spread
    return max(middle - half, 0.0), min(middle + half, 1.0)


def held_rows(found: Iterable[Held]) -> list[list[str]]:
    """Table of the same; "over" marks where less is right than stated, by over two sigma."""
    rows = [["data", "stated", "poses", "mean stated", "right", "one sigma", ""]]
    for each in found:
        low, high = each.bounds
        stated = f"{each.low:g} to {each.high:g}"
        is_over = each.right < 1.0 and each.right + 2.0 * (high - each.right) < each.mean
        over = "over-confident" if is_over else ""
        shares = f"{each.right:.1%}", f"{low:.1%} to {high:.1%}"
        rows.append([each.group, stated, str(each.count), f"{each.mean:.4f}", *shares, over])
    return rows


def draw_reliability(found: Sequence[Held], path: Path) -> None:
    """Write the diagram: stated probability against the share that is right, on log-odds axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.5, 6.0), layout="constrained")
    axes = figure.add_subplot()
    ends = _shown([0.0, 1.0])
    axes.plot(ends, ends, color="0.6", linewidth=1, label="stated = right")
    for index, group in enumerate(dict.fromkeys(each.group for each in found)):
        own = [each for each in found if each.group == group]
        # Side by side, so that bars of equal probabilities do not hide each other.
        places = _shown([each.mean for each in own]) + 0.05 * index
        shares = _shown([each.right for each in own])
        bars = np.abs(_shown([each.bounds for each in own]).T - shares)
        axes.errorbar(places, shares, bars, fmt="o:", markersize=5, capsize=2, label=group)
    ticks = (0.001, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999)
    axes.set_xticks(_shown(ticks), [f"{tick:g}" for tick in ticks])
    axes.set_yticks(_shown(ticks), [f"{tick:g}" for tick in ticks])
    axes.set_xlabel("stated probability")
    axes.set_ylabel("share of the poses that is right")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=130)


def _shown(shares: Sequence[float] | Sequence[tuple[float, float]]) -> np.ndarray:
    limited = np.clip(np.asarray(shares, dtype=float), CLOSEST, 1.0 - CLOSEST)
    return np.asarray(np.log(limited / (1.0 - limited)))
