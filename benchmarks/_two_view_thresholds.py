# SPDX-License-Identifier: BSD-3-Clause
"""The automatic threshold against fixed ones over the noise: no fixed default can serve."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from _machine import fact_lines
from _summary import Rows, markdown_table, text_table
from _two_view_answer import errors_deg
from _two_view_plots import write_thresholds
from _two_view_problems import Cell, make_problem
from numpy.typing import NDArray

import epi360
from epi360.runs.whole_files import write_file

NOISES = ("0.05", "0.1", "0.2", "0.5", "1", "2", "3")
FACTORS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)  # fixed thresholds in sigma
MAX_THRESHOLD_DEG = 45.0


def threshold_report(options: argparse.Namespace, facts: dict[str, Any]) -> None:
    """Write ``thresholds.md`` and ``thresholds.png``: medians of the room, 400 matches, 50 %."""
    errors = {noise: _errors(noise, options) for noise in NOISES}
    table = _table(errors)
    labels = ["auto", *(f"{factor:g} sigma" for factor in FACTORS)]
    curves = {
        label: [float(np.nanmedian(errors[noise][label][:, 1])) / float(noise) for noise in NOISES]
        for label in labels
    }
    write_thresholds(options.out / "thresholds.png", [float(noise) for noise in NOISES], curves)
    text = "\n\n".join(
        [
            "# Automatic threshold against the best fixed one",
            "\n".join(f"- {line}" for line in fact_lines(facts)),
            f"Room, 400 matches, 50 % outliers, {options.problems} problems a row. The best fixed "
            "threshold is the one of least median direction error among the factors of sigma; it "
            "is chosen on the same problems that it is judged on, which favours it. "
            "`t`, `R`: median error of auto over its. `pair by pair`: geometric mean of the "
            "direction errors' ratio. Aim: within 5 %.",
            "![Direction error against noise](thresholds.png)",
            markdown_table(table),
        ]
    )
    write_file(options.out / "thresholds.md", (text + "\n").encode())
    print(f"\n{text_table(table)}", flush=True)


def _errors(noise: str, options: argparse.Namespace) -> dict[str, NDArray[np.float64]]:
    """Rotation and direction errors (problems, 2) by the label of the threshold."""
    cell = Cell("room", 400, 50, noise)
    thresholds: dict[str, Any] = {"auto": "auto"}
    for factor in FACTORS:
        degrees = min(factor * cell.noise_deg, MAX_THRESHOLD_DEG)
        thresholds[f"{factor:g} sigma"] = degrees
    errors: dict[str, list[tuple[float, float]]] = {label: [] for label in thresholds}
    for index in range(options.problems):
        problem = make_problem(cell, index, options.seed)
        for label, threshold in thresholds.items():
            pose = epi360.estimate_relative_pose(
                problem.bearings1, problem.bearings2, inlier_threshold_deg=threshold, seed=index
            ).cam2_from_cam1
            errors[label].append(errors_deg(pose, problem.cam2_from_cam1))
    return {label: np.nan_to_num(values, nan=180.0) for label, values in errors.items()}


def _table(errors: dict[str, dict[str, NDArray[np.float64]]]) -> Rows:
    table = [["noise deg", "auto t deg", "best fixed", "its t deg", "t", "R", "pair by pair"]]
    for noise, by_label in errors.items():
        auto = by_label["auto"]
        fixed = {label: values for label, values in by_label.items() if label != "auto"}
        best = min(fixed, key=lambda label: float(np.median(fixed[label][:, 1])))
        medians, bests = np.median(auto, axis=0), np.median(fixed[best], axis=0)
        floor = 1e-9  # two equal poses may be exact
        ratios = np.log((auto[:, 1] + floor) / (fixed[best][:, 1] + floor))
        table.append(
            [
                noise,
                f"{medians[1]:.3g}",
                best,
                f"{bests[1]:.3g}",
                f"{medians[1] / bests[1]:.3f}",
                f"{medians[0] / bests[0]:.3f}",
                f"{np.exp(ratios.mean()):.3f}",
            ]
        )
    return table
