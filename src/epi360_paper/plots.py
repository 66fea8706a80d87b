# SPDX-License-Identifier: BSD-3-Clause
"""Drawing that the figures share: colours, panels, panoramas, a room seen from above."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from epi360.features.picture_writing import encode_figure

Array = NDArray[np.float64]

DPI = 100
CEILING_M, CELL_M = 0.9, 0.02  # of a top view: what is higher above the camera is left out
# Colours of numbered matches: hues that most colour-blind readers can tell from each other
# (Okabe & Ito 2008), brightened for pictures.
MATCH_COLOURS = (
    "#ff4b33", "#33b5ff", "#ffd21f", "#ff7ad9", "#00d69a", "#ff9c1a", "#b79aff", "#d8ff3e",
)  # fmt: skip
# The same hues for diagrams, in the order of use.
BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION = (
    "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00",
)  # fmt: skip
LANDMARK = "#00d69a"  # green, brightened because it is drawn on pictures
INK, SOFT, FAINT = "#222222", "#777777", "#c8ccd0"
STROKE = [withStroke(linewidth=2.5, foreground="white")]
DARK_STROKE = [withStroke(linewidth=2.5, foreground="black")]


def new_figure(width_in: float, height_in: float) -> Figure:
    """White figure on the Agg canvas, independent of pyplot."""
    # Older versions of matplotlib cut 100 times 10.2 inches to 1,019 pixels.
    size = (width_in + 1e-9, height_in + 1e-9)
    figure = Figure(figsize=size, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def png_of(figure: Figure) -> bytes:
    """Encode a figure as PNG; equal figures give equal bytes."""
    return encode_figure(figure, "png", dpi=DPI, metadata={"Software": None})


def add_axes(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes in a box measured in inches from the figure's upper left corner."""
    full_width, full_height = figure.get_size_inches()
    bottom = full_height - top - height
    return figure.add_axes(
        (left / full_width, bottom / full_height, width / full_width, height / full_height)
    )


def write_panel_title(axes: Axes, letter: str, text: str) -> None:
    """Write the letter of a panel in bold and what it shows above the axes."""
    axes.set_title(f"({letter})  {text}", loc="left", fontsize=12, color=INK, pad=6)


def draw_panorama(axes: Axes, image: NDArray[np.uint8], *, fade: float = 0.0) -> None:
    """Show an image on axes that then count its continuous pixels."""
    height, width = image.shape[:2]
    shown = np.asarray(image * (1.0 - fade) + 255.0 * fade, dtype=np.uint8)
    axes.imshow(shown, extent=(0, width, height, 0), aspect="auto", interpolation="antialiased")
    axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
    axes.spines[:].set_visible(False)


def draw_keypoints(axes: Axes, pixels: Array, *, area: float = 26.0) -> None:
    """Mark key points with dots that stand out on any picture."""
    u, v = pixels.T
    axes.scatter(u, v, s=area, c=LANDMARK, linewidths=0.7, edgecolors="black", zorder=4)


def draw_top_view(axes: Axes, image: NDArray[np.uint8], points: Array, landmarks: Array) -> None:
    """Draw points (H, W, 3) in the camera frame and landmarks from above, z up, x to the right."""
    flat, colours = points.reshape(-1, 3), image.reshape(-1, 3)
    kept = np.flatnonzero(np.isfinite(flat).all(axis=1) & (flat[:, 1] > -CEILING_M))
    order = kept[np.argsort(-flat[kept, 1], kind="stable")]  # y is down: the highest come last
    ground = flat[order][:, [0, 2]]
    low, high = np.percentile(ground, [0.1, 99.9], axis=0) + [[-0.2] * 2, [0.2] * 2]
    top = _map_of(ground, colours[order], low, high)
    axes.imshow(
        top, origin="lower", extent=(low[0], high[0], low[1], high[1]), interpolation="antialiased"
    )
    draw_keypoints(axes, landmarks[:, [0, 2]], area=20.0)
    axes.plot(0, 0, marker="o", markersize=11, color="white", markeredgecolor=INK, zorder=5)
    axes.plot(0, 0, marker=(3, 0, 0), markersize=6, color=VERMILION, zorder=6)
    axes.set(xlabel="x (m)", ylabel="z (m)")
    style_axes(axes)


def _map_of(
    ground: Array, colours: NDArray[np.uint8], low: Array, high: Array
) -> NDArray[np.uint8]:
    """Image of cells; coarser cells fill gaps of finer ones, as points are sparse far away."""
    factor = 4
    size = factor * np.ceil((high - low) / CELL_M / factor).astype(int)
    top = np.full((size[1], size[0], 3), 255, np.uint8)
    for scale in (factor, 2, 1):
        cells = ((ground - low) / (CELL_M * scale)).astype(int)
        inside = ((ground >= low) & (cells < size // scale)).all(axis=1)
        coarse = np.full((size[1] // scale, size[0] // scale, 3), 255, np.uint8)
        hit = np.zeros(coarse.shape[:2], np.bool_)
        coarse[cells[inside, 1], cells[inside, 0]] = colours[inside]
        hit[cells[inside, 1], cells[inside, 0]] = True
        fine, mask = (np.repeat(np.repeat(a, scale, 0), scale, 1) for a in (coarse, hit))
        top[mask] = fine[mask]
    return top


def style_axes(axes: Axes) -> None:
    """Give axes with ticks the look of the figures."""
    axes.tick_params(labelsize=9, colors=INK, length=3)
    axes.xaxis.label.set_fontsize(10)
    axes.yaxis.label.set_fontsize(10)
    axes.spines[:].set_color(SOFT)


def spread_indices(bearings: Array, num: int) -> NDArray[np.intp]:
    """Rows of bearings that lie far from each other, by farthest-point sampling."""
    chosen: list[int] = []
    nearest = np.full(len(bearings), np.inf)
    for _ in range(min(num, len(bearings))):
        chosen.append(int(np.argmax(nearest)))
        step = np.linalg.norm(bearings - bearings[chosen[-1]], axis=1)
        nearest = np.minimum(nearest, step)
    return np.array(chosen, dtype=np.intp)
