# SPDX-License-Identifier: BSD-3-Clause
"""What a visitor says about two pictures, and the cameras that follow from it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from epi360.cameras import Camera, KannalaBrandt, Pinhole
from epi360.jobs.folder.given_cameras import read_given_cameras
from epi360_demo.limits import RefusedError, as_sentence

CameraKind = Literal["panorama", "fisheye", "flat", "lens"]
# The labels of the page; panoramas may be parts of one, if their GPano metadata say so.
CAMERA_KINDS: dict[CameraKind, str] = {
    "panorama": "Panorama, 360° x 180°",
    "fisheye": "Fisheye, by its field of view",
    "flat": "Flat, by its field of view",
    "lens": "Any lens, by its file",
}
FIELDS_OF_VIEW = {"fisheye": (60.0, 280.0, 190.0), "flat": (5.0, 150.0, 65.0)}
LARGEST_NADIR_DEG, LARGEST_UPRIGHT_DEG, LARGEST_THRESHOLD_DEG = 89.0, 45.0, 30.0


@dataclass(frozen=True)
class PairChoices:
    """The options of a pair; angles are in degrees, None leaves a thing to the library."""

    camera: CameraKind = "panorama"
    fov_deg: float | None = None
    camera_names: str = ""
    upright_deg: float | None = None
    mask_nadir_deg: float = 0.0
    threshold_deg: float | None = None

    def record(self) -> dict[str, Any]:
        """Return plain values for `choices_from`."""
        return asdict(self)


def choices_from(record: Mapping[str, Any]) -> PairChoices:
    """Return checked choices of a visitor; `RefusedError` where a value cannot be used."""
    choices = PairChoices(**record)
    if choices.camera not in get_args(CameraKind):
        raise RefusedError("Choose one of the kinds of cameras.")
    if choices.camera in FIELDS_OF_VIEW:
        low, high, _ = FIELDS_OF_VIEW[choices.camera]
        _check("The field of view", choices.fov_deg, low, high)
    if choices.upright_deg is not None:
        _check("How upright the pictures are", choices.upright_deg, 0.01, LARGEST_UPRIGHT_DEG)
        if choices.camera != "panorama":
            raise RefusedError(
                "Only of a panorama it is known where down is; switch 'upright' off."
            )
    _check("The mask at the bottom", choices.mask_nadir_deg, 0.0, LARGEST_NADIR_DEG)
    if choices.threshold_deg is not None:
        _check("The inlier threshold", choices.threshold_deg, 0.001, LARGEST_THRESHOLD_DEG)
    return choices


def camera_of(
    choices: PairChoices, number: int, width: int, height: int, lens: Path | None, lens_name: str
) -> Camera | None:
    """Return the camera of picture 1 or 2, None where the library finds it: for panoramas."""
    if choices.camera == "fisheye":
        assert choices.fov_deg is not None
        f = min(width, height) / 2.0 / np.radians(choices.fov_deg / 2.0)  # equidistant
        return KannalaBrandt(width, height, f, f, width / 2.0, height / 2.0, 0.0, 0.0, 0.0, 0.0)
    if choices.camera == "flat":
        assert choices.fov_deg is not None
        f = width / 2.0 / np.tan(np.radians(choices.fov_deg / 2.0))
        return Pinhole(width, height, f, f, width / 2.0, height / 2.0)
    if choices.camera == "lens":
        return _calibrated(choices.camera_names, number, lens, lens_name)
    return None


def _calibrated(names: str, number: int, lens: Path | None, lens_name: str) -> Camera:
    if lens is None:
        raise RefusedError(
            "Give the calibration file of the lens, or choose another kind of camera."
        )
    try:
        cameras = read_given_cameras(str(lens)).cameras
    except ValueError as error:
        message = str(error).replace(f"calibration file {lens}: ", "").replace(str(lens), lens_name)
        raise RefusedError(as_sentence(f"{lens_name} cannot be used: {message}")) from None
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    if not wanted and len(cameras) == 1:
        return next(iter(cameras.values()))
    held = ", ".join(cameras)
    if not wanted:
        raise RefusedError(
            f"{lens_name} holds the cameras {held}; write which one took the pictures."
        )
    name = wanted[min(number, len(wanted)) - 1]
    if name not in cameras:
        raise RefusedError(f"{lens_name} has no camera {name}; it holds {held}.")
    return cameras[name]


def _check(what: str, value: object, low: float, high: float) -> None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:  # type: ignore[operator]
        raise RefusedError(f"{what} must be between {low:g} and {high:g} degrees.")
