# SPDX-License-Identifier: BSD-3-Clause
"""Figure of a trajectory beside the truth, and of its errors along the way."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.evaluation import Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TRUTH, ESTIMATE = "0.45", "tab:red"


def evaluation_figure(result: Evaluation) -> Figure:
    """Both ways in the plane in which they extend most, and errors of position and rotation."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    axes_of = figure.subplot_mosaic([["way", "position"], ["way", "rotation"]])
    _draw_ways(axes_of["way"], result)
    position, rotation = axes_of["position"], axes_of["rotation"]
    way = np.concatenate([[0.0], np.cumsum(_steps(result.truth.positions))])
    position.plot(way, result.position_errors_m, color=ESTIMATE, linewidth=1)
    position.set_ylabel("position error, m")
    rotation.plot(way, result.orientation_errors_deg, color=ESTIMATE, linewidth=1)
    rotation.set_ylabel("rotation error, deg")
    rotation.set_xlabel("way, m")
    for axes in (position, rotation):
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    return figure


def _draw_ways(axes: Axes, result: Evaluation) -> None:
    truth, estimate = result.truth.positions, result.estimate.positions
    centre = truth.mean(axis=0)
    plane = np.linalg.svd(truth - centre, full_matrices=False)[2][:2]
    for positions, color, label in ((truth, TRUTH, "truth"), (estimate, ESTIMATE, "estimate")):
        x, y = ((positions - centre) @ plane.T).T
        axes.plot(x, y, color=color, linewidth=1.2, label=label)
    axes.plot(*((truth[:1] - centre) @ plane.T).T, "o", color=TRUTH, label="start")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("m, in the plane of the way")
    axes.grid(alpha=0.3)
    axes.legend()


def _steps(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    steps: NDArray[np.float64] = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return steps
