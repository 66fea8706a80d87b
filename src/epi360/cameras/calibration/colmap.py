# SPDX-License-Identifier: BSD-3-Clause
"""COLMAP's camera models, and its cameras.txt with one camera in each line.

Models and the order of their parameters: https://colmap.github.io/cameras.html. Principal points
are in continuous pixels already.
"""

from dataclasses import astuple, dataclass, replace
from typing import Any

from epi360.cameras.base import Camera, checked_size
from epi360.cameras.calibration import fields
from epi360.cameras.calibration.document import COLMAP_LINE
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.extended_unified import ExtendedUnified
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole
from epi360.cameras.unified import UnifiedCamera


@dataclass(frozen=True)
class _Lens:
    """A model with the parameters f or fx, fy, then cx, cy, then our model's first coefficients."""

    ours: fields.Model
    num_focal_lengths: int
    num_coefficients: int
    left_out: tuple[float, ...] = ()  # parameters that only our model has, after cy


PANORAMA = "EQUIRECTANGULAR"
FORKS_PANORAMAS = ("SPHERICAL", "SPHERE")
LENSES = {  # the simplest first
    "SIMPLE_PINHOLE": _Lens(Pinhole, 1, 0),
    "PINHOLE": _Lens(Pinhole, 2, 0),
    "SIMPLE_RADIAL": _Lens(UnifiedCamera, 1, 1, (0.0,)),
    "RADIAL": _Lens(UnifiedCamera, 1, 2, (0.0,)),
    "OPENCV": _Lens(UnifiedCamera, 2, 4, (0.0,)),
    "SIMPLE_FISHEYE": _Lens(KannalaBrandt, 1, 0),
    "FISHEYE": _Lens(KannalaBrandt, 2, 0),
    "SIMPLE_RADIAL_FISHEYE": _Lens(KannalaBrandt, 1, 1),
    "RADIAL_FISHEYE": _Lens(KannalaBrandt, 1, 2),
    "OPENCV_FISHEYE": _Lens(KannalaBrandt, 2, 4),
    "EUCM": _Lens(ExtendedUnified, 2, 2),
}
SUPPORTED = ", ".join((PANORAMA, *FORKS_PANORAMAS, *LENSES))
MODELS_BY_NUMBER = (  # the index is the number of the model in databases and binary files
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE",
    "FULL_OPENCV", "FOV", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION", "SIMPLE_FISHEYE", "FISHEYE",
    "EUCM", "EQUIRECTANGULAR",
)  # fmt: skip


def recognizes(document: Any) -> bool:
    """Return whether the content is the lines of a cameras.txt."""
    first = next(iter(document), None) if isinstance(document, list) else None
    return isinstance(first, str) and bool(COLMAP_LINE.match(first))


def read(document: list[str]) -> dict[str, Camera]:
    """Return the cameras by their id."""
    cameras: dict[str, Camera] = {}
    for line in document:
        if not COLMAP_LINE.match(line):
            raise ValueError(
                f"expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS', got {fields.shortened(line)}"
            )
        name, model, *values = line.split()
        if name in cameras:
            raise ValueError(f"camera {name} is there twice")
        width, height, *parameters = [fields.number(value) for value in values]
        try:
            cameras[name] = camera_of_model(model, width, height, parameters)
        except ValueError as error:
            raise ValueError(f"camera {name}: {error}") from None
    return cameras


def camera_of_model(model: str, width: Any, height: Any, parameters: list[Any]) -> Camera:
    """Return the camera of one of COLMAP's models, or of a fork's panorama, with its parameters."""
    width, height = checked_size(width, "width"), checked_size(height, "height")
    if model == PANORAMA or model in FORKS_PANORAMAS:
        return _panorama(model, width, height, parameters)
    fx, *rest = fields.numbers(parameters, num_parameters(model), f"{model} parameters")
    lens = LENSES[model]
    fy = rest.pop(0) if lens.num_focal_lengths == 2 else fx
    cx, cy, *coefficients = rest
    return lens.ours(width, height, fx, fy, cx, cy, *lens.left_out, *coefficients)


def model_of_number(number: int) -> str:
    """Return COLMAP's name of a model's number; an unknown number gets a name of no model."""
    is_known = 0 <= number < len(MODELS_BY_NUMBER)
    return MODELS_BY_NUMBER[number] if is_known else f"number {number}"


def num_parameters(model: str) -> int:
    """Return the number of parameters of one of COLMAP's models."""
    if model == PANORAMA:
        return 2
    lens = LENSES.get(model)
    if lens is None:
        raise fields.unsupported(f"COLMAP model {fields.shortened(model)}", SUPPORTED)
    return lens.num_focal_lengths + 2 + lens.num_coefficients


def model_of_camera(camera: Camera) -> tuple[str, list[float]]:
    """Return the simplest of COLMAP's models that is this camera, and its parameters."""
    if camera == Equirectangular(camera.width, camera.height):
        return PANORAMA, [float(camera.width), float(camera.height)]
    plain = _plain(camera)
    for model, lens in LENSES.items():
        if lens.ours is not type(plain):
            continue
        _, _, fx, fy, cx, cy, *rest = astuple(plain)
        coefficients = rest[len(lens.left_out) :][: lens.num_coefficients]
        parameters = [*(fx, fy)[: lens.num_focal_lengths], cx, cy, *coefficients]
        if camera_of_model(model, plain.width, plain.height, parameters) == plain:
            return model, parameters
    if isinstance(camera, Equirectangular):
        raise ValueError(
            "COLMAP has no camera for a part of a panorama, or one turned about its centre; fill "
            "the picture up to 2:1 and mask what was added"
        )
    raise ValueError(
        f"COLMAP has no model equal to {_what_it_lacks(camera)}; it has whole panoramas "
        "(Equirectangular), Pinhole, UnifiedCamera with xi=0, KannalaBrandt and ExtendedUnified: "
        "calibrate one of these, or resample the images to one"
    )


def _plain(camera: Camera) -> Camera:
    """Camera of the simplest class with the same rays; COLMAP has no largest angle."""
    if isinstance(camera, KannalaBrandt):
        return replace(camera, max_angle_deg=None)
    if isinstance(camera, UnifiedCamera) and not any(astuple(camera)[6:]):
        return Pinhole(*astuple(camera)[:6])
    return camera


def _what_it_lacks(camera: Camera) -> str:
    name = type(camera).__name__
    return f"{name} with xi={camera.xi:g}" if isinstance(camera, UnifiedCamera) else name


def _panorama(model: str, width: int, height: int, parameters: list[Any]) -> Camera:
    """Camera of COLMAP 4.2 with (w, h), or of a fork's panorama with (w, h) or (f, cx, cy)."""
    if model != PANORAMA and len(parameters) == 3:
        center = parameters[1:]
        if center != [width / 2, height / 2]:
            raise ValueError(
                f"{model} must have its centre in the image centre, got {fields.shortened(center)}"
            )
    elif fields.numbers(parameters, 2, f"{model} parameters") != [width, height]:
        given = fields.shortened(parameters)
        raise ValueError(f"{model} parameters must be the image size, got {given}")
    return Equirectangular(width, height)
