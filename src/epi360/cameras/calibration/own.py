# SPDX-License-Identifier: BSD-3-Clause
"""Our own calibration files: YAML or JSON with the class names and parameters of the models.

A camera of a rig has ``cam_from_rig`` as well.
"""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from epi360.cameras.base import Camera
from epi360.cameras.calibration import fields
from epi360.cameras.double_sphere import DoubleSphere
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.extended_unified import ExtendedUnified
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.unified import UnifiedCamera
from epi360.poses import Pose

MODELS: dict[str, type[Camera]] = {
    model.__name__: model
    for model in (
        Equirectangular, Pinhole, KannalaBrandt, UnifiedCamera, ExtendedUnified, DoubleSphere,
    )
}  # fmt: skip

# What COLMAP, OpenCV, ROS, Kalibr and others call them, in small letters without spaces and dashes.
_OTHER_NAMES = {
    "Equirectangular": "spherical panorama 360 equirect",
    "Pinhole": "opencv simplepinhole perspective plumbbob brown radial radtan",
    "KannalaBrandt": "kannalabrandt4 opencvfisheye fisheye equidistant equi kb kb4",
    "UnifiedCamera": "unified ucm mei omni",
    "ExtendedUnified": "eucm",
    "DoubleSphere": "ds",
}

POSE_KEYS = ({"rotation", "translation"}, {"quaternion_wxyz", "translation"})


def recognizes(document: Any) -> bool:
    """Return whether the content is a mapping of ours."""
    return isinstance(document, Mapping) and ("model" in document or "cameras" in document)


def read(document: Mapping[str, Any]) -> dict[str, Camera]:
    """Return the cameras of such a mapping; a single one is called "camera"."""
    if "model" in document:
        return {"camera": _camera(document)}
    unknown = [str(key) for key in document if key != "cameras"]
    if unknown:
        raise ValueError(f"unknown keys beside 'cameras': {', '.join(unknown)}")
    return fields.each(document["cameras"], _camera)


def _models_like(name: str) -> str:
    """Names of our models, and which of them others call so."""
    plain = re.sub(r"[\s_-]", "", name.lower())
    ours = [each for each in MODELS if plain in (each.lower(), *_OTHER_NAMES[each].split())]
    return ", ".join(MODELS) + (f"; write {ours[0]} for this one" if ours else "")


def camera_record(camera: Camera) -> dict[str, Any]:
    """Return what a file of ours says of a camera."""
    return {"model": type(camera).__name__, **dataclasses.asdict(camera)}


def poses(document: Mapping[str, Any]) -> dict[str, Pose]:
    """Return the poses on the rig; a first camera without one is the frame."""
    entries = document["cameras"] if "cameras" in document else {"camera": document}
    if not any("cam_from_rig" in entry for entry in entries.values()):
        raise ValueError("no camera has a cam_from_rig: the file does not say where they sit")
    first = str(next(iter(entries)))
    cam_from_rig = fields.each(entries, _cam_from_rig)
    missing = [name for name, pose in cam_from_rig.items() if pose is None and name != first]
    if missing:
        raise ValueError(f"cameras without cam_from_rig: {', '.join(missing)}")
    return {name: pose or Pose(np.eye(3), np.zeros(3)) for name, pose in cam_from_rig.items()}


def _cam_from_rig(entry: Mapping[str, Any]) -> Pose | None:
    if "cam_from_rig" not in entry:
        return None
    pose = entry["cam_from_rig"]
    if not isinstance(pose, Mapping) or set(pose) not in POSE_KEYS:
        raise ValueError(
            "cam_from_rig must have translation and rotation, or translation and quaternion_wxyz, "
            f"got {fields.shortened(pose)}"
        )
    translation = fields.real_numbers(pose["translation"], 3, "translation")
    if "quaternion_wxyz" in pose:
        wxyz = fields.real_numbers(pose["quaternion_wxyz"], 4, "quaternion_wxyz")
        return fields.pose_of_numbers(wxyz, translation, "quaternion_wxyz")
    rotation = fields.square_matrix(pose["rotation"], 3, "rotation")
    return Pose(np.array(rotation), np.array(translation))


def _camera(entry: Mapping[str, Any]) -> Camera:
    name = entry.get("model")
    if not isinstance(name, str) or name not in MODELS:
        raise fields.unsupported(f"model {fields.shortened(name)}", _models_like(str(name)))
    parameters = {field.name: field for field in dataclasses.fields(MODELS[name])}
    values = {key: value for key, value in entry.items() if key not in ("model", "cam_from_rig")}
    unknown = [str(key) for key in values if key not in parameters]
    if unknown:
        names = ", ".join(parameters)
        raise ValueError(f"unknown keys for {name}: {', '.join(unknown)}; it has {names}")
    needed = [key for key, field in parameters.items() if field.default is dataclasses.MISSING]
    fields.check_has(entry, needed)
    return MODELS[name](**{key: fields.number(value) for key, value in values.items()})
