# SPDX-License-Identifier: BSD-3-Clause
"""Methods of the two-view benchmark behind one interface: ours, the oracle, the paper's pipeline.

A method is a function from a problem to a function without arguments: what the first does
(pixels of a camera, choice of matches) is not timed, what the second does is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from _paper_pipeline import paper_functions, paper_pipeline
from _peers import (
    CannotRunError,
    opencv_front,
    panorai_pose,
    poselib_front,
    pycolmap_essential,
    pycolmap_pose,
    pycolmap_two_view,
)
from _two_view_answer import Answer
from _two_view_problems import Problem
from numpy.typing import NDArray

import epi360
from epi360.estimation import RelativePoseResult
from epi360.poses import Pose

Method = Callable[[Problem], Callable[[], Answer]]

ORACLE = "oracle"
OURS_AUTO = "epi360 auto"
OURS_FIXED = "epi360 fixed"
FAST_PEER = "pycolmap essential"


def epi360_auto(problem: Problem) -> Callable[[], Answer]:
    """`epi360.estimate_relative_pose` with its defaults."""
    return partial(_ours, problem, "auto")


def epi360_fixed(problem: Problem) -> Callable[[], Answer]:
    """`epi360.estimate_relative_pose` with the gate that the peers get."""
    return partial(_ours, problem, problem.cell.gate_deg)


def _ours(problem: Problem, threshold: Any) -> Answer:
    result = epi360.estimate_relative_pose(
        problem.bearings1,
        problem.bearings2,
        inlier_threshold_deg=threshold,
        seed=problem.index,
    )
    return answer_from_result(result)


def answer_from_result(result: RelativePoseResult) -> Answer:
    """Answer of the package's own result."""
    return Answer(
        result.cam2_from_cam1,
        accepted=result.success,
        status=result.status,
        has_warnings=bool(result.warnings),
        alternatives=result.alternatives,
        covariance=result.covariance,
        translation_basis=result.translation_basis,
    )


def oracle(problem: Problem) -> Callable[[], Answer]:
    """Maximum likelihood on the true inliers, started at the truth: the floor of the errors."""
    b1, b2 = problem.bearings1[problem.inlier_mask], problem.bearings2[problem.inlier_mask]
    if not problem.cell.has_truth:
        return lambda: Answer(Pose.nan(), accepted=False)
    if not problem.cell.has_direction:
        return partial(_best_rotation, b1, b2)
    return partial(_most_likely_pose, b1, b2, problem.cam2_from_cam1)


def _most_likely_pose(b1: NDArray[Any], b2: NDArray[Any], start: Pose) -> Answer:
    found = epi360.refine_pose(b1, b2, start, residual="sampson", loss="squared")
    return Answer(found.pose, accepted=True)


def _best_rotation(b1: NDArray[Any], b2: NDArray[Any]) -> Answer:
    """Rotation of most likely bearings under von Mises-Fisher noise (Wahba's problem, by SVD)."""
    U, _, Vt = np.linalg.svd(b2.T @ b1)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Answer(Pose(R, np.full(3, np.nan)), accepted=False, status="pure_rotation")


# Everything that can be compared, in the order of the tables.
METHODS: dict[str, Method] = {
    ORACLE: oracle,
    OURS_AUTO: epi360_auto,
    OURS_FIXED: epi360_fixed,
    FAST_PEER: pycolmap_essential,
    "pycolmap pose": pycolmap_pose,
    "pycolmap two-view": pycolmap_two_view,
    "poselib front": poselib_front,
    "opencv front": opencv_front,
    "panorai": panorai_pose,
    "paper": paper_pipeline,
}
REMARKS = {
    ORACLE: "maximum likelihood (squared Sampson residuals) on the true inliers, started at the "
    "truth; for pure rotations the best rotation",
    OURS_AUTO: 'inlier_threshold_deg="auto", all defaults',
    OURS_FIXED: "inlier_threshold_deg = the gate, all other defaults",
    FAST_PEER: "estimate_essential_matrix, tangent Sampson in pixels of a panorama 4096 px wide "
    "(an equidistant fisheye), min_num_trials 20, confidence 0.99, the gate; no verdict",
    "pycolmap pose": "estimate_relative_pose on pixels, the same settings; no verdict",
    "pycolmap two-view": "estimate_calibrated_two_view_geometry, the same settings; accepts what "
    "has a translation",
    "poselib front": "estimate_relative_pose of a pinhole camera, only matches with z > 0 in both "
    "views, min_iterations 20, success_prob 0.99, the gate; no verdict",
    "opencv front": "findEssentialMat (USAC_MAGSAC, 0.99, the gate) and recoverPose, only matches "
    "with z > 0 in both views; no verdict",
    "panorai": "estimators.estimate_relative_pose, confidence 0.99, the gate, else its defaults "
    "(1000 samples); accepts what its own policy accepts",
    "paper": "RANSAC on 8-point samples with the residual of eq. 13 and the gate, at most 1177 "
    "samples, confidence 0.99; then gsm_w_sk (opt_sk, weighted gold standard) on the inliers",
}


def usable_methods(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names of the methods that can run here, and why the others cannot."""
    probes = {
        **{name: partial(_import, "pycolmap") for name in METHODS if name.startswith("pycolmap")},
        "poselib front": partial(_import, "poselib"),
        # Its dependencies would hold OpenCV below 5, and its estimator needs none but NumPy.
        "panorai": partial(_import, "panorai", "pip install --no-deps panorai"),
        "paper": paper_functions,
    }
    usable, missing = [], []
    for name in names:
        try:
            probes.get(name, lambda: None)()
        except (ImportError, CannotRunError) as error:
            missing.append(f"{name} left out: {error}")
        else:
            usable.append(name)
    return usable, missing


def _import(package: str, remedy: str = "pip install 'epi360[bench]'") -> None:
    try:
        __import__(package)
    except ImportError as error:
        raise CannotRunError(f"{package} is not installed; {remedy}") from error
