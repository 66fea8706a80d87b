# SPDX-License-Identifier: BSD-3-Clause
"""Reconstructions as the files of COLMAP's sparse models: https://colmap.github.io/format.html.

They are written here, not by pycolmap, which says nothing where the disk is full.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.calibration.colmap import MODELS_BY_NUMBER, model_of_camera
from epi360.interop.checks import known_camera, known_pose
from epi360.interop.colmap_model_files import PIXEL
from epi360.interop.reconstruction import Observations, Reconstruction

UNKNOWN_ERROR = -1.0  # of a point, in pixels


@dataclass(frozen=True, eq=False)
class _Image:
    id: int
    camera_id: int
    name: str
    pose: list[float]  # quaternion and translation
    pixels: NDArray[Any]  # of PIXEL


@dataclass(frozen=True, eq=False)
class _Point:
    id: int
    xyz: list[float]
    color: list[int]
    track: NDArray[np.uint32]  # (K, 2): image id, index of the pixel in it


@dataclass(frozen=True, eq=False)
class _Camera:
    id: int
    model: str
    size: tuple[int, int]
    parameters: list[float]


Parts = tuple[list[_Camera], list[_Image], list[_Point]]


def model_files(reconstruction: Reconstruction, *, text: bool) -> dict[str, bytes]:
    """Content of each file of a model but rigs and frames, by its name.

    Parameters
    ----------
    reconstruction : Reconstruction
        Ids are 1, 2, ... in its order.
    text : bool
        The text files in place of the binary ones.

    Raises
    ------
    ValueError
        If there is no image, an image has no camera or pose or, for text, a name with a space, or
        COLMAP lacks the model of a camera.
    """
    if not reconstruction.images:
        raise ValueError("a COLMAP model must have an image, got a reconstruction without")
    parts = _parts(reconstruction)
    if not text:
        return {f"{name}.bin": data for name, data in _binary(*parts).items()}
    spaced = [image.name for image in parts[1] if re.search(r"[ \t\r\n]", image.name)]
    if spaced:
        raise ValueError(f"COLMAP's text ends names at a space: write {spaced[0]!r} in binary")
    contents = _text(*parts)
    return {f"{name}.txt": "".join(lines).encode("utf-8") for name, lines in contents.items()}


def _parts(reconstruction: Reconstruction) -> Parts:
    """Cameras, images and points with their ids."""
    camera_ids = {name: number for number, name in enumerate(reconstruction.cameras, start=1)}
    cameras = [
        _Camera(camera_ids[name], model, (camera.width, camera.height), parameters)
        for name, camera in reconstruction.cameras.items()
        for model, parameters in [model_of_camera(camera)]
    ]
    empty = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    seen = reconstruction.observations or empty
    order = np.argsort(seen.images, kind="stable")
    pixels = np.empty(len(order), PIXEL)
    pixels["pixel"], pixels["point"] = seen.pixels[order], seen.points[order] + 1
    bounds = np.searchsorted(seen.images[order], np.arange(len(reconstruction.images) + 1))
    images = []
    for index, image in enumerate(reconstruction.images):
        camera_id = camera_ids[known_camera(image, "a COLMAP model")]
        pose = known_pose(image)
        numbers = [*pose.quaternion_wxyz.tolist(), *pose.translation.tolist()]
        own = pixels[bounds[index] : bounds[index + 1]]
        images.append(_Image(index + 1, camera_id, image.name, numbers, own))
    track = np.empty((len(order), 2), "<u4")
    track[:, 0] = seen.images[order] + 1
    track[:, 1] = np.arange(len(order)) - bounds[seen.images[order]]
    return cameras, images, _points(reconstruction, track, seen.points[order])


def _points(
    reconstruction: Reconstruction, track: NDArray[np.uint32], rows: NDArray[np.int64]
) -> list[_Point]:
    """Points with their tracks, of which each element belongs to a row of the points."""
    order = np.argsort(rows, kind="stable")
    bounds = np.searchsorted(rows[order], np.arange(len(reconstruction.points) + 1))
    track = track[order]
    xyz = np.asarray(reconstruction.points, dtype=np.float64).tolist()
    return [
        _Point(row + 1, xyz[row], color, track[bounds[row] : bounds[row + 1]])
        for row, color in enumerate(reconstruction.colors.tolist())
    ]


def _binary(cameras: list[_Camera], images: list[_Image], points: list[_Point]) -> dict[str, bytes]:
    """Files without their ending."""
    contents = {
        "cameras": [
            struct.pack("<IiQQ", camera.id, MODELS_BY_NUMBER.index(camera.model), *camera.size)
            + struct.pack(f"<{len(camera.parameters)}d", *camera.parameters)
            for camera in cameras
        ],
        "images": [
            struct.pack("<I7dI", image.id, *image.pose, image.camera_id)
            + image.name.encode("utf-8")
            + struct.pack("<BQ", 0, len(image.pixels))
            + image.pixels.tobytes()
            for image in images
        ],
        "points3D": [
            struct.pack("<Q3d3B", point.id, *point.xyz, *point.color)
            + struct.pack("<dQ", UNKNOWN_ERROR, len(point.track))
            + point.track.tobytes()
            for point in points
        ],
    }
    return {
        name: struct.pack("<Q", len(entries)) + b"".join(entries)
        for name, entries in contents.items()
    }


def _text(
    cameras: list[_Camera], images: list[_Image], points: list[_Point]
) -> dict[str, list[str]]:
    """Lines of the files, the first of which says what is in a line."""
    return {
        "cameras": [
            "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n",
            *(
                _line(camera.id, camera.model, *camera.size, *camera.parameters)
                for camera in cameras
            ),
        ],
        "images": [
            "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then POINTS2D[] as X Y POINT3D_ID\n",
            *(
                _line(image.id, *image.pose, image.camera_id, image.name)
                + _line(*(v for (u, w), point in image.pixels.tolist() for v in (u, w, point)))
                for image in images
            ),
        ],
        "points3D": [
            "# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX\n",
            *(
                _line(p.id, *p.xyz, *p.color, UNKNOWN_ERROR, *p.track.ravel().tolist())
                for p in points
            ),
        ],
    }


def _line(*values: float | str) -> str:
    return " ".join(map(str, values)) + "\n"
