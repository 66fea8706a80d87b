# SPDX-License-Identifier: BSD-3-Clause
"""Calibrations that ROS's camera_calibration and OpenCV's calibration samples write.

Both have one camera with a matrix and coefficients, whose order is that of OpenCV's functions.
"""

import math
from collections.abc import Mapping
from typing import Any

from epi360.cameras.base import Camera
from epi360.cameras.calibration import fields
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.unified import UnifiedCamera

MATRIX, COEFFICIENTS = "camera_matrix", "distortion_coefficients"
SIZE = ("image_width", "image_height")
# By distortion_model of ROS: our model, and its parameters that are left out.
MODELS: dict[str, tuple[fields.Model, tuple[float, ...]]] = {
    "plumb_bob": (UnifiedCamera, (0.0,)),
    "rational_polynomial": (UnifiedCamera, (0.0,)),
    "equidistant": (KannalaBrandt, ()),
    "fisheye": (KannalaBrandt, ()),
}
NUM_COEFFICIENTS = 4  # of each model; others in the file must be zero


def recognizes(document: Any) -> bool:
    """Return whether the content is one camera with a matrix."""
    return isinstance(document, Mapping) and MATRIX in document


def read(document: Mapping[str, Any]) -> dict[str, Camera]:
    """Return the camera by its ``camera_name``, or as "camera"."""
    name = document.get("camera_name")
    return fields.each({name if name and isinstance(name, str) else "camera": document}, _camera)


def _camera(entry: Mapping[str, Any]) -> Camera:
    fields.check_has(entry, SIZE)
    width, height = (fields.number(entry[key]) for key in SIZE)
    values = _entries(entry[MATRIX], MATRIX)
    fx, cx, fy, cy = (values[k] if len(values) == 9 else math.nan for k in (0, 2, 4, 5))
    if values != [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]:
        raise ValueError(f"{MATRIX} must be fx 0 cx, 0 fy cy, 0 0 1")
    coefficients = _entries(entry[COEFFICIENTS], COEFFICIENTS) if COEFFICIENTS in entry else []
    name = _distortion_model(entry, coefficients)
    if any(coefficients[NUM_COEFFICIENTS:]):
        raise ValueError(
            f"{name} with coefficients after the first {NUM_COEFFICIENTS} is not supported, got "
            f"{fields.shortened(coefficients)}"
        )
    model, left_out = MODELS[name]
    center = [value + fields.OPENCV_TO_CONTINUOUS for value in (cx, cy)]
    return model(width, height, fx, fy, *center, *left_out, *coefficients[:NUM_COEFFICIENTS])


def _distortion_model(entry: Mapping[str, Any], coefficients: list[float]) -> str:
    """The model that ROS names, or that of OpenCV's flag and coefficients."""
    if "distortion_model" in entry:
        name = entry["distortion_model"]
        if not isinstance(name, str) or name not in MODELS:
            wanted = f"distortion_model {fields.shortened(name)}"
            raise fields.unsupported(wanted, ", ".join(MODELS))
        return name
    if "fisheye_model" in entry:
        is_fisheye = fields.real_number(entry["fisheye_model"], "fisheye_model")
        return "fisheye" if is_fisheye else "plumb_bob"
    if len(coefficients) == NUM_COEFFICIENTS and any(coefficients):
        raise ValueError(
            f"four {COEFFICIENTS} are those of a fisheye or of a perspective lens; add "
            "'distortion_model: equidistant' or 'distortion_model: plumb_bob'"
        )
    return "plumb_bob"


def _entries(matrix: Any, name: str) -> list[float]:
    """Return the numbers of a matrix with rows, cols and data, row by row."""
    if not isinstance(matrix, Mapping):
        raise ValueError(f"{name} must have rows, cols and data, got {fields.shortened(matrix)}")
    fields.check_has(matrix, ["rows", "cols", "data"])
    rows, cols = (fields.real_number(matrix[key], f"{key} of {name}") for key in ("rows", "cols"))
    if not all(size in range(15) for size in (rows, cols)):
        raise ValueError(f"{name} must be a small matrix, got {rows:g} rows and {cols:g} columns")
    return fields.real_numbers(matrix["data"], int(rows * cols), f"data of {name}")
