# SPDX-License-Identifier: BSD-3-Clause
"""Other packages on the problems of the two-view benchmark, each at its fast settings.

The same confidence, the same minimum of samples and the same gate for all; only the matches that
the package can represent. The calls of the packages are timed, not the projection to pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import cv2
import numpy as np
from _two_view_answer import Answer
from _two_view_problems import FULL_SPHERE_DEG, Cell, Problem, front_hemisphere
from numpy.typing import NDArray

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.poses import Pose

MIN_TRIALS, CONFIDENCE = 20, 0.99
PANORAMA_WIDTH, FISHEYE_WIDTH = 4096, 2048
PINHOLE_FOCAL_PX = PANORAMA_WIDTH / (2.0 * np.pi)  # a panorama's pixels at its centre

Solve = Callable[[], Answer]


class CannotRunError(Exception):
    """A method that cannot run here, with the reason."""


def pycolmap_essential(problem: Problem) -> Solve:
    """COLMAP's essential-matrix estimator."""
    colmap, camera, pixels1, pixels2, options = _pycolmap_input(problem)
    solve = colmap.estimate_essential_matrix
    return lambda: _answer_from_report(solve(pixels1, pixels2, camera, camera, options))


def pycolmap_pose(problem: Problem) -> Solve:
    """COLMAP's relative-pose estimator on pixels."""
    colmap, camera, pixels1, pixels2, options = _pycolmap_input(problem)
    solve = colmap.estimate_relative_pose
    return lambda: _answer_from_report(solve(camera, pixels1, camera, pixels2, options))


def pycolmap_two_view(problem: Problem) -> Solve:
    """COLMAP's calibrated two-view geometry with its choice of a model."""
    colmap, camera, pixels1, pixels2, ransac = _pycolmap_input(problem)
    options = colmap.TwoViewGeometryOptions(compute_relative_pose=True)
    options.ransac = ransac
    rows = np.arange(len(pixels1), dtype=np.uint32)
    matches = np.column_stack([rows, rows])

    def solve() -> Answer:
        geometry = colmap.estimate_calibrated_two_view_geometry(
            camera, pixels1, camera, pixels2, matches, options
        )
        status = colmap.TwoViewGeometryConfiguration(geometry.config).name.lower()
        return _answer_from_rigid(geometry.cam2_from_cam1, status)

    return solve


def pycolmap_camera(cell: Cell) -> tuple[Any, Any, float]:
    """Our camera, COLMAP's and the pixels per radian at the centre, for the cell's lens."""
    import pycolmap

    if cell.fov_deg == FULL_SPHERE_DEG:
        width, height = PANORAMA_WIDTH, PANORAMA_WIDTH // 2
        ours: Any = Equirectangular(width, height)
        model, params, scale = "EQUIRECTANGULAR", [width, height], width / (2.0 * np.pi)
    else:
        width = height = FISHEYE_WIDTH
        scale = width / float(np.radians(cell.fov_deg))
        params = [scale, scale, width / 2.0, width / 2.0, 0.0, 0.0, 0.0, 0.0]
        model = "OPENCV_FISHEYE"
        ours = KannalaBrandt(width, height, *params, max_angle_deg=180.0)
    theirs = pycolmap.Camera(
        camera_id=1,
        model=model,
        width=width,
        height=height,
        params=params,
        has_prior_focal_length=True,
    )
    return ours, theirs, scale


def _pycolmap_input(problem: Problem) -> tuple[Any, Any, NDArray[Any], NDArray[Any], Any]:
    colmap = _pycolmap()
    ours, theirs, pixels_per_rad = pycolmap_camera(problem.cell)
    options = colmap.RANSACOptions()
    options.max_error = pixels_per_rad * np.radians(problem.cell.gate_deg)
    options.min_num_trials = MIN_TRIALS
    options.confidence = CONFIDENCE
    options.random_seed = problem.index
    pixels1 = ours.pixels_from_bearings(problem.bearings1)
    pixels2 = ours.pixels_from_bearings(problem.bearings2)
    return colmap, theirs, pixels1, pixels2, options


@cache
def _pycolmap() -> Any:
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    return pycolmap


def _answer_from_report(report: dict[str, Any] | None) -> Answer:
    return _answer_from_rigid(None if report is None else report["cam2_from_cam1"], "")


def _answer_from_rigid(found: Any, status: str) -> Answer:
    """Answer of a Rigid3d; one without a translation claims no direction."""
    if found is None:
        return Answer(Pose.nan(), accepted=False, status=status)
    return _answer(found.rotation.matrix(), found.translation, status)


def _answer(R: NDArray[Any], t: NDArray[Any], status: str = "") -> Answer:
    length = float(np.linalg.norm(t))
    accepted = bool(length > 0.0)  # NaN is not
    return Answer(Pose(R, t / length if accepted else np.full(3, np.nan)), accepted, status)


def poselib_front(problem: Problem) -> Solve:
    """PoseLib's relative pose of a pinhole camera, on the front hemisphere."""
    import poselib

    front = front_hemisphere(problem)
    if len(front.bearings1) < 5:
        return _no_answer
    size = PANORAMA_WIDTH
    camera = {
        "model": "SIMPLE_PINHOLE",
        "width": size,
        "height": size,
        "params": [PINHOLE_FOCAL_PX, size / 2, size / 2],
    }
    pixels1, pixels2 = (PINHOLE_FOCAL_PX * plane + size / 2 for plane in _image_planes(front))
    options = {
        "max_epipolar_error": PINHOLE_FOCAL_PX * np.radians(problem.cell.gate_deg),
        "min_iterations": MIN_TRIALS,
        "success_prob": CONFIDENCE,
        "seed": problem.index,
    }

    def solve() -> Answer:
        pose, _ = poselib.estimate_relative_pose(pixels1, pixels2, camera, camera, options)
        return _answer(pose.R, pose.t)

    return solve


def opencv_front(problem: Problem) -> Solve:
    """OpenCV's MAGSAC++ essential matrix, on the front hemisphere."""
    front = front_hemisphere(problem)
    if len(front.bearings1) < 5:
        return _no_answer
    points1, points2 = _image_planes(front)
    return partial(_opencv_pose, points1, points2, float(np.radians(problem.cell.gate_deg)))


def _opencv_pose(points1: NDArray[Any], points2: NDArray[Any], gate_rad: float) -> Answer:
    try:
        E, mask = cv2.findEssentialMat(
            points1, points2, np.eye(3), cv2.USAC_MAGSAC, CONFIDENCE, gate_rad
        )
        if E is None or E.shape != (3, 3):
            return _no_answer()
        _, R, t, _ = cv2.recoverPose(E, points1, points2, np.eye(3), mask=mask)
    except cv2.error:  # raised where no model was found
        return _no_answer()
    return _answer(R, t[:, 0])


def _image_planes(problem: Problem) -> tuple[NDArray[Any], NDArray[Any]]:
    b1, b2 = problem.bearings1, problem.bearings2
    return b1[:, :2] / b1[:, 2:], b2[:, :2] / b2[:, 2:]


def _no_answer() -> Answer:
    return Answer(Pose.nan(), accepted=False)


def panorai_pose(problem: Problem) -> Solve:
    """PanorAi's spherical relative pose."""
    from panorai.estimators import RelativePoseOptions, estimate_relative_pose

    options = RelativePoseOptions(
        max_angular_error_deg=problem.cell.gate_deg,
        min_num_trials=MIN_TRIALS,
        confidence=CONFIDENCE,
        random_seed=problem.index,
    )

    def solve() -> Answer:
        found = estimate_relative_pose(problem.bearings1, problem.bearings2, options=options)
        if found is None:
            return _no_answer()
        report = found.quality_report
        accepted = bool(report.accepted) and not found.degenerate
        status = ", ".join(found.degeneracy_reasons)
        return Answer(Pose(found.rotation, found.translation_direction), accepted, status)

    return solve
