# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP's cameras.txt: one line a camera, principal points already in continuous pixels.

Models and the order of their parameters: https://colmap.github.io/cameras.html.
"""

from __future__ import annotations

from typing import Any

from epi360.cameras.base import Camera, checked_size
from epi360.cameras.calibration import fields
from epi360.cameras.calibration.document import COLMAP_LINE
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.extended_unified import ExtendedUnified
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.unified import UnifiedCamera

PANORAMAS = ("EQUIRECTANGULAR", "SPHERICAL", "SPHERE")
# Model: ours, its parameters that COLMAP leaves out, the number of coefficients that follow.
ONE_FOCAL_LENGTH: dict[str, tuple[fields.Model, tuple[float, ...], int]] = {
    "SIMPLE_PINHOLE": (Pinhole, (), 0),
    "SIMPLE_RADIAL": (UnifiedCamera, (0.0,), 1),
    "RADIAL": (UnifiedCamera, (0.0,), 2),
    "SIMPLE_FISHEYE": (KannalaBrandt, (), 0),
    "SIMPLE_RADIAL_FISHEYE": (KannalaBrandt, (), 1),
    "RADIAL_FISHEYE": (KannalaBrandt, (), 2),
}
TWO_FOCAL_LENGTHS: dict[str, tuple[fields.Model, tuple[float, ...], int]] = {
    "PINHOLE": (Pinhole, (), 0),
    "OPENCV": (UnifiedCamera, (0.0,), 4),
    "FISHEYE": (KannalaBrandt, (), 0),
    "OPENCV_FISHEYE": (KannalaBrandt, (), 4),
    "EUCM": (ExtendedUnified, (), 2),
}
SUPPORTED = ", ".join((*PANORAMAS, *ONE_FOCAL_LENGTH, *TWO_FOCAL_LENGTHS))


def fits(document: Any) -> bool:
    """Whether the content is the lines of a cameras.txt."""
    return isinstance(document, list) and bool(COLMAP_LINE.match(str(next(iter(document), ""))))


def read(document: list[str]) -> dict[str, Camera]:
    """Cameras by their id."""
    cameras: dict[str, Camera] = {}
    for line in document:
        if not COLMAP_LINE.match(line):
            raise ValueError(
                f"expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS', got {fields.shortened(line)}"
            )
        name, model, *values = line.split()
        if name in cameras:
            raise ValueError(f"camera {name} is there twice")
        try:
            cameras[name] = _camera(model, [fields.number(value) for value in values])
        except ValueError as error:
            raise ValueError(f"camera {name}: {error}") from None
    return cameras


def _camera(model: str, values: list[Any]) -> Camera:
    width, height = checked_size(values[0], "width"), checked_size(values[1], "height")
    parameters = values[2:]
    if model in PANORAMAS:
        return _panorama(model, width, height, parameters)
    if model in ONE_FOCAL_LENGTH:
        ours, left_out, count = ONE_FOCAL_LENGTH[model]
        f, cx, cy, *rest = fields.numbers(parameters, 3 + count, f"{model} parameters")
        return ours(width, height, f, f, cx, cy, *left_out, *rest)
    if model in TWO_FOCAL_LENGTHS:
        ours, left_out, count = TWO_FOCAL_LENGTHS[model]
        fx, fy, cx, cy, *rest = fields.numbers(parameters, 4 + count, f"{model} parameters")
        return ours(width, height, fx, fy, cx, cy, *left_out, *rest)
    raise fields.unsupported(f"COLMAP model {fields.shortened(model)}", SUPPORTED)


def _panorama(model: str, width: int, height: int, parameters: list[Any]) -> Camera:
    """Camera of COLMAP 4.2 (w, h), or of forks that call it spherical (w, h or f, cx, cy)."""
    if model != "EQUIRECTANGULAR" and len(parameters) == 3:
        center = parameters[1:]
        if center != [width / 2, height / 2]:
            raise ValueError(
                f"{model} must have its centre in the image centre, got {fields.shortened(center)}"
            )
    elif fields.numbers(parameters, 2, f"{model} parameters") != [width, height]:
        given = fields.shortened(parameters)
        raise ValueError(f"{model} parameters must be the image size, got {given}")
    return Equirectangular(width, height)
