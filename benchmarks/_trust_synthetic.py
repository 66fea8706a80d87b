# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on synthetic cells (rotation, plane, patch, cone, small base, random), in counts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from _peers import pycolmap_two_view
from _trust_cameras import CAMERAS, make_camera_matches
from _trust_degenerate import KINDS, make_degenerate
from _trust_records import RIGHT_DEG, WRONG_DEG
from _two_view_answer import Answer, errors_deg, normalised_squared_error
from _two_view_methods import answer_from_result
from _two_view_problems import cell_from_name, make_problem
from numpy.typing import NDArray

from epi360 import estimate_relative_pose
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.poses import Pose

CELLS = (
    "rotation-400-0-0.5",
    "rotation-400-30-0.5",
    "rotation-400-50-0.5",
    "cone-400-0-k500",
    "cone-400-30-k500",
    "near-400-0-k500",
    "near-400-0-0.1",
    "near-400-30-0.5",
    "plane-400-30-0.5",
    "patch-100-60-0.1",
    "uniform-400-100-0.1",
)
OURS, PEER = "epi360", "pycolmap, given gate"
ROTATION_WORDS = ("pure_rotation", "panoramic", "planar_or_panoramic")


@dataclass(frozen=True)
class Trial:
    """One verdict on synthetic matches.

    Attributes
    ----------
    kind, method, status : str
    accepted : bool
    error_deg : float
        The larger of both errors; NaN where there is no truth.
    has_bad_covariance : bool
        Whether a covariance is stated that is not finite with positive eigenvalues, or an accepted
        pose comes without one.
    probability : float
        As stated, or NaN.
    squared_error : float
        Squared error over the stated covariance, of five degrees of freedom: 1 is calibrated.
    """

    kind: str
    method: str
    status: str
    accepted: bool
    error_deg: float
    has_bad_covariance: bool = False
    probability: float = math.nan
    squared_error: float = math.nan


def cell_trials(num_trials: int, seed: int, jobs: int, *, with_peer: bool) -> Iterator[Trial]:
    """Trials of all cells."""
    tasks = [(name, index) for name in CELLS for index in range(num_trials)]
    yield from _on_processes(partial(_cell_trial, seed=seed, is_peer=False), tasks, jobs)
    if with_peer:
        yield from _on_processes(partial(_cell_trial, seed=seed, is_peer=True), tasks, jobs)


def degenerate_trials(num_trials: int, seed: int, jobs: int) -> Iterator[Trial]:
    """Trials of all kinds of degenerate data, by ourselves alone."""
    tasks = [(name, index) for name in KINDS for index in range(num_trials)]
    yield from _on_processes(partial(_degenerate_trial, seed=seed), tasks, jobs)


def camera_trials(num_trials: int, seed: int, jobs: int) -> Iterator[Trial]:
    """Trials of what real cameras do, with the options of image pairs, by ourselves alone."""
    tasks = [(name, index) for name in CAMERAS for index in range(num_trials)]
    yield from _on_processes(partial(_camera_trial, seed=seed), tasks, jobs)


def trial_rows(trials: Iterable[Trial]) -> list[list[str]]:
    """Table of counts for each kind and method."""
    groups: dict[tuple[str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.kind, trial.method), []).append(trial)
    header = ["data", "method", "trials", "ok", "ok, right", "ok, wrong", "pure rotation"]
    rows = [[*header, "bad covariances", "squared error / sigma", "other verdicts"]]
    for (kind, method), group in groups.items():
        ok = [trial for trial in group if trial.accepted]
        right = sum(trial.error_deg < RIGHT_DEG for trial in ok)
        # Where there is no pose to find, every accepted one is wrong.
        wrong = sum(not trial.error_deg <= WRONG_DEG for trial in ok)
        words = Counter(trial.status for trial in group if not trial.accepted)
        rotations = sum(words.pop(word, 0) for word in ROTATION_WORDS)
        bad = sum(trial.has_bad_covariance for trial in group)
        known = [trial.squared_error for trial in ok if math.isfinite(trial.squared_error)]
        others = ", ".join(f"{count} {word}" for word, count in words.most_common()) or "-"
        counts = map(str, (len(group), len(ok), right, wrong, rotations, bad))
        rows.append([kind, method, *counts, f"{np.median(known):.2f}" if known else "-", others])
    return rows


def _cell_trial(task: tuple[str, int], *, seed: int, is_peer: bool) -> Trial:
    name, index = task
    problem = make_problem(cell_from_name(name), index, seed)
    if is_peer:
        return _trial(name, PEER, pycolmap_two_view(problem)(), problem.cam2_from_cam1)
    result = estimate_relative_pose(problem.bearings1, problem.bearings2, seed=index)
    answer = answer_from_result(result)
    return _trial(name, OURS, answer, problem.cam2_from_cam1, result.probability)


def _degenerate_trial(task: tuple[str, int], *, seed: int) -> Trial:
    name, index = task
    data = make_degenerate(name, index, seed)
    try:
        result = estimate_relative_pose(
            data.bearings1, data.bearings2, seed=index, **data.arguments
        )
    except ValueError:
        return Trial(name, OURS, "ValueError", accepted=False, error_deg=math.nan)
    return _trial(name, OURS, answer_from_result(result), data.cam2_from_cam1, result.probability)


def _camera_trial(task: tuple[str, int], *, seed: int) -> Trial:
    name, index = task
    data = make_camera_matches(name, index, seed)
    result = estimate_relative_pose(
        data.bearings1, data.bearings2, seed=index, options=IMAGE_OPTIONS
    )
    answer, truth = answer_from_result(result), data.cam2_from_cam1
    trial = _trial(name, OURS, answer, truth, result.probability)
    if result.status == "pure_rotation" and not errors_deg(answer.cam2_from_cam1, truth)[0] < 1.0:
        return replace(trial, status="another rotation")
    return trial


def _trial(
    kind: str, method: str, answer: Answer, truth: Pose, probability: float = math.nan
) -> Trial:
    errors = errors_deg(answer.cam2_from_cam1, truth)
    return Trial(
        kind,
        method,
        answer.status,
        answer.accepted,
        math.nan if any(map(math.isnan, errors)) else max(errors),
        method == OURS and _is_bad(answer.covariance, answer.accepted),
        float(probability),
        normalised_squared_error(answer, truth),
    )


def _is_bad(covariance: NDArray[np.float64], accepted: bool) -> bool:
    """Whether a covariance is not that of anything; without an accepted pose NaN is no answer."""
    stated = covariance[~np.isnan(covariance).all(axis=1)]
    stated = stated[:, ~np.isnan(covariance).all(axis=0)]
    if stated.size == 0:
        return accepted
    if accepted and stated.shape != covariance.shape:
        return True
    return not (np.isfinite(stated).all() and np.linalg.eigvalsh(stated).min() > 0.0)


def _on_processes(
    judge: Callable[[tuple[str, int]], Trial], tasks: Sequence[tuple[str, int]], jobs: int
) -> Iterator[Trial]:
    with ProcessPoolExecutor(jobs) as pool:
        yield from pool.map(judge, tasks, chunksize=16)
