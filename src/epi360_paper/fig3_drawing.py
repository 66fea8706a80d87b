# SPDX-License-Identifier: BSD-3-Clause
"""How Fig. 3 is drawn: the geometry, three coloured ovoids, the surface and its section."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]
from numpy.typing import NDArray

from epi360.synthetic import TwoViewScene
from epi360_paper.ovoid_plots import draw_ovoid
from epi360_paper.plots import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    SOFT,
    STROKE,
    VERMILION,
    add_axes,
    new_figure,
    style_axes,
    write_panel_title,
)

Array = NDArray[np.float64]

PARALLAX_COLOURS, ERROR_COLOURS = "viridis", "cividis"  # readable for all, also in grey
WIDTH_IN, HEIGHT_IN = 15.0, 9.9
# How the ends of the searches are marked in panels e and f; they may coincide.
MARKS: dict[str, dict[str, Any]] = {
    "start": {
        "color": SOFT, "marker": "o", "markersize": 10, "markeredgecolor": "white",
        "label": "start (1, 1): 8-PA",
    },
    "lm": {
        "color": VERMILION, "marker": "s", "markersize": 13, "markerfacecolor": "none",
        "markeredgewidth": 2.2, "label": "Levenberg-Marquardt over S, K",
    },
    "line": {
        "color": GREEN, "marker": "D", "markersize": 8, "markeredgecolor": "white",
        "label": "search over K/S, S = 1",
    },
}  # fmt: skip


@dataclass(frozen=True)
class Surface:
    """Errors of one problem over a grid of S and K, and where the searches end."""

    values: Array  # (G,): values of S and of K, evenly spaced in their logarithm
    # (G, G): one row for each S, one column for each K
    rotation_deg: Array
    translation_deg: Array
    # S, K and the translation error in degrees where the searches "line" and "lm" end, and at
    # their "start", (1, 1)
    found: dict[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Profile:
    """Curves over K/S, one row a problem."""

    ratios: Array  # (R,): values of K/S
    translation_deg: Array  # (P, R)
    residual_deg: Array  # (P, R): mean absolute value of eq. 13, which the search minimises


def draw_stability(
    scene: TwoViewScene,
    panels: Mapping[str, tuple[float, float]],
    parallax: Mapping[str, Array],
    surface: Surface,
    profile: Profile,
    shown: int,
) -> Figure:
    """Figure 3 of the paper, with a sixth panel: the section of the surface along K/S."""
    figure = new_figure(WIDTH_IN, HEIGHT_IN)
    _draw_geometry(add_axes(figure, 0.15, 0.5, 4.4, 3.7))
    largest = max(float(np.percentile(values, 99)) for values in parallax.values())
    norm = Normalize(0.0, largest)
    scale = ScalarMappable(norm, PARALLAX_COLOURS)
    for column, (letter, (S, K)) in enumerate(panels.items()):
        axes = add_axes(figure, 4.75 + 3.15 * column, 0.5, 3.05, 3.7)
        write_panel_title(axes, letter, _panel_words(S, K, parallax[letter]))
        draw_ovoid(
            axes, scene.bearings1, np.diag([S, S, K]), colours=parallax[letter], norm=norm,
            cmap=PARALLAX_COLOURS, extent=2.2, area=13.0,
        )  # fmt: skip
    bar = figure.colorbar(scale, cax=add_axes(figure, 14.25, 0.8, 0.14, 3.1), extend="max")
    bar.set_label("motion parallax in the normalised domain (°)", fontsize=10)
    bar.ax.tick_params(labelsize=9)
    _draw_surface(figure, surface)
    _draw_profile(add_axes(figure, 8.2, 4.9, 6.1, 3.4), surface, profile, shown)
    return figure


def _panel_words(S: float, K: float, parallax: Array) -> str:
    name = "unit sphere" if S == K else ("$S$ = 2" if S > K else "$K$ = 2")
    return f"{name}: mean {parallax.mean():.1f}°"


def _draw_geometry(axes: Axes) -> None:
    write_panel_title(axes, "a", "internal angles and motion parallax")
    centers = {"1": np.array([0.0, 0.0]), "2": np.array([2.5, 0.25])}
    points = {"i": np.array([0.55, 2.45]), "j": np.array([3.15, 2.75])}
    axes.plot(*np.stack(list(centers.values())).T, color=INK, linewidth=1.6, zorder=2)
    axes.text(1.25, 0.0, "$\\mathbf{t}$", fontsize=13, color=INK, ha="center", va="top")
    for name, center in centers.items():
        axes.add_patch(Circle(tuple(center), 0.62, facecolor="#f4f6f8", edgecolor=SOFT, zorder=0))
        axes.plot(*center, "o", color=INK, markersize=5, zorder=6)
        x, y = center - (0.0, 0.12)
        axes.text(x, y, f"$C_{name}$", fontsize=13, ha="center", va="top", path_effects=STROKE)
        for colour, point in zip((BLUE, VERMILION), points.values(), strict=True):
            axes.plot(*np.stack([center, point]).T, color=colour, linewidth=1.4, zorder=3)
            inner = center + 0.62 * (point - center) / np.linalg.norm(point - center)
            axes.plot(*inner, "o", color=colour, markersize=4.5, zorder=5)
        label = f"$\\beta^{name}_{{ij}}$"
        _draw_angle(axes, center, points["i"], points["j"], PURPLE, label, 0.36, 1.95)
    for (name, point), colour in zip(points.items(), (BLUE, VERMILION), strict=True):
        label = f"$\\alpha_{name}$"
        _draw_angle(axes, point, centers["1"], centers["2"], colour, label, 0.5, 1.42)
        axes.plot(*point, "o", color=colour, markersize=8, markeredgecolor=INK, zorder=6)
        axes.text(point[0], point[1] + 0.12, f"$P_{name}$", fontsize=13, ha="center", va="bottom")
    axes.set(xlim=(-0.8, 3.7), ylim=(-0.75, 3.25))
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_angle(
    axes: Axes, corner: Array, first: Array, second: Array, colour: str, label: str,
    radius: float, label_distance: float,
) -> None:  # fmt: skip
    angles = [np.arctan2(*(end - corner)[::-1]) for end in (first, second)]
    low, high = sorted(angles)
    arc = Arc(
        tuple(corner), 2 * radius, 2 * radius, theta1=np.degrees(low), theta2=np.degrees(high),
        color=colour, linewidth=2.2, zorder=4,
    )  # fmt: skip
    axes.add_patch(arc)
    middle = 0.5 * (low + high)
    place = corner + label_distance * radius * np.array([np.cos(middle), np.sin(middle)])
    axes.text(
        place[0], place[1], label, fontsize=13, color=colour, ha="center", va="center",
        path_effects=STROKE, zorder=7,
    )  # fmt: skip


def _draw_surface(figure: Figure, surface: Surface) -> None:
    """Draw panel e as the paper does, with the line of equal K/S through the found optimum."""
    box = (0.2 / WIDTH_IN, 0.25 / HEIGHT_IN, 7.2 / WIDTH_IN, 4.8 / HEIGHT_IN)
    axes = figure.add_axes(box, projection="3d", computed_zorder=False)
    assert isinstance(axes, Axes3D)
    heading = "(e)  translation error over S and K: a valley along K/S, not a point"
    figure.text(0.15 / WIDTH_IN, 1 - 4.82 / HEIGHT_IN, heading, fontsize=12, color=INK)
    logs = np.log2(surface.values)
    S, K = np.meshgrid(logs, logs, indexing="ij")
    axes.plot_surface(
        S, K, surface.translation_deg, cmap=ERROR_COLOURS, rstride=1, cstride=1, linewidth=0.15,
        edgecolor=(1, 1, 1, 0.25), antialiased=True, zorder=1,
    )  # fmt: skip
    S_found, K_found, error = surface.found["line"]
    offset = np.log2(K_found / S_found)
    along = logs[np.abs(logs + offset) <= logs[-1]]
    axes.plot(along, along + offset, np.full(len(along), error), color=GREEN, linewidth=2.5,
              zorder=3)  # fmt: skip
    for kind, style in MARKS.items():
        S_, K_, height = surface.found[kind]
        place = ([np.log2(abs(S_))], [np.log2(abs(K_))], [height])
        axes.plot(*place, linestyle="none", zorder=4, **style)
    ticks = np.arange(-2, 3)
    names = [f"{2.0**tick:g}" for tick in ticks]
    axes.set_xticks(ticks, names)
    axes.set_yticks(ticks, names)
    axes.set_xlabel("S", fontsize=11)
    axes.set_ylabel("K", fontsize=11)
    axes.set_zlabel("translation error (°)", fontsize=10)
    axes.tick_params(labelsize=9)
    axes.view_init(elev=52.0, azim=-114.0)
    axes.set_box_aspect((1.25, 1.25, 0.75), zoom=1.0)


def _draw_profile(axes: Axes, surface: Surface, profile: Profile, shown: int) -> None:
    write_panel_title(axes, "f", "the same points over K/S alone, and the median over problems")
    S, K = np.meshgrid(surface.values, surface.values, indexing="ij")
    axes.scatter(
        (K / S).ravel(), surface.translation_deg.ravel(), s=9, color=SKY, linewidths=0,
        label=f"all {S.size} points of (e)",
    )  # fmt: skip
    low, middle, high = np.percentile(profile.translation_deg, [25, 50, 75], axis=0)
    num = len(profile.translation_deg)
    axes.fill_between(profile.ratios, low, high, color=ORANGE, alpha=0.18, linewidth=0)
    axes.plot(profile.ratios, middle, color=ORANGE, linewidth=2.0,
              label=f"median and quartiles, {num} problems")  # fmt: skip
    for kind, style in MARKS.items():
        S_, K_, height = surface.found[kind]
        axes.plot(abs(K_ / S_), height, linestyle="none", zorder=6, **style)
    other = axes.twinx()
    other.plot(profile.ratios, profile.residual_deg[shown], color=PURPLE, linewidth=1.6,
               linestyle="--", label="mean residual of (e), eq. 14")  # fmt: skip
    other.set_ylabel("mean residual (°)", color=PURPLE)
    axes.set_xscale("log", base=2)
    ticks = 2.0 ** np.arange(-4, 5, 1)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set(xlabel="K/S", ylabel="translation error (°)", xlim=(ticks[0], ticks[-1]))
    axes.set_ylim(bottom=0.0)
    style_axes(axes)
    style_axes(other)
    other.tick_params(axis="y", colors=PURPLE)
    _draw_legend(axes, other)


def _draw_legend(axes: Axes, other: Axes) -> None:
    shown = [each.get_legend_handles_labels() for each in (axes, other)]
    axes.legend(
        [handle for handles, _ in shown for handle in handles],
        [label for _, labels in shown for label in labels],
        loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, fontsize=9.5, frameon=False,
    )  # fmt: skip
