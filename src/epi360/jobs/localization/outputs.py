# SPDX-License-Identifier: BSD-3-Clause
"""Poses of new images as a table, a record, a trajectory, and in a copy of the model."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.calibration.own import camera_record
from epi360.extras import package_version
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.jobs.localization.localization_result import LocalizationResult
from epi360.jobs.records.match_store import UNREADABLE
from epi360.poses import Pose

COLUMNS = (
    "image", "status", "num_matches", "num_inliers", "probability", "rotation_sigma_deg",
    "position_sigma", "noise_deg", "sphere_coverage", "seen_share", "qw", "qx", "qy", "qz", "tx",
    "ty", "tz", "map_image", "seconds", "warnings", "same_share",
)  # fmt: skip
CONVENTION = "x_cam = R x_world + t, x right, y down, z forward; lengths in the unit of the map"
_NEW = "localized"  # folder in the model of an image whose name is there already


def table_of(results: Mapping[str, LocalizationResult], reasons: Mapping[str, str]) -> bytes:
    """CSV with a row an image; what is not determined is empty.

    Images that could not be used have their reason in the column of warnings.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for name, result in results.items():
        pose = result.cam_from_world
        numbers = [result.probability, *_sigmas(result), result.noise_deg]
        numbers += [result.sphere_coverage, result.seen_share]
        numbers += [*pose.quaternion_wxyz, *pose.translation]
        cells = ["" if np.isnan(value) else f"{value:.10g}" for value in numbers]
        seconds = "" if np.isnan(result.seconds) else f"{result.seconds:.2f}"
        shown = result.map_images[0] if result.success else ""
        counts = [result.num_matches, result.num_inliers]
        warnings = "; ".join(result.warnings)
        same = "" if np.isnan(result.same_share) else f"{result.same_share:.3f}"
        writer.writerow([name, result.status, *counts, *cells, shown, seconds, warnings, same])
    for name, reason in reasons.items():
        row = {"image": name, "status": UNREADABLE, "warnings": reason}
        writer.writerow([row.get(column, "") for column in COLUMNS])
    return text.getvalue().encode("utf-8")


def record_of(
    results: Mapping[str, LocalizationResult], reasons: Mapping[str, str], source: str
) -> dict[str, Any]:
    """Everything for programs, in plain values; NaN is None, and what unreadable images lack."""
    records = {name: _record(result) for name, result in results.items()}
    nothing = dict.fromkeys(next(iter(records.values()), {}))
    for name, reason in reasons.items():
        said = {"status": UNREADABLE, "success": False, "warnings": [reason]}
        records[name] = {**nothing, **said}
    return {
        "epi360_version": package_version(),
        "convention": CONVENTION,
        "map": source,
        "images": [{"image": name, **record} for name, record in records.items()],
    }


def trajectory_of(
    results: Mapping[str, LocalizationResult], times: Mapping[str, float]
) -> Reconstruction:
    """Poses alone, with their times."""
    return Reconstruction(
        {},
        tuple(
            PosedImage(name, None, result.cam_from_world, times[name])
            for name, result in results.items()
            if result.success
        ),
    )


def model_with(
    model: Reconstruction, results: Mapping[str, LocalizationResult]
) -> tuple[Reconstruction, dict[str, str]]:
    """Copy of a model with the new images and what they see of its points; their names in it."""
    cameras: dict[str, Camera] = dict(model.cameras)
    images, seen = list(model.images), model.observations
    taken = {image.name for image in images}
    names: dict[str, str] = {}
    rows = [np.zeros(0, np.int64) if seen is None else seen.points]
    owners = [np.zeros(0, np.int64) if seen is None else seen.images]
    pixels = [np.zeros((0, 2)) if seen is None else seen.pixels]
    for name, result in results.items():
        if not result.success:
            continue
        names[name] = name
        while names[name] in taken:
            names[name] = f"{_NEW}/{names[name]}"
        taken.add(names[name])
        camera = _camera_name(cameras, result.camera)
        kept = _observed(result, len(model.points))
        rows.append(result.point_ids[kept])
        owners.append(np.full(len(kept), len(images), dtype=np.int64))
        pixels.append(result.keypoints[kept])
        images.append(PosedImage(names[name], camera, result.cam_from_world))
    observations = Observations(
        np.concatenate(rows), np.concatenate(owners), np.concatenate(pixels)
    )
    grown = dataclasses.replace(
        model, cameras=cameras, images=tuple(images), observations=observations
    )
    return grown, names


def _observed(result: LocalizationResult, num_points: int) -> NDArray[np.int64]:
    """Inliers of points of the model, the best of each point and of each key point."""
    rows = np.flatnonzero(result.inlier_mask & (result.point_ids < num_points))
    rows = rows[np.argsort(result.residuals_rad[rows], kind="stable")]
    _, first = np.unique(result.point_ids[rows], return_index=True)
    rows = rows[np.sort(first)]
    _, first = np.unique(result.keypoints[rows], axis=0, return_index=True)
    return np.asarray(np.sort(rows[first]))


def _camera_name(cameras: dict[str, Camera], camera: Camera) -> str:
    for name, known in cameras.items():
        if known == camera:
            return name
    name = str(len(cameras) + 1)
    while name in cameras:
        name += "+"
    cameras[name] = camera
    return name


def _sigmas(result: LocalizationResult) -> tuple[float, float]:
    if not np.isfinite(result.covariance).all():
        return np.nan, np.nan
    return result.rotation_sigma_deg, result.position_sigma


def _record(result: LocalizationResult) -> dict[str, Any]:
    rotation_sigma_deg, position_sigma = _sigmas(result)
    values: dict[str, Any] = {
        "status": result.status,
        "success": result.success,
        "warnings": list(result.warnings),
        "cam_from_world": _pose_record(result.cam_from_world),
        "center": result.cam_from_world.inverse().translation,
        "probability": result.probability,
        "rotation_sigma_deg": rotation_sigma_deg,
        "position_sigma": position_sigma,
        "covariance": result.covariance,
        "camera": camera_record(result.camera),
        "alternatives": [_pose_record(pose) for pose in result.alternatives],
        "num_matches": result.num_matches,
        "num_inliers": result.num_inliers,
        "inlier_threshold_deg": result.inlier_threshold_deg,
        "noise_deg": result.noise_deg,
        "sphere_coverage": result.sphere_coverage,
        "seen_share": result.seen_share,
        "chance_share": result.chance_share,
        "same_share": result.same_share,
        "map_images": list(result.map_images),
        "seconds": result.seconds,
    }
    return {key: _plain(value) for key, value in values.items()}


def _pose_record(pose: Pose) -> dict[str, Any]:
    return {
        "rotation": _plain(pose.rotation),
        "quaternion_wxyz": _plain(pose.quaternion_wxyz),
        "translation": _plain(pose.translation),
    }


def _plain(value: Any) -> Any:
    """Lists in place of arrays, None in place of NaN."""
    if isinstance(value, np.ndarray):
        return [_plain(each) for each in value]
    if isinstance(value, float | np.floating):
        return None if not np.isfinite(value) else float(value)
    return value
