# SPDX-License-Identifier: BSD-3-Clause
"""One picture that says what an experiment or a benchmark has found: dots in rows, by series."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from epi360.features.picture_writing import encode_figure
from epi360.runs.whole_files import PathLike, write_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Hues that most colour-blind readers tell apart (Okabe & Ito 2008), and a marker with each.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444", "#8c6d31")
_MARKERS = ("o", "s", "D", "^", "v", "P", "X", "*")
_INK, _SOFT, _FAINT = "#222222", "#666666", "#d5d9dd"
_BAND = "#f3f5f7"
_LABEL_LETTERS = 30  # of a row's name in one line
_PANEL_WIDTH, _WIDE_PANEL, _ROW_HEIGHT, _PANEL_EXTRA = 5.4, 7.2, 0.27, 1.05  # inches
_LEGEND_HEIGHT, _TITLE_HEIGHT, _NOTE_HEIGHT = 0.32, 0.62, 0.24
_DPI = 110
_MOST_SHARED = 10
_LEAST_POWERS, _MANY_POWERS = 3.0, 60.0  # ratios of the largest to the smallest value


@dataclass(frozen=True)
class Panel:
    """One quantity of some things, as found by one or more methods."""

    title: str
    axis: str  # the quantity with its unit
    rows: Sequence[str]  # what is measured
    series: Mapping[
        str, Sequence[float]
    ]  # a value for each row and method; NaN where there is none
    powers: bool = False  # a logarithmic axis
    aim: float | None = None  # a value that was asked for


@dataclass(frozen=True)
class Overview:
    """A picture: title, panels, and a line on how the numbers were made."""

    title: str
    panels: Sequence[Panel]
    note: str = ""
    hollow: frozenset[str] = field(default_factory=frozenset)  # series that are drawn as rings
    columns: int = 3


def write_overview(path: PathLike, overview: Overview) -> None:
    """Write the picture; the extension says the format."""
    write_file(path, overview_bytes(overview, Path(path).suffix.lower().removeprefix(".")))


def overview_bytes(overview: Overview, suffix: str) -> bytes:
    """Return the content of the picture's file."""
    return encode_figure(draw_overview(overview), suffix, dpi=_DPI)


def draw_overview(overview: Overview) -> Figure:
    """Return the picture as a matplotlib figure; ``ValueError`` if there is nothing to draw."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    panels = [panel for panel in overview.panels if panel.rows and panel.series]
    if not panels:
        raise ValueError("an overview must have a panel with rows and series, got none")
    columns = min(overview.columns, len(panels))
    names = list(dict.fromkeys(name for panel in panels for name in panel.series))
    is_shared = len(names) <= _MOST_SHARED  # one legend for all panels, or one beside each
    lines = [panels[i : i + columns] for i in range(0, len(panels), columns)]
    heights = [max(_height_of(panel) for panel in line) + _PANEL_EXTRA for line in lines]
    width = (_PANEL_WIDTH if is_shared else _WIDE_PANEL) * columns if columns > 1 else 8.0
    note = textwrap.wrap(overview.note, int(14 * width))
    per_line = max(1, int(width / 2.0))
    legend_height = (
        _LEGEND_HEIGHT * ceil(len(names) / per_line) if is_shared and len(names) > 1 else 0.0
    )
    bottom = _NOTE_HEIGHT * len(note) + 0.1
    height = sum(heights) + _TITLE_HEIGHT + legend_height + bottom
    top = 1.0 - (_TITLE_HEIGHT + legend_height) / height
    box = (0.005, bottom / height, 0.99, top - bottom / height)
    layout = ConstrainedLayoutEngine(rect=box, hspace=0.04, wspace=0.03)
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    styles = _styles(names, overview.hollow)
    grid = figure.subplots(len(lines), columns, squeeze=False, height_ratios=heights)
    _draw_panels(list(grid.flat), panels, styles if is_shared else None, overview.hollow)
    figure.suptitle(
        overview.title, x=0.012, y=1.0 - 0.16 / height, ha="left", va="top", fontsize=15,
        fontweight="bold", color=_INK,
    )  # fmt: skip
    if is_shared and len(names) > 1:
        _draw_legend(figure, names, styles, per_line, 1.0 - 0.52 / height)
    for i, line in enumerate(reversed(note)):
        figure.text(0.012, (0.08 + _NOTE_HEIGHT * i) / height, line, fontsize=9, color=_SOFT)
    return figure


def _draw_panels(
    places: Sequence[Axes],
    panels: Sequence[Panel],
    shared: Mapping[str, dict[str, object]] | None,
    hollow: frozenset[str],
) -> None:
    """Draw each panel, with styles and a legend of its own where none are shared."""
    for axes, panel in zip(places, panels, strict=False):
        styles = shared or _styles(list(panel.series), hollow)
        _draw_panel(axes, panel, styles)
        if shared is None and len(panel.series) > 1:
            _draw_own_legend(axes, panel, styles)
    for axes in places[len(panels) :]:
        axes.set_axis_off()


def _height_of(panel: Panel) -> float:
    lines = sum(len(textwrap.wrap(row, _LABEL_LETTERS)) or 1 for row in panel.rows)
    # Many dots in a row need room beside each other.
    return _ROW_HEIGHT * max(lines * max(1.0, len(panel.series) / 5.0), 2)


def _styles(names: Sequence[str], hollow: frozenset[str]) -> dict[str, dict[str, object]]:
    """Return a colour and a marker for each series; rings take those of the dots, in order."""
    styles: dict[str, dict[str, object]] = {}
    for group in (
        [name for name in names if name in hollow],
        [n for n in names if n not in hollow],
    ):
        for index, name in enumerate(group):
            colour = _COLOURS[index % len(_COLOURS)]
            styles[name] = {
                "color": colour,
                "marker": _MARKERS[index % len(_MARKERS)],
                "markerfacecolor": "white" if name in hollow else colour,
                "markeredgecolor": colour,
                "markeredgewidth": 1.6 if name in hollow else 0.0,
            }
    return styles


def _draw_legend(
    figure: Figure,
    names: Sequence[str],
    styles: Mapping[str, dict[str, object]],
    per_line: int,
    top: float,
) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], linestyle="", markersize=7, **styles[name]) for name in names]  # type: ignore[arg-type]
    figure.legend(
        handles, names, loc="upper left", bbox_to_anchor=(0.0, top), ncols=per_line,
        frameon=False, fontsize=10, handletextpad=0.2, columnspacing=1.6,
    )  # fmt: skip


def _draw_own_legend(axes: Axes, panel: Panel, styles: Mapping[str, dict[str, object]]) -> None:
    from matplotlib.lines import Line2D

    labels = [textwrap.fill(name, 20) for name in panel.series]
    handles = [Line2D([], [], linestyle="", markersize=7, **styles[name]) for name in panel.series]  # type: ignore[arg-type]
    axes.legend(
        handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9,
        handletextpad=0.2, borderaxespad=0.2,
    )  # fmt: skip


def _draw_panel(axes: Axes, panel: Panel, styles: Mapping[str, dict[str, object]]) -> None:
    places = range(len(panel.rows))
    _scale(axes, panel)
    for place in places[::2]:  # whose dot is whose, where the dots of a row are apart
        axes.axhspan(place - 0.5, place + 0.5, color=_BAND, zorder=0, linewidth=0)
    shifts = _shifts(panel, styles)
    for name, values in panel.series.items():
        rows = [place + shifts[name] for place in places]
        axes.plot(values, rows, linestyle="", markersize=7, zorder=3, **styles[name])  # type: ignore[arg-type]
    if panel.aim is not None:
        axes.axvline(panel.aim, color=_INK, linestyle="--", linewidth=1, zorder=2)
    labels = [textwrap.fill(row, _LABEL_LETTERS) for row in panel.rows]
    axes.set_yticks(list(places), labels, fontsize=9.5, color=_INK)
    axes.set_ylim(len(panel.rows) - 0.5, -0.5)
    axes.set_xlabel(panel.axis, fontsize=10, color=_INK)
    axes.set_title(textwrap.fill(panel.title, 52), loc="left", fontsize=11, color=_INK)
    axes.tick_params(axis="x", labelsize=9, colors=_INK)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color=_FAINT, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color(_SOFT)


def _shifts(panel: Panel, styles: Mapping[str, dict[str, object]]) -> dict[str, float]:
    """Return how far each series is off the middle of its row, so that no dot hides another."""
    hues = list(dict.fromkeys(styles[name]["color"] for name in panel.series))
    step = min(0.24, 0.6 / max(len(hues) - 1, 1))
    middle = (len(hues) - 1) / 2.0
    return {name: step * (hues.index(styles[name]["color"]) - middle) for name in panel.series}


def _scale(axes: Axes, panel: Panel) -> None:
    """Choose the axis: linear from zero, or powers where the values differ by some."""
    known = [value for values in panel.series.values() for value in values if isfinite(value)]
    known += [] if panel.aim is None else [panel.aim]
    if not known:
        return
    positive = [value for value in known if value > 0]
    if panel.powers and positive and len(positive) < len(known):
        # A measured zero has no logarithm: the axis is linear up to the smallest other value.
        axes.set_xscale("symlog", linthresh=min(positive))
    elif panel.powers and max(known) > _LEAST_POWERS * min(known) > 0:
        axes.set_xscale("log")
        _write_plain_powers(axes, max(known) / min(known))
    else:
        low, high = min([*known, 0.0]), max([*known, 0.0])
        high = high if high > low else low + 1.0
        margin = 0.05 * (high - low)
        axes.set_xlim(low - margin, high + margin)


def _write_plain_powers(axes: Axes, ratio: float) -> None:
    """Write 0.1, 1, 10 instead of powers; with less than two of them also twice and five times."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    subs = (1.0,) if ratio > _MANY_POWERS else (1.0, 2.0, 5.0)
    axes.xaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
