# SPDX-License-Identifier: BSD-3-Clause
"""Calibration files of basalt: JSON with the intrinsics and sizes of all cameras of a rig."""

from collections.abc import Mapping
from typing import Any

from epi360.cameras.base import Camera
from epi360.cameras.calibration import fields
from epi360.cameras.double_sphere import DoubleSphere
from epi360.cameras.extended_unified import ExtendedUnified
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.unified import UnifiedCamera
from epi360.poses import Pose

# By camera_type: our model, and basalt's names of the parameters after fx, fy, cx, cy.
MODELS: dict[str, tuple[fields.Model, tuple[str, ...]]] = {
    "pinhole": (Pinhole, ()),
    "kb4": (KannalaBrandt, ("k1", "k2", "k3", "k4")),
    "ucm": (UnifiedCamera, ("alpha",)),
    "eucm": (ExtendedUnified, ("alpha", "beta")),
    "ds": (DoubleSphere, ("xi", "alpha")),
}


def recognizes(document: Any) -> bool:
    """Return whether the content is a calibration of basalt."""
    if not isinstance(document, Mapping) or not isinstance(document.get("value0"), Mapping):
        return False
    return "intrinsics" in document["value0"]


def read(document: Mapping[str, Any]) -> dict[str, Camera]:
    """Return the cameras "cam0", "cam1", ... in the order of the file."""
    calibration = document["value0"]
    fields.check_has(calibration, ["resolution"])
    entries, sizes = calibration["intrinsics"], calibration["resolution"]
    if not isinstance(entries, list) or not entries:
        raise ValueError(
            f"intrinsics must list one camera at least, got {fields.shortened(entries)}"
        )
    if not isinstance(sizes, list) or len(sizes) != len(entries):
        raise ValueError(
            f"resolution must list the sizes of {len(entries)} cameras, "
            f"got {fields.shortened(sizes)}"
        )
    cameras = {f"cam{i}": {"entry": entries[i], "size": sizes[i]} for i in range(len(entries))}
    return fields.each(cameras, _camera)


def poses(document: Mapping[str, Any]) -> dict[str, Pose]:
    """Return the poses from the IMU; T_imu_cam maps from the camera to the IMU."""
    calibration = document["value0"]
    fields.check_has(calibration, ["T_imu_cam"])
    entries, count = calibration["T_imu_cam"], len(calibration["intrinsics"])
    if not isinstance(entries, list) or len(entries) != count:
        raise ValueError(
            f"T_imu_cam must list the poses of {count} cameras, got {fields.shortened(entries)}"
        )
    imu_from_cam = fields.each({f"cam{i}": entries[i] for i in range(count)}, _imu_from_cam)
    return {name: pose.inverse() for name, pose in imu_from_cam.items()}


def _imu_from_cam(entry: Mapping[str, Any]) -> Pose:
    names = ("qw", "qx", "qy", "qz", "px", "py", "pz")
    fields.check_has(entry, names)
    values = [fields.real_number(entry[name], name) for name in names]
    return fields.pose_of_numbers(values[:4], values[4:], "the quaternion of T_imu_cam")


def _camera(sized: Mapping[str, Any]) -> Camera:
    entry = sized["entry"]
    if not isinstance(entry, Mapping):
        raise ValueError(f"intrinsics must be a mapping, got {fields.shortened(entry)}")
    fields.check_has(entry, ["camera_type", "intrinsics"])
    camera_type, values = entry["camera_type"], entry["intrinsics"]
    if not isinstance(camera_type, str) or camera_type not in MODELS:
        wanted = f"basalt camera_type {fields.shortened(camera_type)}"
        raise fields.unsupported(wanted, ", ".join(MODELS))
    model, shape_names = MODELS[camera_type]
    names = ("fx", "fy", "cx", "cy", *shape_names)
    if not isinstance(values, Mapping):
        raise ValueError(f"intrinsics must be a mapping, got {fields.shortened(values)}")
    fields.check_has(values, names)
    width, height = fields.numbers(sized["size"], 2, "resolution")
    fx, fy, cx, cy, *shape = (fields.real_number(values[name], name) for name in names)
    cx, cy = cx + fields.OPENCV_TO_CONTINUOUS, cy + fields.OPENCV_TO_CONTINUOUS
    if camera_type == "ucm":
        fx, fy, shape = _mei(fx, fy, *shape)
    return model(width, height, fx, fy, cx, cy, *shape)


def _mei(fx: float, fy: float, alpha: float) -> tuple[float, float, list[float]]:
    """Focal lengths and xi of Mei's form (Usenko, Demmel & Cremers, 3DV 2018, section II.B)."""
    if not 0 <= alpha < 1:
        raise ValueError(f"alpha of ucm must be in [0, 1), got {alpha}")
    return fx / (1 - alpha), fy / (1 - alpha), [alpha / (1 - alpha)]
