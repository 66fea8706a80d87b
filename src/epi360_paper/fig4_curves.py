# SPDX-License-Identifier: BSD-3-Clause
"""The curves of Fig. 4: medians with the band between the quartiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from epi360.features.picture_writing import encode_figure
from epi360_paper.parts import Trials, csv_bytes
from epi360_paper.results import in_thousandths

QUANTILES = (0.25, 0.5, 0.75)
KINDS = ("rotation", "translation")
# Okabe & Ito 2008: most colour-blind readers tell them apart.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00")
MARKERS = ("o", "s", "^", "D", "v")


@dataclass(frozen=True)
class Curves:
    """Quartiles of the errors of several methods at several levels."""

    axis: str  # what changes from level to level
    levels: tuple[str, ...]  # names of the L levels
    # (3, L) for each ("rotation" or "translation", method): 25, 50 and 75 % quantiles in 1e-3
    quartiles: dict[tuple[str, str], NDArray[np.float64]]

    @classmethod
    def from_trials(cls, axis: str, groups: Mapping[str, Trials], methods: Sequence[str]) -> Curves:
        """Quartiles of the raw trials of each level."""
        quartiles = {
            (kind, method): np.array([
                [in_thousandths(group[f"{kind}_{method}"], q) for group in groups.values()]
                for q in QUANTILES
            ])
            for kind in KINDS
            for method in methods
        }  # fmt: skip
        return cls(axis, tuple(groups), quartiles)

    def median(self, kind: str, method: str) -> NDArray[np.float64]:
        """Medians of one method, shape (L,), in 1e-3."""
        return np.asarray(self.quartiles[kind, method][1])


def csv_of_curves(curves: Curves) -> bytes:
    """Points of the curves as CSV."""
    heading = [curves.axis, "error", "method", "q25_1e-3", "q50_1e-3", "q75_1e-3"]
    rows = (
        [level, kind, method, *(f"{value:.6g}" for value in column)]
        for (kind, method), values in curves.quartiles.items()
        for level, column in zip(curves.levels, values.T, strict=True)
    )
    return csv_bytes(heading, rows)


def draw_curves(curves: Curves, titles: Mapping[str, str]) -> bytes:
    """PNG of the rotation and translation errors side by side."""
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2)
    for axes, kind in zip(panels, KINDS, strict=True):
        _draw_panel(axes, curves, kind, titles)
    panels[0].legend(frameon=False, fontsize=8)
    # Without the library's version in it the file is the same for the same numbers.
    return encode_figure(figure, "png", dpi=120, metadata={"Software": None})


def _draw_panel(axes: Axes, curves: Curves, kind: str, titles: Mapping[str, str]) -> None:
    places = np.arange(len(curves.levels))
    methods = [method for each, method in curves.quartiles if each == kind]
    for method, colour, marker in zip(methods, COLOURS, MARKERS, strict=False):
        low, middle, high = curves.quartiles[kind, method]
        axes.fill_between(places, low, high, color=colour, alpha=0.10, linewidth=0)
        axes.plot(places, middle, color=colour, marker=marker, markersize=4, label=titles[method])
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xticks(places, curves.levels, fontsize=8)
    axes.tick_params(axis="x", labelrotation=20 if len(" ".join(curves.levels)) > 50 else 0)
    axes.set_xlabel(curves.axis)
    axes.set_ylabel(f"{kind} error, 1e-3 (angle / π)")
    axes.grid(True, which="major", color="#dddddd", linewidth=0.6)
