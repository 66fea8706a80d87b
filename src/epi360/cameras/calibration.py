# SPDX-License-Identifier: BSD-3-Clause
"""Calibration files to cameras: our own YAML or JSON, Kalibr's camchain, COLMAP's cameras.txt."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from epi360.cameras.base import Camera
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole

MODELS: dict[str, type[Camera]] = {
    model.__name__: model for model in (Equirectangular, Pinhole, KannalaBrandt)
}
KALIBR_MODELS = "pinhole with distortion_model equidistant or none"
COLMAP_MODELS = "EQUIRECTANGULAR, SPHERICAL, SPHERE, SIMPLE_PINHOLE, PINHOLE, OPENCV_FISHEYE"
COLMAP_LINE = re.compile(r"\d+\s+[A-Z][A-Z0-9_]*\s+\d+\s+\d+(\s|$)")
OPENCV_TO_CONTINUOUS = 0.5  # OpenCV and Kalibr put the centre of the first pixel at 0


def load_cameras(path: str | os.PathLike[str]) -> dict[str, Camera]:
    """Read the cameras of a calibration file; the format is found from the content.

    Parameters
    ----------
    path : path-like
        Our own YAML or JSON (``{model: KannalaBrandt, width: ..., ...}`` with the parameter names
        of the class, or ``{cameras: {name: {model: ...}}}``), a Kalibr camchain (pinhole with
        equidistant or no distortion; its principal point gets the 0.5 of our pixel convention),
        or COLMAP's ``cameras.txt``.

    Returns
    -------
    cameras : dict of str to Camera
        In the order of the file. A single unnamed camera is called "camera"; COLMAP's are called
        by their id.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be read as one of the formats, or uses a model or a parameter that is
        not supported.
    """
    path = Path(path)
    document = _document(path)
    for fits, read in PARSERS:
        if fits(document):
            try:
                return read(document)
            except ValueError as error:
                raise ValueError(f"calibration file {path}: {error}") from None
    raise ValueError(
        f"calibration file {path} has no cameras that epi360 can read; it reads mappings with "
        "'model' or 'cameras', Kalibr camchains and COLMAP cameras.txt"
    )


def load_camera(path: str | os.PathLike[str]) -> Camera:
    """Read the one camera of a calibration file.

    Parameters
    ----------
    path : path-like
        A file that `load_cameras` reads and that holds a single camera.

    Returns
    -------
    Camera

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be read, or holds several cameras.
    """
    cameras = load_cameras(path)
    if len(cameras) > 1:
        raise ValueError(
            f"calibration file {path} must hold one camera, got {len(cameras)}: "
            f"{', '.join(cameras)}; take one with load_cameras"
        )
    return next(iter(cameras.values()))


def _document(path: Path) -> Any:
    """Content of a file: the lines of a COLMAP file, else what YAML or JSON make of it."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileNotFoundError(f"calibration file {path} does not exist") from None
    except (IsADirectoryError, PermissionError):
        raise ValueError(f"calibration file {path} is a folder or may not be read") from None
    except UnicodeDecodeError:
        raise ValueError(f"calibration file {path} must be text, got binary data") from None
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    if lines and COLMAP_LINE.match(lines[0]):
        return lines
    try:
        return json.loads(text) if text.lstrip().startswith("{") else _yaml(text)
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"calibration file {path} must be YAML or JSON: {reason}") from None


def _yaml(text: str) -> Any:
    import yaml  # 20 ms that `import epi360` need not pay

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from None


def _fits_own(document: Any) -> bool:
    return isinstance(document, Mapping) and ("model" in document or "cameras" in document)


def _read_own(document: Mapping[str, Any]) -> dict[str, Camera]:
    if "model" in document:
        return {"camera": _own_camera(document)}
    unknown = [str(key) for key in document if key != "cameras"]
    if unknown:
        raise ValueError(f"unknown keys beside 'cameras': {', '.join(unknown)}")
    return _each(document["cameras"], _own_camera)


def _own_camera(entry: Mapping[str, Any]) -> Camera:
    name = entry.get("model")
    if not isinstance(name, str) or name not in MODELS:
        raise ValueError(_unsupported(f"model {name!r}", ", ".join(MODELS)))
    fields = {field.name: field for field in dataclasses.fields(MODELS[name])}
    unknown = [str(key) for key in entry if key != "model" and key not in fields]
    if unknown:
        known = ", ".join(fields)
        raise ValueError(f"unknown keys for {name}: {', '.join(unknown)}; it has {known}")
    needed = [key for key, field in fields.items() if field.default is dataclasses.MISSING]
    _check_has(entry, needed)
    return MODELS[name](**{key: _number(entry[key]) for key in entry if key != "model"})


def _fits_kalibr(document: Any) -> bool:
    return isinstance(document, Mapping) and any(
        isinstance(entry, Mapping) and "camera_model" in entry
        for entry in (document, *document.values())
    )


def _read_kalibr(document: Mapping[str, Any]) -> dict[str, Camera]:
    if "camera_model" in document:
        return {"camera": _kalibr_camera(document)}
    entries = {
        name: entry
        for name, entry in document.items()
        if isinstance(entry, Mapping) and "camera_model" in entry
    }
    return _each(entries, _kalibr_camera)


def _kalibr_camera(entry: Mapping[str, Any]) -> Camera:
    camera_model = entry["camera_model"]
    distortion_model = str(entry.get("distortion_model", "none")).lower()
    if camera_model != "pinhole" or distortion_model not in ("equidistant", "none"):
        wanted = f"Kalibr model {camera_model} with distortion_model {distortion_model}"
        raise ValueError(_unsupported(wanted, KALIBR_MODELS))
    _check_has(entry, ["intrinsics", "resolution"])
    width, height = _numbers(entry["resolution"], 2, "resolution")
    fx, fy, cx, cy = _numbers(entry["intrinsics"], 4, "intrinsics")
    cx, cy = cx + OPENCV_TO_CONTINUOUS, cy + OPENCV_TO_CONTINUOUS
    if distortion_model == "none":
        return Pinhole(width, height, fx, fy, cx, cy)
    _check_has(entry, ["distortion_coeffs"])
    coefficients = _numbers(entry["distortion_coeffs"], 4, "distortion_coeffs")
    return KannalaBrandt(width, height, fx, fy, cx, cy, *coefficients)


def _fits_colmap(document: Any) -> bool:
    return isinstance(document, list) and bool(COLMAP_LINE.match(str(next(iter(document), ""))))


def _read_colmap(document: list[str]) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for line in document:
        if not COLMAP_LINE.match(line):
            raise ValueError(f"expected 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS', got {line!r}")
        name, model, *numbers = line.split()
        if name in cameras:
            raise ValueError(f"camera {name} is there twice")
        try:
            cameras[name] = _colmap_camera(model, [_number(number) for number in numbers])
        except ValueError as error:
            raise ValueError(f"camera {name}: {error}") from None
    return cameras


def _colmap_camera(model: str, numbers: list[Any]) -> Camera:
    width, height, *parameters = numbers
    if model in ("EQUIRECTANGULAR", "SPHERICAL", "SPHERE"):
        return _colmap_panorama(model, width, height, parameters)
    if model == "SIMPLE_PINHOLE":
        f, cx, cy = _numbers(parameters, 3, f"{model} parameters")
        return Pinhole(width, height, f, f, cx, cy)
    if model == "PINHOLE":
        return Pinhole(width, height, *_numbers(parameters, 4, f"{model} parameters"))
    if model == "OPENCV_FISHEYE":
        return KannalaBrandt(width, height, *_numbers(parameters, 8, f"{model} parameters"))
    raise ValueError(_unsupported(f"COLMAP model {model}", COLMAP_MODELS))


def _colmap_panorama(model: str, width: Any, height: Any, parameters: list[Any]) -> Camera:
    """Camera of COLMAP 4.2 (w, h), or of forks that call it spherical (w, h or f, cx, cy)."""
    if model != "EQUIRECTANGULAR" and len(parameters) == 3:
        center = parameters[1:]
        if center != [width / 2, height / 2]:
            raise ValueError(f"{model} must have its centre in the image centre, got {center}")
    elif _numbers(parameters, 2, f"{model} parameters") != [width, height]:
        raise ValueError(f"{model} parameters must be the image size, got {parameters}")
    return Equirectangular(width, height)


def _each(
    entries: Any, camera_from_entry: Callable[[Mapping[str, Any]], Camera]
) -> dict[str, Camera]:
    if not isinstance(entries, Mapping) or not entries:
        raise ValueError("cameras must be a mapping of names to cameras, with one at least")
    cameras: dict[str, Camera] = {}
    for name, entry in entries.items():
        if not isinstance(entry, Mapping):
            raise ValueError(f"camera {name} must be a mapping, got {entry!r}")
        try:
            cameras[str(name)] = camera_from_entry(entry)
        except ValueError as error:
            raise ValueError(f"camera {name}: {error}") from None
    return cameras


def _check_has(entry: Mapping[str, Any], needed: list[str]) -> None:
    missing = [key for key in needed if key not in entry]
    if missing:
        raise ValueError(f"missing keys: {', '.join(missing)}")


def _numbers(values: Any, count: int, name: str) -> list[Any]:
    if not isinstance(values, list) or len(values) != count:
        raise ValueError(f"{name} must be {count} numbers, got {values!r}")
    return [_number(value) for value in values]


def _number(value: Any) -> Any:
    """Value with numbers in it read: YAML takes 1e-3 for text, having no point."""
    if not isinstance(value, str):
        return value
    try:
        return int(value) if value.isdecimal() else float(value)
    except ValueError:
        return value  # the camera names the parameter when it refuses this


def _unsupported(what: str, supported: str) -> str:
    return f"{what} is not supported yet; supported: {supported}"


Parser = tuple[Callable[[Any], bool], Callable[[Any], dict[str, Camera]]]
PARSERS: tuple[Parser, ...] = (
    (_fits_own, _read_own),
    (_fits_kalibr, _read_kalibr),
    (_fits_colmap, _read_colmap),
)
