# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of the two-view benchmark."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from _picture import Entry, panel_of, write_picture
from _two_view_methods import METHODS, ORACLE
from _two_view_summary import Summary
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_FRONT_ONLY = ("poselib front", "opencv front")  # drawn as rings
_MAX_CELLS = 60  # a picture of the whole grid could not be read
_WORST_RATIO = 100.0


def write_overview(path: Path, summaries: Sequence[Summary], facts: Mapping[str, Any]) -> None:
    """Three columns over the cells: error over the oracle's, failures, milliseconds."""
    names = list(dict.fromkeys(item.cell.name for item in summaries))[:_MAX_CELLS]
    shown = [item for item in summaries if item.cell.name in names]

    def entries(value: Callable[[Summary], float]) -> list[Entry]:
        return [
            (item.cell.name, item.method, value(item))
            for name in names
            for method in METHODS
            for item in shown
            if (item.cell.name, item.method) == (name, method)
        ]

    timed = [entry for entry in entries(lambda item: item.median_ms) if entry[1] != ORACLE]
    panels = [
        panel_of(
            "Median error of the direction", "times the oracle's",
            entries(lambda item: min(item.translation_over_oracle, _WORST_RATIO)), powers=True,
        ),
        panel_of(
            "Errors over 5°, and no pose", "%", entries(lambda item: 100.0 * item.failure_rate)
        ),
        panel_of("Median time, one thread", "ms", timed, powers=True),
    ]  # fmt: skip
    write_picture(
        path,
        "Two views: the robust estimator beside its peers",
        panels,
        facts,
        hollow=_FRONT_ONLY,
        remark="A cell is SCENE-MATCHES-OUTLIERS %-NOISE deg. Rings see the front half only.",
    )


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
