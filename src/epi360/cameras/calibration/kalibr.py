# SPDX-License-Identifier: BSD-3-Clause
"""Kalibr's camchain: camera models, distortions and where the cameras sit on the IMU.

Layout and the order of the numbers: https://github.com/ethz-asl/kalibr/wiki/yaml-formats and
https://github.com/ethz-asl/kalibr/wiki/supported-models.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from epi360.cameras.base import Camera
from epi360.cameras.calibration import fields
from epi360.cameras.calibration.document import read_document
from epi360.cameras.double_sphere import DoubleSphere
from epi360.cameras.extended_unified import ExtendedUnified
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.unified import UnifiedCamera
from epi360.poses import Pose

# By camera_model and distortion_model: our model, and its parameters that Kalibr leaves out. The
# other parameters are in Kalibr's order, after the focal lengths and the centre.
MODELS: dict[tuple[str, str], tuple[fields.Model, tuple[float, ...]]] = {
    ("pinhole", "none"): (Pinhole, ()),
    ("pinhole", "radtan"): (UnifiedCamera, (0.0,)),
    ("pinhole", "equidistant"): (KannalaBrandt, ()),
    ("omni", "none"): (UnifiedCamera, ()),
    ("omni", "radtan"): (UnifiedCamera, ()),
    ("eucm", "none"): (ExtendedUnified, ()),
    ("ds", "none"): (DoubleSphere, ()),
}
NUM_INTRINSICS = {"pinhole": 4, "omni": 5, "eucm": 6, "ds": 6}
NUM_COEFFICIENTS = {"none": 0, "radtan": 4, "equidistant": 4}
SUPPORTED = ", ".join("-".join(key) for key in MODELS)


class KalibrCamera(NamedTuple):
    """Camera of a Kalibr camchain and where it sits on the IMU.

    ``cam_from_imu`` is Kalibr's ``T_cam_imu`` in metres, which maps points from the IMU to the
    camera; None if the file does not say.
    """

    camera: Camera
    cam_from_imu: Pose | None


def load_kalibr_rig(path: str | os.PathLike[str]) -> dict[str, KalibrCamera]:
    """Return the cameras of a Kalibr camchain by name, and their poses on the IMU.

    ``cam_from_imu`` is ``T_cam_imu`` if the camera has one; else it follows from ``T_cn_cnm1`` and
    the camera before, or is None.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file is no Kalibr camchain, uses a model that is not supported, or has a matrix
        that is not a rigid transform.
    """
    path = Path(path)
    document = read_document(path)
    if not recognizes(document):
        raise ValueError(
            f"calibration file {path} must be a Kalibr camchain: cameras with 'camera_model', "
            "'intrinsics' and 'resolution'"
        )
    with fields.naming_file(path):
        return _on_imu(fields.each(_entries(document), _camera_and_poses))


def recognizes(document: Any) -> bool:
    """Return whether the content is a camchain, and not, say, nerfstudio's ``transforms.json``."""
    if not isinstance(document, Mapping) or "frames" in document:
        return False
    return any(
        isinstance(entry, Mapping) and "camera_model" in entry
        for entry in (document, *document.values())
    )


def read(document: Mapping[str, Any]) -> dict[str, Camera]:
    """Return the cameras of a camchain."""
    return fields.each(_entries(document), _camera)


def poses(document: Mapping[str, Any]) -> dict[str, Pose]:
    """Return the poses from the first camera: along the chain, else by way of the IMU."""
    cameras = fields.each(_entries(document), _camera_and_poses)
    first, *others = cameras
    first_from_imu = cameras[first][1]
    cam_from_first = {first: Pose(np.eye(3), np.zeros(3))}
    previous_from_first = cam_from_first[first]
    for name in others:
        _, cam_from_imu, cam_from_previous = cameras[name]
        if cam_from_previous is not None:
            previous_from_first = cam_from_previous @ previous_from_first
        elif cam_from_imu is not None and first_from_imu is not None:
            previous_from_first = cam_from_imu @ first_from_imu.inverse()
        else:
            raise ValueError(f"camera {name} has neither T_cn_cnm1 nor a T_cam_imu like {first}")
        cam_from_first[name] = previous_from_first
    return cam_from_first


def _entries(document: Mapping[str, Any]) -> dict[str, Any]:
    if "camera_model" in document:
        return {"camera": document}
    return {
        name: entry
        for name, entry in document.items()
        if (isinstance(entry, Mapping) and "camera_model" in entry) or str(name).startswith("cam")
    }


def _camera(entry: Mapping[str, Any]) -> Camera:
    fields.check_has(entry, ["camera_model"])
    camera_model = str(entry["camera_model"]).lower()
    distortion_model = str(entry.get("distortion_model") or "none").lower()
    if distortion_model == "equi":  # the name on Kalibr's command line
        distortion_model = "equidistant"
    if (camera_model, distortion_model) not in MODELS:
        models = [fields.shortened(name) for name in (camera_model, distortion_model)]
        wanted = "Kalibr camera_model {} with distortion_model {}".format(*models)
        raise fields.unsupported(wanted, SUPPORTED)
    fields.check_has(entry, ["intrinsics", "resolution"])
    width, height = fields.numbers(entry["resolution"], 2, "resolution")
    intrinsics = fields.real_numbers(
        entry["intrinsics"], NUM_INTRINSICS[camera_model], f"intrinsics of {camera_model}"
    )
    *shape, fx, fy, cx, cy = intrinsics
    cx, cy = cx + fields.OPENCV_TO_CONTINUOUS, cy + fields.OPENCV_TO_CONTINUOUS
    model, left_out = MODELS[camera_model, distortion_model]
    coefficients = _coefficients(entry, distortion_model)
    return model(width, height, fx, fy, cx, cy, *left_out, *shape, *coefficients)


def _coefficients(entry: Mapping[str, Any], distortion_model: str) -> list[Any]:
    count = NUM_COEFFICIENTS[distortion_model]
    if count:
        fields.check_has(entry, ["distortion_coeffs"])
        return fields.numbers(entry["distortion_coeffs"], count, "distortion_coeffs")
    given = entry.get("distortion_coeffs") or []
    if not isinstance(given, list) or any(fields.number(value) != 0 for value in given):
        raise ValueError(
            "distortion_coeffs must be empty without a distortion_model, "
            f"got {fields.shortened(given)}"
        )
    return []


def _camera_and_poses(entry: Mapping[str, Any]) -> tuple[Camera, Pose | None, Pose | None]:
    return _camera(entry), _pose(entry, "T_cam_imu"), _pose(entry, "T_cn_cnm1")


def _on_imu(
    cameras: Mapping[str, tuple[Camera, Pose | None, Pose | None]],
) -> dict[str, KalibrCamera]:
    rig: dict[str, KalibrCamera] = {}
    previous_from_imu: Pose | None = None
    for name, (camera, cam_from_imu, cam_from_previous) in cameras.items():
        if cam_from_imu is None and cam_from_previous is not None and previous_from_imu is not None:
            cam_from_imu = cam_from_previous @ previous_from_imu
        rig[name] = KalibrCamera(camera, cam_from_imu)
        previous_from_imu = cam_from_imu
    return rig


def _pose(entry: Mapping[str, Any], key: str) -> Pose | None:
    if entry.get(key) is None:
        return None
    matrix = fields.square_matrix(entry[key], 4, key)
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # numbers may be huge
            return Pose.from_matrix(matrix)
    except ValueError as error:
        raise ValueError(f"{key} must be a rigid transform: {error}") from None
