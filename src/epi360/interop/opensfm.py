# SPDX-License-Identifier: BSD-3-Clause
"""OpenSfM's reconstruction.json.

A list of reconstructions, each with its cameras (as in camera_models.json), shots (axis times angle
and translation of cam_from_world, axes x right, y down, z forward) and points. What tracks.csv
holds, the observations, is not part of it. Source of the frames and models:
https://opensfm.org/docs/geometry.html; of the keys: opensfm/io.py of mapillary/OpenSfM.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular, KannalaBrandt, Pinhole, UnifiedCamera
from epi360.cameras.calibration import fields
from epi360.cameras.calibration.opensfm import read as cameras_from_document
from epi360.interop import checks
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.poses import Pose, rotation_from_vector, vector_from_rotation
from epi360.runs.whole_files import write_file

WHAT = "a reconstruction.json of OpenSfM"


def read_opensfm(path: str | os.PathLike[str]) -> Reconstruction:
    """Largest reconstruction of a ``reconstruction.json``.

    Parameters
    ----------
    path : path-like
        The file. Where it holds several reconstructions, which share no frame, the one with the
        most shots is taken and a warning says how many shots are left out.

    Returns
    -------
    reconstruction : Reconstruction
        Image names are those of the shots, time stamps their ``capture_time`` (seconds), unless all
        are 0: unknown. Without observations: OpenSfM keeps them in another file.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not such a file, a camera is of another model than `load_cameras` reads, or a
        pose or point is incomplete or not finite.
    """
    path = Path(path)
    document = checks.read_json(path, WHAT)
    try:
        chosen = _largest(document)
        cameras = cameras_from_document(chosen["cameras"])
        images = tuple(_image(name, shot) for name, shot in chosen["shots"].items())
        if not any(image.timestamp_s for image in images):  # OpenSfM writes 0 where it has none
            images = tuple(replace(image, timestamp_s=None) for image in images)
        points, colors = _points(checks.mapping(chosen.get("points", {}), "points"))
        reconstruction = Reconstruction(cameras, images, points, colors)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    num_shots = sum(len(part["shots"]) for part in document)
    if len(images) < num_shots:
        warnings.warn(
            f"{path} holds {len(document)} reconstructions without a common frame: took the "
            f"largest, {len(images)} of {num_shots} shots",
            stacklevel=2,
        )
    return reconstruction


def write_opensfm(path: str | os.PathLike[str], reconstruction: Reconstruction) -> None:
    """Write cameras, poses and points as a ``reconstruction.json``.

    Parameters
    ----------
    path : path-like
        File; replaced if it is there.
    reconstruction : Reconstruction
        Observations have no place in this file.

    Raises
    ------
    ValueError
        If an image has no camera or no pose, or OpenSfM has no model for a camera.
    OSError
        If the file cannot be written.

    Notes
    -----
    `Equirectangular` becomes ``spherical``, `Pinhole` and `UnifiedCamera` with xi = 0 ``brown``,
    `KannalaBrandt` ``fisheye_opencv`` (a ``max_angle_deg`` has no place there).
    """
    document = {
        "cameras": {
            name: _entry_of_camera(name, camera) for name, camera in reconstruction.cameras.items()
        },
        "shots": {image.name: _entry_of_image(image) for image in reconstruction.images},
        "points": {
            str(index): {"coordinates": point, "color": color}
            for index, (point, color) in enumerate(
                zip(
                    reconstruction.points.tolist(),
                    reconstruction.colors.astype(float).tolist(),
                    strict=True,
                )
            )
        },
    }
    write_file(path, json.dumps([document], ensure_ascii=False).encode())


def _largest(document: Any) -> Mapping[str, Any]:
    """Reconstruction with the most shots, the first of these."""
    if not isinstance(document, list) or not document:
        raise ValueError(f"{WHAT} must be a list of reconstructions, with one at least")
    for number, part in enumerate(document):
        fields.check_has(checks.mapping(part, f"reconstruction {number}"), ("cameras", "shots"))
        checks.mapping(part["shots"], f"shots of reconstruction {number}")
    largest: Mapping[str, Any] = max(document, key=lambda part: len(part["shots"]))
    return largest


def _image(name: str, shot: Any) -> PosedImage:
    try:
        fields.check_has(checks.mapping(shot, "it"), ("rotation", "translation", "camera"))
        rotation = checks.finite_array(shot["rotation"], (3,), "rotation")
        translation = checks.finite_array(shot["translation"], (3,), "translation")
        time = shot.get("capture_time")
        if time is not None:
            time = float(checks.finite_array([time], (1,), "capture_time")[0])
    except ValueError as error:
        raise ValueError(f"shot {name}: {error}") from None
    pose = Pose(rotation_from_vector(rotation), translation)
    return PosedImage(name, str(shot["camera"]), pose, time)


def _points(entries: Mapping[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Coordinates (P, 3) and colors (P, 3); a file may hold millions, checked all at once."""
    try:
        rows = [(*entry["coordinates"], *entry["color"]) for entry in entries.values()]
        table = np.array(rows, dtype=np.float64).reshape(-1, 6)
        good = len(table) == len(rows) and bool(np.isfinite(table).all())
    except (TypeError, KeyError, ValueError, OverflowError):
        good = False
    if not good:
        raise ValueError(f"point {_bad_point(entries)} must hold coordinates and color, 3 numbers")
    return table[:, :3].copy(), np.clip(np.round(table[:, 3:]), 0, 255).astype(np.uint8)


def _bad_point(entries: Mapping[str, Any]) -> str:
    for name, entry in entries.items():
        try:
            checks.finite_array(entry["coordinates"], (3,), name)
            checks.finite_array(entry["color"], (3,), name)
        except (TypeError, KeyError, ValueError):
            return name
    raise AssertionError("all points are good")


def _entry_of_image(image: PosedImage) -> dict[str, Any]:
    pose = checks.known_pose(image)
    entry: dict[str, Any] = {
        "rotation": vector_from_rotation(pose.rotation).tolist(),
        "translation": pose.translation.tolist(),
        "camera": checks.known_camera(image, "OpenSfM"),
    }
    if image.timestamp_s is not None:
        entry["capture_time"] = image.timestamp_s
    return entry


def _entry_of_camera(name: str, camera: Camera) -> dict[str, Any]:
    """Entry that `load_cameras` reads back; numbers are in units of the larger side."""
    size = {"width": camera.width, "height": camera.height}
    if isinstance(camera, Equirectangular):
        # OpenSfM takes the width for 360 degrees about +z and the pixels for square.
        if camera != Equirectangular(
            **size, vertical_fov_deg=min(180, 360 * camera.height / camera.width)
        ):
            raise ValueError(
                f"camera {name}: OpenSfM has only whole panoramas, 360 degrees wide with square "
                "pixels; paste the part into a whole one"
            )
        return {"projection_type": "spherical", **size}
    lens = {"k1": 0.0, "k2": 0.0, "k3": 0.0}
    if isinstance(camera, KannalaBrandt):
        lens = {key: getattr(camera, key) for key in ("k1", "k2", "k3", "k4")}
        projection = "fisheye_opencv"
    elif isinstance(camera, UnifiedCamera) and camera.xi == 0:
        lens |= {key: getattr(camera, key) for key in ("k1", "k2", "p1", "p2")}
        projection = "brown"
    elif isinstance(camera, Pinhole):
        lens |= {"p1": 0.0, "p2": 0.0}
        projection = "brown"
    else:
        raise ValueError(
            f"camera {name}: OpenSfM has no {type(camera).__name__} model; it has panoramas, "
            "pinholes with distortion (Pinhole, UnifiedCamera with xi = 0) and KannalaBrandt"
        )
    side = max(camera.width, camera.height)
    return {
        "projection_type": projection,
        **size,
        "focal_x": camera.fx / side,
        "focal_y": camera.fy / side,
        "c_x": (camera.cx - camera.width / 2) / side,
        "c_y": (camera.cy - camera.height / 2) / side,
        **lens,
    }
