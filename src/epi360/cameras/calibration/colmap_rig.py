# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP's rig_config.json: where the cameras of a rig sit, and which models they have.

Layout: https://colmap.github.io/rigs.html. COLMAP takes the size of the images from its database;
here "width" and "height" stand beside "camera_params", and COLMAP ignores them.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from epi360.cameras.base import Camera
from epi360.cameras.calibration import fields
from epi360.cameras.calibration.colmap import PANORAMA, camera_of_model
from epi360.poses import Pose


def recognizes(document: Any) -> bool:
    """Return whether the content is a list of rigs."""
    return isinstance(document, list) and any(
        isinstance(rig, Mapping) and "cameras" in rig for rig in document
    )


def read(document: list[Any]) -> dict[str, Camera]:
    """Return the cameras by their image_prefix, the folder of their images."""
    return fields.each(_entries(document), _camera)


def poses(document: list[Any]) -> dict[str, Pose]:
    """Return the poses of the cameras in the frame of the reference camera."""
    return fields.each(_entries(document), _cam_from_rig)


def _entries(document: list[Any]) -> dict[str, Any]:
    if len(document) != 1 or not isinstance(document[0], Mapping):
        raise ValueError(f"expected one rig, got {len(document)}; put each into a file of its own")
    cameras = document[0].get("cameras")
    if not isinstance(cameras, list):
        raise ValueError(f"cameras must be a list, got {fields.shortened(cameras)}")
    entries: dict[str, Any] = {}
    for entry in cameras:
        prefix = entry.get("image_prefix") if isinstance(entry, Mapping) else None
        name = prefix.rstrip("/") if isinstance(prefix, str) else ""
        if not name or name in entries:
            raise ValueError(
                "each camera must have an image_prefix of its own, the folder of its images, got "
                f"{fields.shortened(entry)}"
            )
        entries[name] = entry
    return entries


def _camera(entry: Mapping[str, Any]) -> Camera:
    fields.check_has(entry, ["camera_model_name", "camera_params"])
    model, parameters = entry["camera_model_name"], entry["camera_params"]
    if not isinstance(parameters, list):
        raise ValueError(f"camera_params must be a list, got {fields.shortened(parameters)}")
    parameters = [fields.number(value) for value in parameters]
    width, height = fields.number(entry.get("width")), fields.number(entry.get("height"))
    if model == PANORAMA and width is None and height is None and len(parameters) == 2:
        width, height = parameters
    if width is None or height is None:
        raise ValueError(
            "missing keys: width, height; COLMAP's file does not state the size of the images: "
            "write both beside camera_params"
        )
    return camera_of_model(str(model), width, height, parameters)


def _cam_from_rig(entry: Mapping[str, Any]) -> Pose:
    if entry.get("ref_sensor") is True:
        return Pose(np.eye(3), np.zeros(3))
    fields.check_has(entry, ["cam_from_rig_rotation", "cam_from_rig_translation"])
    return fields.pose_of_numbers(
        fields.real_numbers(entry["cam_from_rig_rotation"], 4, "cam_from_rig_rotation"),
        fields.real_numbers(entry["cam_from_rig_translation"], 3, "cam_from_rig_translation"),
        "cam_from_rig_rotation",
    )
