# SPDX-License-Identifier: BSD-3-Clause
"""Fig. 4: errors against the number of points (a), the noise (b) and the outliers (c)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from epi360.progress import Progress
from epi360.synthetic import mean_angle_deg_from_kappa
from epi360_paper.fig4_curves import Curves, csv_of_curves, draw_curves
from epi360_paper.methods import LEGENDS, METHODS, TITLES, method_errors
from epi360_paper.options import Outcome, ProtocolName, ReproduceOptions
from epi360_paper.parts import Row, Trials
from epi360_paper.protocols import PROTOCOLS, draw_scene
from epi360_paper.results import Compared, comparison_table, markdown_table, run_line, save_outcome
from epi360_paper.trials import Trial, run_trials

# Section 5.1: "the results of 15K evaluations".
PAPERS_TRIALS = 15_000
KAPPA = 500.0
NUM_POINTS = (8, 200)
OUTLIER_RATIO = 0.2
OUTLIER_RATIOS = tuple(step / 10 for step in range(8))
# Panel (a) draws the number of points; its curve has one value for each of these ranges, which
# hold their first number and not their last.
POINT_BINS = (8, 16, 32, 48, 64, 96, 128, 160, 201)
# Gains that the paper claims in words, in percent of the error: (better, worse).
PAPERS_REDUCTION = {("opt_sk", "8pa"): 20.0, ("gsm_w_sk", "gsm_w_xi"): 10.0}

# Orders that the paper claims: (better, worse).
CLAIMED_BETTER = (*PAPERS_REDUCTION, ("gsm_w_xi", "gsm"), ("gsm_w_sk", "gsm"))


@dataclass(frozen=True)
class Level:
    """One point of a panel's horizontal axis."""

    protocol: ProtocolName
    # The number of points is drawn from this range, both ends included.
    num_points: tuple[int, int] = (200, 200)
    kappa: float = KAPPA  # concentration of the noise
    outlier_ratio: float = 0.0  # nominal share of outliers


def run_a(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Make panel (a): 8 to 200 points, 20 % outliers."""
    cells = {"20%": Level(options.protocol, NUM_POINTS, outlier_ratio=OUTLIER_RATIO)}
    trials = _run("fig4a", cells, options, progress)
    groups = {}
    for first, stop in zip(POINT_BINS, POINT_BINS[1:], strict=False):
        inside = (trials["num_points"] >= first) & (trials["num_points"] < stop)
        if inside.any():
            columns = {name: values[inside] for name, values in trials.columns.items()}
            groups[f"{first}–{stop - 1}"] = Trials(columns)
    return _report("fig4a", "number of points", groups, trials, options)


def run_b(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Make panel (b): levels of noise, 200 points, no outliers."""
    levels = PROTOCOLS[options.protocol].noise_levels
    cells = {f"{level.kappa:g}": Level(options.protocol, kappa=level.kappa) for level in levels}
    trials = _run("fig4b", cells, options, progress)
    groups = {}
    for level in levels:
        name = f"κ {level.kappa:g}"
        if PROTOCOLS[options.protocol].noise == "bearings":  # in metres, noise has no angle
            name += f" ({mean_angle_deg_from_kappa(level.kappa):.2f}°)"
        groups[name] = trials.where(cell=f"{level.kappa:g}")
    return _report("fig4b", "noise", groups, trials, options)


def run_c(options: ReproduceOptions, progress: Progress) -> Outcome:
    """Make panel (c): 0 to 70 % outliers, 200 points."""
    cells = {
        f"{100 * ratio:.0f}%": Level(options.protocol, outlier_ratio=ratio)
        for ratio in OUTLIER_RATIOS
    }
    trials = _run("fig4c", cells, options, progress)
    groups = {key.replace("%", " %"): trials.where(cell=key) for key in cells}
    return _report("fig4c", "outliers", groups, trials, options)


def evaluate(level: Level, trial: Trial) -> Row:
    """Errors of the five methods on one random scene."""
    protocol = PROTOCOLS[level.protocol]
    scene_rng, (least, most) = trial.scene_rng(), level.num_points
    num_points = int(scene_rng.integers(least, most + 1))
    scene = draw_scene(
        protocol, num_points, level.kappa, level.outlier_ratio, scene_rng, trial.rng()
    )
    errors = method_errors(
        METHODS, scene.bearings1, scene.bearings2, scene.cam2_from_cam1, protocol
    )
    share = 1.0 - float(scene.inlier_mask.mean())
    return {"num_points": num_points, "outlier_share": share, **errors}


def _run(
    name: str, cells: Mapping[str, Level], options: ReproduceOptions, progress: Progress
) -> Trials:
    count = options.num_trials(PAPERS_TRIALS)
    return run_trials(name, cells, evaluate, count, options, progress)


def _report(
    name: str, axis: str, groups: Mapping[str, Trials], trials: Trials, options: ReproduceOptions
) -> Outcome:
    curves = Curves.from_trials(axis, groups, METHODS)
    return save_outcome(
        name,
        f"Fig. 4 ({name[-1]}): errors against the {axis}",
        run_line(options, options.num_trials(PAPERS_TRIALS), trials),
        _sections(curves, groups),
        trials,
        options,
        tables={"curves.csv": csv_of_curves(curves)},
        figure=draw_curves(curves, LEGENDS),
    )


def _sections(curves: Curves, groups: Mapping[str, Trials]) -> list[str]:
    heading = [curves.axis, "true outliers", *(f"{TITLES[m]} R / T" for m in METHODS)]
    rows = [
        [
            name,
            f"{100 * group['outlier_share'].mean():.1f} %",
            *(
                f"{curves.median('rotation', m)[i]:.2f} / {curves.median('translation', m)[i]:.2f}"
                for m in METHODS
            ),
        ]
        for i, (name, group) in enumerate(groups.items())
    ]
    return [
        "Our medians of rotation and translation error (eq. 16) in 1e-3; the paper prints curves, "
        "no numbers.",
        markdown_table(heading, rows),
        "Reduction of the median error in percent; the paper's numbers are those of its text "
        "(abstract: about 20 %; section 5.1: around 10 %), for no stated point of a curve.",
        _reductions(curves),
        _orders(curves),
    ]


def _reductions(curves: Curves) -> str:
    columns = [
        f"{TITLES[method]} vs {TITLES[baseline]}, {letter}"
        for method, baseline in PAPERS_REDUCTION
        for letter in ("R", "T")
    ]
    rows = {
        level: [
            Compared(papers, _percent_less(curves, i, kind, method, baseline))
            for (method, baseline), papers in PAPERS_REDUCTION.items()
            for kind in ("rotation", "translation")
        ]
        for i, level in enumerate(curves.levels)
    }
    return comparison_table(curves.axis, columns, rows, formats=[".0f"] * len(columns))


def _percent_less(curves: Curves, level: int, kind: str, method: str, baseline: str) -> float:
    ratio = curves.median(kind, method)[level] / curves.median(kind, baseline)[level]
    return float(np.round(100.0 * (1.0 - ratio))) + 0.0  # no "-0"


def _orders(curves: Curves) -> str:
    found = []
    for method, baseline in CLAIMED_BETTER:
        better = [
            int(np.sum(curves.median(kind, method) < curves.median(kind, baseline)))
            for kind in ("rotation", "translation")
        ]
        found.append(f"{TITLES[method]} before {TITLES[baseline]} {better[0]} / {better[1]}")
    return (
        f"Levels, of {len(curves.levels)}, at which the median of R / T is smaller: "
        f"{'; '.join(found)}."
    )
