# SPDX-License-Identifier: BSD-3-Clause
"""The Robust 360-8PA paper's own pipeline: 8-point RANSAC, then its weighted gold standard."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from _peers import CannotRunError
from _two_view_answer import Answer
from _two_view_problems import Problem

import epi360
from epi360.poses import Pose

METHOD = "gsm_w_sk"


def paper_functions() -> tuple[Callable[..., Any], Callable[..., Pose]]:
    """RANSAC and pose of the paper.

    Raises
    ------
    CannotRunError
        If this version of the package has them not.
    """
    try:
        # In versions that this one is compared with, RANSAC is a part of epi360.
        home = "epi360_paper" if find_spec("epi360_paper") else "epi360.experiments"
        return import_module(f"{home}.paper_ransac").paper_ransac, epi360.paper_pose
    except (AttributeError, ImportError) as error:
        raise CannotRunError("this epi360 has no paper_ransac or no paper_pose") from error


def paper_pipeline(problem: Problem) -> Callable[[], Answer]:
    """RANSAC on eight-point samples, then the (S, K) normalised weighted gold standard."""
    return partial(_solve, problem, *paper_functions())


def _solve(
    problem: Problem, paper_ransac: Callable[..., Any], paper_pose: Callable[..., Pose]
) -> Answer:
    b1, b2 = problem.bearings1, problem.bearings2
    threshold = float(np.sin(np.radians(problem.cell.gate_deg)))
    rng = np.random.Generator(np.random.PCG64(problem.index))
    inliers = paper_ransac(b1, b2, threshold, rng, residual="paper").inlier_mask
    if np.count_nonzero(inliers) < 8:
        return Answer(Pose.nan(), accepted=False)
    return Answer(paper_pose(b1[inliers], b2[inliers], method=METHOD), accepted=True)
