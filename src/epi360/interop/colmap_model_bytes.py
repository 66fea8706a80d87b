# SPDX-License-Identifier: BSD-3-Clause
"""Reconstructions as the files of COLMAP's sparse models: https://colmap.github.io/format.html.

pycolmap does not write them here, because it does not report a full disk.
"""

import re
import struct
from collections.abc import Iterable
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.calibration.colmap import MODELS_BY_NUMBER, model_of_camera
from epi360.interop.checks import known_camera, known_pose
from epi360.interop.colmap_model_files import PIXEL
from epi360.interop.colmap_model_rigs import Frame, Rig, pose_numbers, rigs_and_frames
from epi360.interop.colmap_rigs import CAMERA
from epi360.interop.reconstruction import Observations, Reconstruction
from epi360.interop.reprojection import point_errors_px

HEADERS = {
    "cameras": "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]",
    "images": "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then POINTS2D[] as X Y POINT3D_ID",
    "points3D": "# POINT3D_ID X Y Z R G B ERROR TRACK[] as IMAGE_ID POINT2D_IDX",
    "rigs": "# RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID SENSORS[] as TYPE ID 1 POSE",
    "frames": "# FRAME_ID RIG_ID QW QX QY QZ TX TY TZ NUM_DATA DATA[] as TYPE SENSOR_ID DATA_ID",
}


def model_files(reconstruction: Reconstruction, *, text: bool) -> dict[str, bytes]:
    """Return the content of each file of a model by its name; ids are 1, 2, ... in order."""
    if not reconstruction.images:
        raise ValueError("a COLMAP model must have an image, got a reconstruction without")
    pixels, tracks = _pixels_and_tracks(reconstruction)
    numbered_cameras = enumerate(reconstruction.cameras.values(), start=1)
    tables = {
        "cameras": [_camera(number, camera, text) for number, camera in numbered_cameras],
        "images": _images(reconstruction, pixels, text),
        "points3D": _points(reconstruction, tracks, text),
    }
    if text:
        _check_names(reconstruction)
    rigs, frames = rigs_and_frames(reconstruction)
    tables["rigs"] = [_rig(rig, text) for rig in rigs]
    tables["frames"] = [_frame(frame, text) for frame in frames]
    if text:
        return {
            f"{name}.txt": _line(HEADERS[name]) + b"".join(entries)
            for name, entries in tables.items()
        }
    return {
        f"{name}.bin": struct.pack("<Q", len(entries)) + b"".join(entries)
        for name, entries in tables.items()
    }


def _check_names(reconstruction: Reconstruction) -> None:
    for image in reconstruction.images:
        if re.search(r"[ \t\r\n]", image.name):
            raise ValueError(f"COLMAP's text ends names at a space: write {image.name!r} in binary")


def _pixels_and_tracks(
    reconstruction: Reconstruction,
) -> tuple[list[NDArray[Any]], list[NDArray[np.uint32]]]:
    """Key points of each image, and (image id, index of the key point) for each point."""
    nothing = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    seen = reconstruction.observations or nothing
    by_image = np.argsort(seen.images, kind="stable")
    images, points = seen.images[by_image], seen.points[by_image]
    pixels = np.empty(len(by_image), PIXEL)
    pixels["pixel"], pixels["point"] = seen.pixels[by_image], points + 1
    starts = np.searchsorted(images, np.arange(len(reconstruction.images) + 1))
    track = np.empty((len(by_image), 2), "<u4")
    track[:, 0], track[:, 1] = images + 1, np.arange(len(by_image)) - starts[images]
    by_point = np.argsort(points, kind="stable")
    track = track[by_point]
    point_starts = np.searchsorted(points[by_point], np.arange(len(reconstruction.points) + 1))
    return (
        [pixels[start:end] for start, end in pairwise(starts)],
        [track[start:end] for start, end in pairwise(point_starts)],
    )


def _camera(number: int, camera: Camera, text: bool) -> bytes:
    model, parameters = model_of_camera(camera)
    if model == "SIMPLE_PINHOLE":
        # 3DGS's reader of text files and OpenMVS take nothing else for a pinhole.
        model, parameters = "PINHOLE", [parameters[0], *parameters]
    size = camera.width, camera.height
    if text:
        return _line(number, model, *size, *parameters)
    layout = f"<IiQQ{len(parameters)}d"
    return struct.pack(layout, number, MODELS_BY_NUMBER.index(model), *size, *parameters)


def _images(reconstruction: Reconstruction, pixels: list[NDArray[Any]], text: bool) -> list[bytes]:
    camera_ids = {name: number for number, name in enumerate(reconstruction.cameras, start=1)}
    entries = []
    for number, (image, seen) in enumerate(
        zip(reconstruction.images, pixels, strict=True), start=1
    ):
        camera_id = camera_ids[known_camera(image, "a COLMAP model")]
        pose = pose_numbers(known_pose(image))
        if text:
            triples = ((u, v, point) for (u, v), point in seen.tolist())
            head = _line(number, *pose, camera_id, image.name)
            entries.append(head + _line(*chain.from_iterable(triples)))
        else:
            head = struct.pack("<I7dI", number, *pose, camera_id) + image.name.encode("utf-8")
            entries.append(head + struct.pack("<BQ", 0, len(seen)) + seen.tobytes())
    return entries


def _points(
    reconstruction: Reconstruction, tracks: list[NDArray[np.uint32]], text: bool
) -> list[bytes]:
    rows = zip(
        np.asarray(reconstruction.points, dtype=np.float64).tolist(),
        reconstruction.colors.tolist(),
        point_errors_px(reconstruction).tolist(),
        tracks,
        strict=True,
    )
    if text:
        return [
            _line(number, *xyz, *color, error_px, *track.ravel().tolist())
            for number, (xyz, color, error_px, track) in enumerate(rows, start=1)
        ]
    return [
        struct.pack("<Q3d3BdQ", number, *xyz, *color, error_px, len(track)) + track.tobytes()
        for number, (xyz, color, error_px, track) in enumerate(rows, start=1)
    ]


def _rig(rig: Rig, text: bool) -> bytes:
    reference, *others = rig.camera_ids
    sensors = [(camera_id, 1, *pose) for camera_id, pose in zip(others, rig.poses, strict=True)]
    return _with_sensors(
        "IIiI" + len(sensors) * "iIB7d",
        (rig.id, len(rig.camera_ids)),
        [(reference,), *sensors],
        text,
    )


def _frame(frame: Frame, text: bool) -> bytes:
    head = (frame.id, frame.rig_id, *frame.pose, len(frame.data))
    return _with_sensors("II7dI" + len(frame.data) * "iIQ", head, frame.data, text)


def _with_sensors(
    layout: str, head: Iterable[float], sensors: Iterable[tuple[float, ...]], text: bool
) -> bytes:
    """Entry with numbers, then for each sensor its type, which is always a camera, and numbers."""
    values: list[float | str] = [*head]
    for numbers in sensors:
        values += ["CAMERA" if text else CAMERA, *numbers]
    return _line(*values) if text else struct.pack(f"<{layout}", *values)


def _line(*values: float | str) -> bytes:
    return (" ".join(map(str, values)) + "\n").encode("utf-8")
