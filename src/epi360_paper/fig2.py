# SPDX-License-Identifier: BSD-3-Clause
"""Fig. 2: the normalised eight-point algorithm from two panoramas to the pose."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import ConnectionPatch, FancyArrowPatch
from numpy.typing import NDArray

from epi360.epipolar import (
    EightPointSolution,
    angular_residuals,
    essential_from_pose,
    pose_from_essential,
    triangulate,
)
from epi360.poses import Pose, rotation_error_deg, translation_error_deg
from epi360.progress import Progress
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.ovoid_plots import Eye, draw_ovoid
from epi360_paper.parts import Trials
from epi360_paper.plots import (
    BLUE,
    DARK_STROKE,
    INK,
    LANDMARK,
    MATCH_COLOURS,
    SOFT,
    STROKE,
    VERMILION,
    add_axes,
    draw_keypoints,
    draw_panorama,
    new_figure,
    png_of,
    spread_indices,
    write_panel_title,
)
from epi360_paper.results import markdown_table, save_outcome
from epi360_paper.tracked_pair import TrackedPair, pair_line, ratio_of, solutions, track_pair
from epi360_scenes import furnished_room

Array = NDArray[np.float64]

TITLE = "Fig. 2: the normalised eight-point algorithm on a rendered pair"
NUM_NUMBERED = len(MATCH_COLOURS)
NUM_PLANES = 3  # epipolar planes in panel d; more would hide each other
WIDTH_IN, HEIGHT_IN = 15.0, 6.9
BALL = 0.25  # radius of the cameras in panel d, in baselines
NUM_NEAREST = 12  # the planes of panel d end at some of the points nearest to the cameras


def run(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Make figure 2 from a rendered pair: matches, spheres, ovoids, essential matrix and pose."""
    room = furnished_room(options.seed)
    pair = track_pair(room, options, partial(progress, "fig2"))
    unit, best = solutions(pair)
    matrix = "; ".join(" ".join(f"{value:.4f}" for value in row) for row in best.E)
    outcome = save_outcome(
        "fig2",
        TITLE,
        pair_line(options),
        [_table(pair, unit, best), f"E after denormalisation, row by row: {matrix}."],
        Trials(_columns(pair, unit, best)),
        options,
        figure=png_of(_draw(pair, best)),
    )
    progress("fig2", 1, 1)
    return outcome


def _columns(
    pair: TrackedPair, unit: EightPointSolution, best: EightPointSolution
) -> dict[str, Any]:
    columns: dict[str, Any] = {"match": np.arange(len(pair.keypoints1))}
    for name, values in (("pixel1", pair.keypoints1), ("pixel2", pair.keypoints2)):
        columns |= {f"{name}_u": values[:, 0], f"{name}_v": values[:, 1]}
    truth = essential_from_pose(pair.cam2_from_cam1)
    for name, E in (("truth", truth), ("8pa", unit.E), ("opt_sk", best.E)):
        residuals = angular_residuals(E, pair.bearings1, pair.bearings2)
        columns[f"residual_{name}_deg"] = np.degrees(residuals)
    return columns


def _table(pair: TrackedPair, unit: EightPointSolution, best: EightPointSolution) -> str:
    rows = []
    for name, solution in (("8-PA", unit), ("Opt e(S, K)", best)):
        pose = pose_from_essential(solution.E, pair.bearings1, pair.bearings2)
        residuals = angular_residuals(solution.E, pair.bearings1, pair.bearings2)
        rows.append(
            [
                name,
                f"{ratio_of(solution):.3f}",
                f"{rotation_error_deg(pose, pair.cam2_from_cam1):.3f}",
                f"{translation_error_deg(pose, pair.cam2_from_cam1):.3f}",
                f"{np.degrees(np.median(np.abs(residuals))):.3f}",
            ]
        )
    heading = [
        f"{len(pair.keypoints1)} tracked key points", "K/S", "rotation error (deg)",
        "translation error (deg)", "median angle out of plane (deg)",
    ]  # fmt: skip
    return markdown_table(heading, rows)


def _draw(pair: TrackedPair, best: EightPointSolution) -> Figure:
    figure = new_figure(WIDTH_IN, HEIGHT_IN)
    numbered = spread_indices(pair.bearings1, NUM_NUMBERED)
    _draw_images(figure, pair, numbered)
    _draw_solids(figure, pair, numbered, np.eye(3), 6.25, ("b", "unit spheres"))
    N = best.normalizer1 / np.abs(best.normalizer1).max()
    name = f"ovoids, $K/S$ = {ratio_of(best):.2f}"
    _draw_solids(figure, pair, numbered, N, 8.95, ("c", name))
    _draw_pose(figure, pair, best)
    for left, step in ((5.97, ""), (8.67, "$N$"), (11.37, "DLT, $N^T\\hat{E}N$")):
        _draw_step(figure, left, step)
    return figure


def _draw_images(figure: Figure, pair: TrackedPair, numbered: NDArray[np.intp]) -> None:
    both = []
    for view, (image, pixels) in enumerate(
        ((pair.image1, pair.keypoints1), (pair.image2, pair.keypoints2)), start=1
    ):
        axes = add_axes(figure, 0.15, 0.45 + (view - 1) * 3.2, 5.7, 2.85)
        if view == 1:
            title = f"two 360° images, {len(pixels)} key points, {len(numbered)} matches numbered"
            write_panel_title(axes, "a", title)
        draw_panorama(axes, image, fade=0.25)
        axes.text(
            0.012, 0.965, f"view {view}", transform=axes.transAxes, fontsize=11, color=INK,
            fontweight="bold", va="top", path_effects=STROKE, zorder=8,
        )  # fmt: skip
        draw_keypoints(axes, pixels, area=9.0)
        _draw_numbers(axes, pixels, numbered)
        both.append(axes)
    for index, colour in zip(numbered, MATCH_COLOURS, strict=False):
        line = ConnectionPatch(
            tuple(pair.keypoints1[index]), tuple(pair.keypoints2[index]), "data", "data",
            axesA=both[0], axesB=both[1], color=colour, linewidth=1.0, alpha=0.9, zorder=2,
        )  # fmt: skip
        figure.add_artist(line)


def _draw_numbers(axes: Axes, points: Array, numbered: NDArray[np.intp]) -> None:
    """Mark some matches of an image; the numbers turn inwards at its right border."""
    border = 0.96 * axes.get_xlim()[1]
    for number, index in enumerate(numbered):
        x, y = points[index]
        _draw_number(axes, number, (x, y), 11, shift=(6 if x < border else -6, 4))


def _draw_number(
    axes: Axes,
    number: int,
    point: tuple[float, float],
    size: float,
    *,
    shift: tuple[float, float],
    facing: bool = True,
) -> None:
    colour = MATCH_COLOURS[number]
    axes.plot(
        *point, "o", markersize=7, color=colour, markeredgecolor="black", zorder=6,
        alpha=1.0 if facing else 0.35,
    )  # fmt: skip
    if facing:
        axes.annotate(
            str(number + 1), point, xytext=shift, textcoords="offset points",
            ha="left" if shift[0] > 0 else "right", color=colour, fontsize=size,
            fontweight="bold", path_effects=DARK_STROKE, zorder=7,
        )  # fmt: skip


def _draw_solids(
    figure: Figure,
    pair: TrackedPair,
    numbered: NDArray[np.intp],
    N: Array,
    left: float,
    title: tuple[str, str],
) -> None:
    eye = Eye()
    for view, bearings in enumerate((pair.bearings1, pair.bearings2)):
        axes = add_axes(figure, left, 0.45 + view * 3.2, 2.4, 2.85)
        draw_ovoid(axes, bearings, N, eye=eye, extent=1.25, area=9.0)
        if view == 0:
            write_panel_title(axes, *title)
        facing = (bearings @ np.linalg.inv(N) @ eye.axes[2]) <= 0.0
        for number, index in enumerate(numbered):
            (x, y), _ = eye.project(N @ bearings[index])
            _draw_number(axes, number, (x, y), 10, shift=(5, 3), facing=bool(facing[index]))


def _draw_pose(figure: Figure, pair: TrackedPair, best: EightPointSolution) -> None:
    """Draw both cameras in the frame of camera 1, the true camera 2 as a ring, some planes."""
    axes = add_axes(figure, 11.75, 0.45, 3.1, 5.2)
    left, top = 11.75 / WIDTH_IN, 1 - 0.37 / HEIGHT_IN
    figure.text(left, top, "(d)  relative pose", fontsize=12, color=INK)
    pose = pose_from_essential(best.E, pair.bearings1, pair.bearings2)
    center2 = pose.inverse().translation
    # Seen from beside the baseline, so that neither camera hides the other.
    eye = Eye(float(np.degrees(np.arctan2(center2[0], center2[2]))) - 65.0, 35.0)
    _draw_planes(axes, eye, pair, pose)
    for name, place, turn in (("1", np.zeros(3), np.eye(3)), ("2", center2, pose.rotation.T)):
        draw_ovoid(
            axes, np.empty((0, 3)), BALL * turn, eye=eye, center=place, extent=None,
            axis_length=0.6,
        )  # fmt: skip
        paper, _ = eye.project(place)
        axes.annotate(
            f"$C_{name}$", tuple(paper), xytext=(-7, 5), textcoords="offset points", fontsize=13,
            ha="right", color=INK, path_effects=STROKE, zorder=8,
        )  # fmt: skip
    _draw_baseline(axes, eye, center2)
    truth = pair.cam2_from_cam1.inverse().translation
    ring, _ = eye.project(truth / np.linalg.norm(truth))
    axes.plot(*ring, "o", markersize=13, markerfacecolor="none", markeredgecolor=VERMILION,
              markeredgewidth=1.6, zorder=9)  # fmt: skip
    axes.set_anchor("C")
    axes.margins(0.06)
    figure.text(
        13.3 / WIDTH_IN, 1 - 5.75 / HEIGHT_IN, _pose_words(pair, pose), fontsize=10, color=INK,
        ha="center", va="top", linespacing=1.5,
    )  # fmt: skip


def _draw_planes(axes: Axes, eye: Eye, pair: TrackedPair, pose: Pose) -> None:
    """Draw epipolar planes of matches with near points, as triangles C1, landmark, C2."""
    points, depths1, depths2 = triangulate(pair.bearings1, pair.bearings2, pose)
    reach = np.where(np.minimum(depths1, depths2) > 0.0, np.maximum(depths1, depths2), np.inf)
    near = np.argsort(reach, kind="stable")[:NUM_NEAREST]
    center2 = pose.inverse().translation
    chosen = near[spread_indices(pair.bearings1[near], NUM_PLANES)]
    for index, colour in zip(chosen, (LANDMARK, "#ff9c1a", "#33b5ff"), strict=False):
        corners, _ = eye.project(np.stack([np.zeros(3), points[index], center2]))
        axes.fill(*corners.T, facecolor=colour, alpha=0.22, zorder=4)
        axes.plot(*corners.T, color=colour, linewidth=1.5, zorder=5)
        axes.plot(*corners[1], "o", color=colour, markersize=8, markeredgecolor=INK, zorder=6)


def _draw_baseline(axes: Axes, eye: Eye, center2: Array) -> None:
    line, _ = eye.project(np.stack([np.zeros(3), center2]))
    axes.plot(*line.T, color=INK, linewidth=1.8, zorder=7)
    axes.plot(*line.T, "o", color=INK, markersize=4, zorder=8)


def _pose_words(pair: TrackedPair, pose: Pose) -> str:
    rotation = rotation_error_deg(pose, pair.cam2_from_cam1)
    translation = translation_error_deg(pose, pair.cam2_from_cam1)
    return (
        "ring: true camera 2;  triangles: epipolar planes\n"
        f"errors: rotation {rotation:.2f}°, translation {translation:.2f}°"
    )


def _draw_step(figure: Figure, left: float, label: str) -> None:
    y = 1 - 3.55 / HEIGHT_IN
    arrow = FancyArrowPatch(
        (left / WIDTH_IN, y), ((left + 0.34) / WIDTH_IN, y), transform=figure.transFigure,
        arrowstyle="-|>", mutation_scale=20, linewidth=2.2, color=BLUE,
    )  # fmt: skip
    figure.add_artist(arrow)
    figure.text(
        (left + 0.17) / WIDTH_IN, y + 0.02, label, ha="center", va="bottom", fontsize=10,
        color=SOFT,
    )  # fmt: skip
