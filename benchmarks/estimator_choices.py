# SPDX-License-Identifier: BSD-3-Clause
"""Measurements behind docs/estimator.md: last stages, the covariance, scores, gravity, verdicts.

``python benchmarks/estimator_choices.py [PROBLEMS] [--picture FILE]`` prints four Markdown tables,
by default from 1,000 problems a cell (a quarter of that where NumPy does the work, 300 for
verdicts, 100 where times are measured), in some ten minutes on one core.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any

import _one_thread  # noqa: F401 - before NumPy
import numpy as np
from _machine import load_average, machine_facts
from _picture import Entry, add_picture_option, check_picture, panel_of, write_picture
from _summary import Rows, markdown_table
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from epi360 import (
    Pose,
    RelativePoseResult,
    estimate_relative_pose,
    paper_pose,
    refine_pose,
    rotation_error_deg,
    translation_error_deg,
)
from epi360.report.overview import Panel
from epi360.synthetic import TwoViewScene, two_view_scene

Array = NDArray[np.float64]
Stage = Callable[[TwoViewScene, Pose], Pose]

# Noise in view 2 only, as in the paper; kappa = 500 is 2.56 degrees per axis.
STAGE_CELLS = [
    (f"{noise_name}, {100 * ratio:.0f} %", {"layout": "room", "outlier_ratio": ratio, **noise})
    for noise_name, noise in (("0.1°", {"noise_deg": 0.1}), ("κ = 500", {"kappa": 500.0}))
    for ratio in (0.0, 0.2, 0.5)
]
# Noise in both views: what the covariance is defined for.
BOTH: dict[str, Any] = {"layout": "room", "noise_in_both_views": True}
COVARIANCE_CELLS: list[tuple[str, dict[str, Any]]] = [
    ("400, 0 %, 0.1°", {**BOTH, "noise_deg": 0.1}),
    ("400, 20 %, 0.1°", {**BOTH, "noise_deg": 0.1, "outlier_ratio": 0.2}),
    ("400, 50 %, 0.1°", {**BOTH, "noise_deg": 0.1, "outlier_ratio": 0.5}),
    ("1000, 50 %, 0.1°", {**BOTH, "noise_deg": 0.1, "outlier_ratio": 0.5, "num_matches": 1000}),
    ("400, 0 %, 0.5°", {**BOTH, "noise_deg": 0.5}),
    ("400, 30 %, 0.5°", {**BOTH, "noise_deg": 0.5, "outlier_ratio": 0.3}),
    ("400, 70 %, 0.5°", {**BOTH, "noise_deg": 0.5, "outlier_ratio": 0.7}),
    ("400, 50 %, κ = 500", {**BOTH, "kappa": 500.0, "outlier_ratio": 0.5}),
    *(
        (
            f"400, {100 * ratio:.0f} %, {noise}°, baseline 1 m",
            {**BOTH, "noise_deg": noise, "outlier_ratio": ratio, "baseline_m": 1.0},
        )
        for noise, ratio in ((0.1, 0.5), (0.5, 0.3), (0.5, 0.7))
    ),
]
PRIOR_CELLS = ((0.1, 0.5), (0.5, 0.7), (0.5, 0.8))
CONE: dict[str, Any] = {"layout": "cone", "cone_half_angle_deg": 30.0}
ROOM: dict[str, Any] = {"layout": "room"}
VERDICT_CELLS: list[tuple[str, dict[str, Any]]] = [
    ("cone of 30°, 0 %, κ = 500", {**CONE, "kappa": 500.0}),
    ("cone of 30°, 30 %, κ = 500", {**CONE, "kappa": 500.0, "outlier_ratio": 0.3}),
    ("cone of 30°, 30 %, 0.5°", {**CONE, "noise_deg": 0.5, "outlier_ratio": 0.3}),
    ("room, 50 %, κ = 500", {**ROOM, "kappa": 500.0, "outlier_ratio": 0.5}),
    ("room, 80 %, 0.5°", {**ROOM, "noise_deg": 0.5, "outlier_ratio": 0.8}),
    ("room, 85 %, 0.5°", {**ROOM, "noise_deg": 0.5, "outlier_ratio": 0.85}),
    *(
        (f"{name}, 30 %, 0.5°", {**ROOM, "noise_deg": 0.5, "outlier_ratio": 0.3, "baseline_m": b})
        for name, b in (
            ("room, baseline 20 cm", 0.2),
            ("room, baseline 5 cm", 0.05),
            ("room, no baseline", 0.0),
        )
    ),
    ("one plane, 30 %, 0.5°", {"layout": "plane", "noise_deg": 0.5, "outlier_ratio": 0.3}),
    ("random matches", {**ROOM, "outlier_ratio": 1.0}),
]
WRONG_DEG = 10.0


def main() -> int:
    """Print the tables; exit code 2 for wrong use."""
    parser = argparse.ArgumentParser(description="Measurements behind docs/estimator.md.")
    parser.add_argument("problems", type=int, nargs="?", default=1000, help="of a cell (1000)")
    add_picture_option(parser)
    options = parser.parse_args()
    num_problems = options.problems
    try:
        if num_problems < 1:
            raise ValueError(f"PROBLEMS must be at least 1, got {num_problems}")
        check_picture(options.picture)
    except ValueError as error:
        print(f"estimator_choices.py: {error}", file=sys.stderr)
        return 2
    facts = machine_facts(())
    sections: tuple[tuple[str, Callable[[int], Rows], int], ...] = (
        ("Median error over the oracle's: rotation / direction", last_stages, num_problems),
        ("Mean of error^2 over the covariance, divided by 5", covariances, num_problems),
        ("Samples, milliseconds, median direction error, poses over 5 degrees or none", priors,
         max(num_problems // 10, 1)),
        ("Verdicts", verdicts, max(3 * num_problems // 10, 1)),
    )  # fmt: skip
    tables = []
    for title, make, count in sections:
        tables.append(make(count))
        print(f"\n{title}\n\n{markdown_table(tables[-1])}", flush=True)
    facts["load_average_at_end"] = load_average()
    title = "Choices of the robust estimator"
    remark = "Colours and rows name matches, outliers in percent and noise in degrees."
    write_picture(options.picture, title, _panels(*tables), facts, columns=2, remark=remark)
    return 0


def _panels(stages: Rows, covariance: Rows, prior: Rows, verdict: Rows) -> list[Panel]:
    """The tables as dots; cells with several numbers give one panel a number."""

    def entries(table: Rows, number: int = 0, columns: slice = slice(1, None)) -> list[Entry]:
        return [
            (row[0].replace("`", ""), name.replace("`", ""), _numbers(cell)[number])
            for row in table[1:]
            for name, cell in list(zip(table[0], row, strict=True))[columns]
            if _numbers(cell)
        ]

    outcomes = entries(verdict, 0, slice(1, 7))
    return [
        panel_of("Last stages: rotation error", "times the oracle's", entries(stages), powers=True),
        panel_of("Last stages: direction error", "times the oracle's", entries(stages, 1),
                 powers=True),
        panel_of("Squared error over the covariance", "1 is calibrated", entries(covariance),
                 powers=True, aim=1.0),
        panel_of("Verdicts on hard problems", "problems", outcomes),
        panel_of("What scores and gravity save: samples", "samples drawn", entries(prior),
                 powers=True),
        panel_of("What scores and gravity save: poses over 5° or none", "%", entries(prior, 3)),
    ]  # fmt: skip


def _numbers(cell: str) -> list[float]:
    return [float(word) for word in re.findall(r"\d+(?:\.\d+)?", cell)]


def last_stages(num_problems: int) -> list[list[str]]:
    """Table: a row for each last stage, a column for each cell."""
    columns = []
    for _, options in STAGE_CELLS:
        scenes = _scenes(num_problems, 400, options)
        fewer = scenes[: max(num_problems // 4, 1)]
        oracle = _errors(scenes, lambda scene, truth: _on(scene, truth, scene.inlier_mask))
        column = [_over(_errors(scenes, stage), oracle) for stage in _NATIVE.values()]
        column += [_over(_errors(fewer, stage), oracle) for stage in _NUMPY.values()]
        columns.append(column)
    rows = [
        [name, *(column[k] for column in columns)] for k, name in enumerate((*_NATIVE, *_NUMPY))
    ]
    return [["", *(name for name, _ in STAGE_CELLS)], *rows]


def covariances(num_problems: int) -> list[list[str]]:
    """Table of normalised errors, with all poses and without the worst hundredth."""
    table = [["matches, outliers, noise", "mean", "without the worst 1 %", "median / its value"]]
    for name, options in COVARIANCE_CELLS:
        scenes = _scenes(num_problems, 400, options)
        found = [estimate_relative_pose(s.bearings1, s.bearings2) for s in scenes]
        values = np.sort(
            [_normalised(f, s) for f, s in zip(found, scenes, strict=True) if f.success]
        )
        most = values[: len(values) - max(len(values) // 100, 1)]
        # 4.351 is the median of chi^2 with 5 degrees of freedom.
        middle = np.median(values) * 5.0 / 4.351
        table.append([name, f"{values.mean():.2f}", f"{most.mean():.2f}", f"{middle:.2f}"])
    return table


def priors(num_problems: int) -> list[list[str]]:
    """Table of what scores and gravity save."""
    table = [["", *(f"400, {100 * ratio:.0f} %, {noise}°" for noise, ratio in PRIOR_CELLS)]]
    for name, extra in (("neither", _nothing), ("scores", _scores), ("gravity", _gravity)):
        row = [name]
        for noise, ratio in PRIOR_CELLS:
            options = {**BOTH, "noise_deg": noise, "outlier_ratio": ratio}
            row.append(_measured(_scenes(num_problems, 400, options), extra))
        table.append(row)
    return table


def verdicts(num_problems: int) -> list[list[str]]:
    """Table of what was said of hard problems, and how often it was wrong."""
    table = [
        ["400 matches", "ok", "wrong", "`planar_ambiguous`", "truth among both", "`pure_rotation`"]
        + ["none", "median error of ok"]
    ]
    for name, options in VERDICT_CELLS:
        scenes = _scenes(num_problems, 400, options)
        found = [estimate_relative_pose(s.bearings1, s.bearings2) for s in scenes]
        both = [(f, _distances(f, s)) for f, s in zip(found, scenes, strict=True)]
        accepted = [distances[0] for f, distances in both if f.success]
        named = [distances for f, distances in both if f.status == "planar_ambiguous"]
        wrong = sum(max(distance) > WRONG_DEG for distance in accepted)
        among = sum(any(max(d) <= WRONG_DEG for d in distances) for distances in named)
        turned = sum(f.status == "pure_rotation" for f in found)
        none = len(found) - len(accepted) - len(named) - turned
        medians = np.median(accepted, axis=0) if accepted else ()
        table.append(
            [name, f"{len(accepted)}", f"{wrong}", f"{len(named)}", f"{among}", f"{turned}"]
            + [f"{none}", " / ".join(f"{value:.2f}°" for value in medians) or "-"]
        )
    return table


def _distances(found: RelativePoseResult, scene: TwoViewScene) -> list[tuple[float, float]]:
    """Rotation and direction errors of the pose and its alternatives."""
    truth = scene.cam2_from_cam1
    return [
        (rotation_error_deg(pose, truth), translation_error_deg(pose, truth))
        for pose in (found.cam2_from_cam1, *found.alternatives)
    ]


def _scenes(num_problems: int, num_matches: int, options: dict[str, Any]) -> list[TwoViewScene]:
    return [
        two_view_scene(seed, **{"num_matches": num_matches, **options})
        for seed in range(num_problems)
    ]


def _on(scene: TwoViewScene, start: Pose, chosen: NDArray[np.bool_], **options: Any) -> Pose:
    b1, b2 = scene.bearings1[chosen], scene.bearings2[chosen]
    return refine_pose(b1, b2, start, "sampson", **options).pose


def _refined(**options: Any) -> Stage:
    """Last stage that starts at the truth and sees all matches."""
    return lambda scene, truth: _on(scene, truth, np.full(len(scene.points), True), **options)


def _estimated(scene: TwoViewScene, truth: Pose) -> Pose:
    return estimate_relative_pose(scene.bearings1, scene.bearings2).cam2_from_cam1


def _least_squares_on_inliers(scene: TwoViewScene, truth: Pose) -> Pose:
    found = estimate_relative_pose(scene.bearings1, scene.bearings2)
    if not found.success:
        return found.cam2_from_cam1
    return _on(scene, found.cam2_from_cam1, found.inlier_mask)


def _of_the_paper(method: str) -> Stage:
    return lambda scene, truth: paper_pose(scene.bearings1, scene.bearings2, method=method)


_NATIVE: dict[str, Stage] = {
    "squared": _refined(loss="squared"),
    "Huber": _refined(loss="huber"),
    "Cauchy": _refined(loss="cauchy"),
    "Geman-McClure": _refined(loss="geman_mcclure"),
    "scale mixture": _refined(loss="mixture"),
    "`gsm_w_sk`": _of_the_paper("gsm_w_sk"),
    "`gsm_irls_sk`": _of_the_paper("gsm_irls_sk"),
    "`estimate_relative_pose`": _estimated,
    "... then squared on its inliers": _least_squares_on_inliers,
}
_NUMPY: dict[str, Stage] = {
    "IRLS, Gaussian": _refined(reweight="gaussian"),
    "IRLS, Student t": _refined(reweight="student_t"),
    "IRLS, Gaussian + uniform": _refined(reweight="mixture"),
}


def _errors(scenes: Iterable[TwoViewScene], stage: Stage) -> Array:
    """Rotation and direction errors in degrees; no pose counts as 180."""
    rows = []
    for scene in scenes:
        truth = scene.cam2_from_cam1
        start = Pose(truth.rotation, truth.translation / np.linalg.norm(truth.translation))
        pose = stage(scene, start)
        rows.append((rotation_error_deg(pose, truth), translation_error_deg(pose, truth)))
    return np.asarray(np.nan_to_num(np.array(rows), nan=180.0))


def _over(errors: Array, oracle: Array) -> str:
    ratios = np.median(errors, axis=0) / np.median(oracle[: len(errors)], axis=0)
    return " / ".join(f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}" for ratio in ratios)


def _normalised(found: RelativePoseResult, scene: TwoViewScene) -> float:
    """Squared error in units of the covariance, over its expected value."""
    pose, truth = found.cam2_from_cam1, scene.cam2_from_cam1
    turn = Rotation.from_matrix(truth.rotation @ pose.rotation.T).as_rotvec()
    t = truth.translation / np.linalg.norm(truth.translation)
    error = np.append(turn, found.translation_basis.T @ t / (pose.translation @ t))
    return float(error @ np.linalg.solve(found.covariance, error)) / 5.0


def _nothing(scene: TwoViewScene, rng: np.random.Generator) -> dict[str, Any]:
    return {}


def _scores(scene: TwoViewScene, rng: np.random.Generator) -> dict[str, Any]:
    """Scores of right and wrong matches, one standard deviation apart."""
    return {"match_scores": scene.inlier_mask + rng.normal(size=len(scene.points))}


def _gravity(scene: TwoViewScene, rng: np.random.Generator) -> dict[str, Any]:
    """Down in both cameras, wrong by about two degrees per axis."""
    down = np.array([0.0, 1.0, 0.0])
    names = {"gravity1": down, "gravity2": scene.cam2_from_cam1.rotation @ down}
    return {name: g + np.radians(2.0) * rng.normal(size=3) for name, g in names.items()}


def _measured(
    scenes: list[TwoViewScene],
    extra: Callable[[TwoViewScene, np.random.Generator], dict[str, Any]],
) -> str:
    rows = []
    for seed, scene in enumerate(scenes):
        known = extra(scene, np.random.default_rng(seed))
        began = time.process_time()
        found = estimate_relative_pose(scene.bearings1, scene.bearings2, **known)
        spent = 1e3 * (time.process_time() - began)
        error = translation_error_deg(found.cam2_from_cam1, scene.cam2_from_cam1)
        rows.append((found.num_iterations, spent, np.nan_to_num(error, nan=180.0)))
    samples, spent, error = np.median(rows, axis=0)
    failed = np.mean(np.array(rows)[:, 2] > 5.0)
    return f"{samples:.0f}, {spent:.1f} ms, {error:.2f}°, {100 * failed:.0f} %"


if __name__ == "__main__":
    sys.exit(main())
