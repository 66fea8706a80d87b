# SPDX-License-Identifier: BSD-3-Clause
"""A relative pose as a JSON record for programs."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from epi360.cameras.calibration.own import camera_record
from epi360.estimation.result import ImagePairResult, RelativePoseResult, pose_sigmas_deg
from epi360.extras import package_version
from epi360.poses import Pose, rotation_error_deg, translation_error_deg
from epi360.report.text import CONVENTION, STATUS_SENTENCES
from epi360.runs.whole_files import PathLike, write_file

PIXEL_CONVENTION = "continuous pixels, the centre of the top-left pixel is (0.5, 0.5)"


def pair_record(result: RelativePoseResult) -> dict[str, Any]:
    """Everything a result of any status says, as values that strict JSON can hold.

    Plain lists, numbers and strings; NaN is None (null). Angles are in degrees where the name says
    so; ``covariance`` is in radians squared. The key points of an `ImagePairResult` are included.
    """
    rotation_sigma_deg, translation_sigma_deg = pose_sigmas_deg(result)
    record: dict[str, Any] = {
        "epi360_version": package_version(),
        "convention": CONVENTION,
        "status": result.status,
        "success": result.success,
        "reason": STATUS_SENTENCES[result.status],
        "warnings": list(result.warnings),
        "cam2_from_cam1": pose_record(result.cam2_from_cam1),
        "probability": result.probability,
        "explanations": asdict(result.explanations),
        "rotation_sigma_deg": rotation_sigma_deg,
        "translation_sigma_deg": translation_sigma_deg,
        "covariance": result.covariance,
        "translation_basis": result.translation_basis,
        "E": result.E,
        "alternatives": [pose_record(pose) for pose in result.alternatives],
        "num_matches": result.num_matches,
        "num_inliers": result.num_inliers,
        "inlier_threshold_deg": result.inlier_threshold_deg,
        "noise_deg": result.noise_deg,
        "parallax_deg": result.parallax_deg,
        "sphere_coverage": result.sphere_coverage,
        "num_iterations": result.num_iterations,
        "inlier_mask": result.inlier_mask,
        "residuals_rad": result.residuals_rad,
    }
    if isinstance(result, ImagePairResult):
        record["pixels"] = PIXEL_CONVENTION
        record["keypoints1"] = result.keypoints1
        record["keypoints2"] = result.keypoints2
        record["place"] = asdict(result.place)
        for number, camera in enumerate(result.cameras, start=1):
            record[f"camera{number}"] = None if camera is None else camera_record(camera)
    return {key: plain(value) for key, value in record.items()}


def pose_record(pose: Pose) -> dict[str, Any]:
    """Plain lists ``rotation`` (3 rows), ``quaternion_wxyz`` and ``translation``; NaN is None."""
    return {
        "rotation": plain(pose.rotation),
        "quaternion_wxyz": plain(pose.quaternion_wxyz),
        "translation": plain(pose.translation),
    }


def truth_record(pose: Pose, truth: Pose) -> dict[str, Any]:
    """Errors of an estimate beside the true pose, as plain values; NaN is None."""
    return {
        **pose_record(truth),
        "rotation_error_deg": plain(rotation_error_deg(pose, truth)),
        "translation_error_deg": plain(translation_error_deg(pose, truth)),
    }


def write_json(path: PathLike, record: Mapping[str, Any]) -> None:
    """Write a record of plain values as strict JSON, one key a line, whole or not at all.

    Raises
    ------
    OSError
        If the folder is missing or not writable.
    ValueError
        If the record holds NaN or infinity.
    """
    lines = [
        f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False, ensure_ascii=False)}"
        for key, value in record.items()
    ]
    write_file(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def plain(value: Any) -> Any:
    """Value that strict JSON can hold: arrays are lists, and what is not finite is None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
