# SPDX-License-Identifier: BSD-3-Clause
"""Fig. 1: the key points of a panorama, from above, on the sphere and on the ovoid."""

from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from epi360.epipolar import EightPointSolution, pose_from_essential, stability
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.progress import Progress
from epi360_paper.options import Outcome, ReproduceOptions
from epi360_paper.ovoid_plots import draw_ovoid
from epi360_paper.parts import Trials
from epi360_paper.plots import (
    SOFT,
    add_axes,
    draw_keypoints,
    draw_panorama,
    draw_top_view,
    new_figure,
    png_of,
    write_panel_title,
)
from epi360_paper.results import markdown_table, save_outcome
from epi360_paper.tracked_pair import TrackedPair, pair_line, ratio_of, solutions, track_pair
from epi360_scenes import scene

Array = NDArray[np.float64]

TITLE = "Fig. 1: distribution of the key points of a panorama"


def run(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Make figure 1 from a rendered pair: key points, top view, unit sphere, ovoid."""
    room = scene("studio", options.seed)
    pair = track_pair(room, options, partial(progress, "fig1"))
    unit, best = solutions(pair)
    outcome = save_outcome(
        "fig1",
        TITLE,
        pair_line(options),
        [_words(best), _table(pair, unit, best)],
        Trials(_columns(pair, best)),
        options,
        figure=png_of(_draw(pair, best)),
    )
    progress("fig1", 1, 1)
    return outcome


def _columns(pair: TrackedPair, best: EightPointSolution) -> dict[str, Any]:
    parts = {
        "pixel1": (pair.keypoints1, "uv"),
        "pixel2": (pair.keypoints2, "uv"),
        "landmark": (pair.landmarks, "xyz"),
        "bearing1": (pair.bearings1, "xyz"),
        "ovoid1": (pair.bearings1 @ best.normalizer1.T, "xyz"),
    }
    named = {
        f"{name}_{letter}": values[:, index]
        for name, (values, letters) in parts.items()
        for index, letter in enumerate(letters)
    }
    return {"keypoint": np.arange(len(pair.keypoints1)), **named}


def _words(best: EightPointSolution) -> str:
    ratio = ratio_of(best)
    return (
        f"The search ends at K/S = {ratio:.3f} (E depends on this ratio alone; the longer "
        "semi-axis of the drawn ovoid is 1). "
        "The paper says that the ovoid widens the angles between the key points; the rows below "
        "say what it did here."
    )


def _table(pair: TrackedPair, unit: EightPointSolution, best: EightPointSolution) -> str:
    rows = [_row("unit sphere", pair, unit, np.eye(3)), _row("ovoid", pair, best, best.normalizer1)]
    heading = [
        "", "K/S", "internal angle, quartiles (deg)", "widened pairs (%)", "sigma_8 / sigma_1",
        "rotation error (deg)", "translation error (deg)",
    ]  # fmt: skip
    return markdown_table(heading, rows)


def _row(name: str, pair: TrackedPair, solution: EightPointSolution, N: Array) -> list[str]:
    before, after = _internal_angles_deg(pair, N)
    pose = pose_from_essential(solution.E, pair.bearings1, pair.bearings2)
    singular = solution.singular_values
    return [
        name,
        f"{N[2, 2] / N[0, 0]:.3f}",
        " / ".join(f"{angle:.1f}" for angle in np.percentile(after, [25, 50, 75])),
        f"{100.0 * np.mean(after > before):.0f}",
        f"{singular[7] / singular[0]:.3f}",
        f"{rotation_error_deg(pose, pair.cam2_from_cam1):.3f}",
        f"{translation_error_deg(pose, pair.cam2_from_cam1):.3f}",
    ]


def _internal_angles_deg(pair: TrackedPair, N: Array) -> tuple[Array, Array]:
    pairs = np.triu_indices(len(pair.bearings1), 1)
    measured = [
        stability(pair.bearings1, pair.bearings2, normalization)
        for normalization in ("none", (float(N[0, 0]), float(N[2, 2])))
    ]
    before, after = (np.degrees(each.internal_angles_rad()[0][pairs]) for each in measured)
    return before, after


def _draw(pair: TrackedPair, best: EightPointSolution) -> Figure:
    figure = new_figure(14.0, 10.2)
    axes = add_axes(figure, 0.15, 0.45, 9.0, 4.5)
    write_panel_title(axes, "a", f"360° image with {len(pair.keypoints1)} key points")
    draw_panorama(axes, pair.image1)
    draw_keypoints(axes, pair.keypoints1)
    axes = add_axes(figure, 9.75, 0.45, 4.15, 4.1)
    write_panel_title(axes, "b", "top view: point cloud, landmarks, camera")
    draw_top_view(axes, pair.image1, pair.points1, pair.landmarks)
    axes.set_anchor("NW")
    N, extent = best.normalizer1, 1.2
    axes = add_axes(figure, 0.8, 5.55, 5.8, 4.2)
    write_panel_title(axes, "c", "landmarks on the unit sphere")
    draw_ovoid(axes, pair.bearings1, extent=extent, area=36.0)
    axes = add_axes(figure, 7.4, 5.55, 5.8, 4.2)
    write_panel_title(axes, "d", f"the same on the ovoid $Nq$ with $K/S$ = {ratio_of(best):.2f}")
    draw_ovoid(axes, pair.bearings1, N / np.abs(N).max(), extent=extent, area=36.0)
    figure.text(0.5, 0.01, _caption(pair, N), fontsize=11, color=SOFT, ha="center", va="bottom")
    return figure


def _caption(pair: TrackedPair, N: Array) -> str:
    before, after = _internal_angles_deg(pair, N)
    return (
        f"Angle between two key points, median: {np.median(before):.1f}° on the sphere, "
        f"{np.median(after):.1f}° on the ovoid; wider for {100 * np.mean(after > before):.0f} % "
        "of the pairs"
    )
