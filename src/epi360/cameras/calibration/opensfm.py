# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's camera_models.json: cameras in coordinates normalised by the larger image side.

The point (0, 0) is the middle of the image and the larger side has length 1, so that
u = max(w, h) x + w / 2 in our continuous pixels. Formulas: https://opensfm.org/docs/geometry.html.
"""

from collections.abc import Mapping
from typing import Any

from epi360.cameras.base import Camera, checked_size
from epi360.cameras.calibration import fields
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.unified import UnifiedCamera

# By projection_type: our model, its parameters that OpenSfM leaves out, the names of the
# coefficients (0 if the file lacks them), and whether there are two focal lengths and a centre.
Row = tuple[fields.Model, tuple[float, ...], tuple[str, ...], bool]
MODELS: dict[str, Row] = {
    "perspective": (UnifiedCamera, (0.0,), ("k1", "k2"), False),
    "simple_radial": (UnifiedCamera, (0.0,), ("k1",), True),
    "radial": (UnifiedCamera, (0.0,), ("k1", "k2"), True),
    "brown": (UnifiedCamera, (0.0,), ("k1", "k2", "p1", "p2"), True),
    "fisheye": (KannalaBrandt, (), ("k1", "k2"), False),
    "fisheye_opencv": (KannalaBrandt, (), ("k1", "k2", "k3", "k4"), True),
}
PANORAMAS = ("spherical", "equirectangular")
SUPPORTED = ", ".join((*MODELS, *PANORAMAS))
# Coefficients that our models lack: they must be zero.
WITHOUT_PLACE = {"brown": ("k3",), "fisheye_opencv": ("p1", "p2")}


def recognizes(document: Any) -> bool:
    """Return whether the content is a mapping of names to OpenSfM's cameras."""
    return isinstance(document, Mapping) and any(
        isinstance(entry, Mapping) and "projection_type" in entry for entry in document.values()
    )


def read(document: Mapping[str, Any]) -> dict[str, Camera]:
    """Return the cameras by their names, such as "v2 maker model 5376 2688 spherical 0"."""
    return fields.each(document, _camera)


def _camera(entry: Mapping[str, Any]) -> Camera:
    projection_type = entry.get("projection_type", "perspective")  # OpenSfM's default
    if projection_type in PANORAMAS:
        return _panorama(entry)
    if not isinstance(projection_type, str) or projection_type not in MODELS:
        wanted = f"OpenSfM projection_type {fields.shortened(projection_type)}"
        raise fields.unsupported(wanted, SUPPORTED)
    model, left_out, names, has_center = MODELS[projection_type]
    for name in WITHOUT_PLACE.get(projection_type, ()):
        if fields.real_number(entry.get(name, 0.0), name) != 0:
            raise ValueError(f"{projection_type} with {name} = {entry[name]} is not supported")
    width, height = _size(entry)
    larger_side = max(width, height)
    focal_names = ("focal_x", "focal_y") if has_center else ("focal", "focal")
    fields.check_has(entry, dict.fromkeys(focal_names))
    fx, fy = (larger_side * fields.real_number(entry[name], name) for name in focal_names)
    center = [
        larger_side * fields.real_number(entry.get(name, 0.0), name) if has_center else 0.0
        for name in ("c_x", "c_y")
    ]
    coefficients = [fields.real_number(entry.get(name, 0.0), name) for name in names]
    return model(
        width, height, fx, fy, width / 2 + center[0], height / 2 + center[1],
        *left_out, *coefficients,
    )  # fmt: skip


def _size(entry: Mapping[str, Any]) -> tuple[int, int]:
    fields.check_has(entry, ["width", "height"])
    return (
        checked_size(fields.number(entry["width"]), "width"),
        checked_size(fields.number(entry["height"]), "height"),
    )


def _panorama(entry: Mapping[str, Any]) -> Camera:
    # In OpenSfM the width is 360 degrees and pixels are square, whatever the height is.
    width, height = _size(entry)
    if 2 * height > width:
        raise ValueError(f"a spherical camera must be 2:1 or flatter, got {width}x{height}")
    return Equirectangular(width, height, vertical_fov_deg=360 * height / width)
