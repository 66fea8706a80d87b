# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of the two-view benchmark."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from _two_view_methods import METHODS, ORACLE
from _two_view_summary import Summary
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

# Ours in the two strongest colours; the packages that see the front only are hollow.
_STYLE: dict[str, dict[str, Any]] = {
    "oracle": {"color": "black", "marker": "|", "s": 70},
    "epi360 auto": {"color": "#d62728", "marker": "o", "s": 42, "zorder": 5},
    "epi360 fixed": {"color": "#ff9896", "marker": "o", "s": 22, "zorder": 4},
    "pycolmap essential": {"color": "#1f77b4", "marker": "s", "s": 28},
    "pycolmap pose": {"color": "#aec7e8", "marker": "s", "s": 22},
    "pycolmap two-view": {"color": "#17becf", "marker": "D", "s": 20},
    "poselib front": {"facecolors": "none", "edgecolors": "#2ca02c", "marker": "^", "s": 28},
    "opencv front": {"facecolors": "none", "edgecolors": "#9467bd", "marker": "v", "s": 28},
    "panorai": {"color": "#8c564b", "marker": "P", "s": 32},
    "paper": {"color": "#7f7f7f", "marker": "x", "s": 28},
}
_MAX_CELLS = 60  # a picture of the whole grid could not be read
_WORST_RATIO = 100.0


def write_overview(path: Path, summaries: Sequence[Summary]) -> None:
    """Three columns over the cells: error over the oracle's, failures, milliseconds."""
    names = list(dict.fromkeys(item.cell.name for item in summaries))[:_MAX_CELLS]
    figure = Figure(figsize=(13, 1.6 + 0.3 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3, sharey=True)
    columns: list[tuple[str, Callable[[Summary], float]]] = [
        ("median t error / oracle's", lambda item: min(item.translation_over_oracle, _WORST_RATIO)),
        ("errors > 5 deg, %", lambda item: 100.0 * item.failure_rate),
        ("median ms, one thread", lambda item: item.median_ms),
    ]
    for axis, (title, value) in zip(axes, columns, strict=True):
        _scatter(axis, names, summaries, value)
        axis.set_title(title)
        axis.grid(True, color="0.9")
        axis.set_axisbelow(True)
    axes[0].set_xscale("log")
    axes[2].set_xscale("log")
    axes[0].set_yticks(range(len(names)), names, family="monospace", fontsize=8)
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    figure.savefig(path, dpi=110)


def _scatter(
    axis: Any, names: list[str], summaries: Sequence[Summary], value: Callable[[Summary], float]
) -> None:
    rows = {name: number for number, name in enumerate(names)}
    for method in METHODS:
        own = [s for s in summaries if s.method == method and s.cell.name in rows]
        points = [(value(item), rows[item.cell.name]) for item in own]
        points = [point for point in points if math.isfinite(point[0])]
        if points and not (method == ORACLE and value(own[0]) == own[0].median_ms):
            axis.scatter(*zip(*points, strict=True), label=method, **_STYLE[method])


def write_thresholds(
    path: Path, noises: Sequence[float], curves: dict[str, Sequence[float]]
) -> None:
    """Median direction error over sigma against the noise, one curve for each threshold."""
    figure = Figure(figsize=(7.5, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for label, values in curves.items():
        is_auto = label == "auto"
        style = {"color": "black", "linewidth": 2.5, "zorder": 5} if is_auto else {"alpha": 0.7}
        axis.plot(noises, values, marker="o", markersize=3, label=label, **style)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xticks(noises, [f"{noise:g}" for noise in noises])
    axis.minorticks_off()
    axis.set_xlabel("noise, degrees per axis")
    axis.set_ylabel("median direction error / noise")
    axis.grid(True, color="0.9")
    axis.legend(frameon=False, fontsize=8, ncols=2)
    figure.savefig(path, dpi=110)
