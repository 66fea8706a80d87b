# SPDX-License-Identifier: BSD-3-Clause
"""Files of COLMAP's sparse models, binary and text: https://colmap.github.io/format.html.

They are read here, not by pycolmap, whose reader takes what it finds beyond the end of a truncated
file for numbers. Poses of images are in ``images``, also those of a rig.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, load_cameras
from epi360.cameras.calibration.colmap import camera_of_model, model_of_number, num_parameters
from epi360.interop.colmap_rigs import CAMERA

PIXEL = np.dtype([("pixel", "<f8", 2), ("point", "<i8")])  # point -1: none
T = TypeVar("T")
NEEDED = ("cameras", "images", "points3D")  # rigs and frames came with COLMAP 3.12


@dataclass(frozen=True, eq=False)
class ImageEntry:
    """An image of a model: key of its camera, quaternion and translation, key points."""

    id: int
    name: str
    camera: str
    wxyz: NDArray[np.float64]
    translation: NDArray[np.float64]
    pixels: NDArray[Any]  # of PIXEL


@dataclass(frozen=True)
class PointEntry:
    """A point of a model."""

    id: int
    xyz: tuple[float, ...]
    color: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class RigEntry:
    """A rig of a model: quaternion and translation of each camera, None where it has no pose."""

    id: int
    cam_from_rig: dict[str, tuple[float, ...] | None]


@dataclass(frozen=True)
class FrameEntry:
    """A frame of a model: ids of itself, its rig and its images."""

    id: int
    rig_id: int
    image_ids: tuple[int, ...]


Entry = TypeVar("Entry", ImageEntry, PointEntry)
AT_ORIGIN = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # of the reference sensor
SENSOR_TYPES = {"CAMERA": "0", "IMU": "1"}


def read_model_files(folder: Path) -> tuple[dict[str, Camera], list[ImageEntry], list[PointEntry]]:
    """Cameras by id, images and points of a folder, each in the order of the ids.

    Parameters
    ----------
    folder : path
        With ``cameras``, ``images`` and ``points3D``, as .bin if it has both kinds.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or no model in it.
    ValueError
        If a file is damaged, or a camera has a model that epi360 lacks.
    """
    kind = _kind(folder)
    paths = [folder / f"{name}.{kind}" for name in NEEDED]
    if kind == "bin":
        cameras = _used(_cameras_of_bytes, paths[0])
        images, points = _used(_images_of_bytes, paths[1]), _used(_points_of_bytes, paths[2])
    else:
        cameras = load_cameras(paths[0])
        images, points = _used(_images_of_text, paths[1]), _used(_points_of_text, paths[2])
    return cameras, images, points


def read_rig_files(folder: Path) -> tuple[list[RigEntry], list[FrameEntry]]:
    """Rigs and frames of a folder, none of either where one of the files is missing.

    Parameters
    ----------
    folder : path
        Of a model.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or no model in it.
    ValueError
        If a file is damaged.
    """
    kind = _kind(folder)
    paths = [folder / f"{name}.{kind}" for name in ("rigs", "frames")]
    if not all(path.is_file() for path in paths):
        return [], []
    return (
        _used(lambda data: _entries(data, kind, _rig), paths[0]),
        _used(lambda data: _entries(data, kind, _frame), paths[1]),
    )


def _used(read: Callable[[bytes], T], path: Path) -> T:
    """What ``read`` makes of a file; its errors name the file."""
    try:
        return read(path.read_bytes())
    except (ValueError, OverflowError, struct.error) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"COLMAP model file {path} cannot be used: {reason}") from None


def _kind(folder: Path) -> str:
    if not folder.is_dir():
        raise FileNotFoundError(f"folder {folder} of the COLMAP model does not exist")
    for kind in ("bin", "txt"):
        if all((folder / f"{name}.{kind}").is_file() for name in NEEDED):
            return kind
    raise FileNotFoundError(
        f"folder {folder} has no COLMAP model: it must have {', '.join(NEEDED)}, "
        "all as .bin or all as .txt"
    )


def _by_id(entries: list[Entry]) -> list[Entry]:
    """Entries in the order of their ids, each of which is there once."""
    entries.sort(key=lambda entry: entry.id)
    for entry, after in pairwise(entries):
        if entry.id == after.id:
            raise ValueError(f"id {entry.id} is there twice")
    if entries and not 0 <= entries[0].id <= entries[-1].id < 2**63:
        raise ValueError(f"ids must be 0 to 2^63 - 1, got {entries[0].id} to {entries[-1].id}")
    return entries


class _Cursor:
    """Bytes read from the first to the last; reading beyond the end is a ValueError."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    def take(self, num_bytes: int) -> bytes:
        first, last = self._position, self._position + num_bytes
        if last > len(self._data):
            raise ValueError(f"it is truncated at {len(self._data)} bytes")
        self._position = last
        return self._data[first:last]

    def values(self, layout: str) -> tuple[Any, ...]:
        return struct.unpack(f"<{layout}", self.take(struct.calcsize(f"<{layout}")))

    def text(self) -> str:
        end = self._data.find(b"\0", self._position)
        if end < 0:
            raise ValueError(f"it is truncated at {len(self._data)} bytes")
        return self.take(end + 1 - self._position)[:-1].decode("utf-8")

    def count(self) -> int:
        return int(self.values("Q")[0])

    def check_is_at_end(self) -> None:
        if self._position < len(self._data):
            raise ValueError(f"it goes on after {self._position} of {len(self._data)} bytes")


class _Words:
    """Words of a line, read like the bytes of a cursor."""

    def __init__(self, line: str) -> None:
        self._words = iter([SENSOR_TYPES.get(word, word) for word in line.split()])

    def values(self, layout: str) -> tuple[Any, ...]:
        convert, count = (float, 7) if layout == "7d" else (int, len(layout))
        words = list(islice(self._words, count))
        if len(words) < count:
            raise ValueError("a line is truncated")
        return tuple(convert(word) for word in words)


def _rig(source: _Cursor | _Words) -> RigEntry:
    rig_id, num_sensors = source.values("II")
    cameras: dict[str, tuple[float, ...] | None] = {}
    for index in range(num_sensors):
        kind, sensor_id = source.values("iI")
        pose: tuple[float, ...] | None = AT_ORIGIN
        if index:
            (has_pose,) = source.values("B")
            pose = source.values("7d") if has_pose else None
        if kind == CAMERA:
            cameras[str(sensor_id)] = pose
    return RigEntry(rig_id, cameras)


def _frame(source: _Cursor | _Words) -> FrameEntry:
    frame_id, rig_id = source.values("II")
    source.values("7d")  # the images have poses of their own
    (count,) = source.values("I")
    data = [source.values("iI") + source.values("Q") for _ in range(count)]
    return FrameEntry(frame_id, rig_id, tuple(image for kind, _, image in data if kind == CAMERA))


def _entries(data: bytes, kind: str, read: Callable[[_Cursor | _Words], T]) -> list[T]:
    if kind == "txt":
        lines = data.decode("utf-8").splitlines()
        return [read(_Words(line)) for line in lines if line.strip() and not line.startswith("#")]
    cursor = _Cursor(data)
    entries = [read(cursor) for _ in range(cursor.count())]
    cursor.check_is_at_end()
    return entries


def _cameras_of_bytes(data: bytes) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    cursor = _Cursor(data)
    for _ in range(cursor.count()):
        camera_id, number, width, height = cursor.values("IiQQ")
        model = model_of_number(number)
        try:
            parameters = cursor.values(f"{num_parameters(model)}d")
            camera = camera_of_model(model, width, height, list(parameters))
        except ValueError as error:
            raise ValueError(f"camera {camera_id}: {error}") from None
        if cameras.setdefault(str(camera_id), camera) is not camera:
            raise ValueError(f"camera {camera_id} is there twice")
    cursor.check_is_at_end()
    return dict(sorted(cameras.items(), key=lambda item: int(item[0])))


def _images_of_bytes(data: bytes) -> list[ImageEntry]:
    entries, cursor = [], _Cursor(data)
    for _ in range(cursor.count()):
        image_id, *pose, camera_id = cursor.values("I7dI")
        name = cursor.text()
        pixels = np.frombuffer(cursor.take(cursor.count() * PIXEL.itemsize), PIXEL)
        numbers = np.array(pose)
        entries.append(ImageEntry(image_id, name, str(camera_id), numbers[:4], numbers[4:], pixels))
    cursor.check_is_at_end()
    return _by_id(entries)


def _points_of_bytes(data: bytes) -> list[PointEntry]:
    points, cursor = [], _Cursor(data)
    for _ in range(cursor.count()):
        point_id, x, y, z, red, green, blue, _ = cursor.values("Q3d3Bd")
        cursor.take(8 * cursor.count())  # the track is in the images as well
        points.append(PointEntry(point_id, (x, y, z), (red, green, blue)))
    cursor.check_is_at_end()
    return _by_id(points)


def _images_of_text(data: bytes) -> list[ImageEntry]:
    entries = []
    lines = iter(data.decode("utf-8").split("\n"))  # names may hold other line breaks
    for line in lines:
        if not line.strip() or line.startswith("#"):
            continue
        image_id, *pose, camera_id, name = line.strip().split(maxsplit=9)
        words = next(lines, "").split()  # an image without key points has an empty line
        numbers = np.array(pose, dtype=np.float64)
        if numbers.shape != (7,) or len(words) % 3:
            raise ValueError(f"image {image_id} must have 7 numbers, a camera, a name and triples")
        pixels = np.empty(len(words) // 3, PIXEL)
        pixels["pixel"] = np.array([words[0::3], words[1::3]], dtype=np.float64).T
        pixels["point"] = np.array(words[2::3], dtype=np.int64)
        entries.append(
            ImageEntry(int(image_id), name, str(int(camera_id)), numbers[:4], numbers[4:], pixels)
        )
    return _by_id(entries)


def _points_of_text(data: bytes) -> list[PointEntry]:
    points = []
    for line in data.decode("utf-8").splitlines():
        words = line.split()
        if not words or line.startswith("#"):
            continue
        if len(words) < 8 or len(words) % 2:
            raise ValueError(f"point {words[0]} must have 3 numbers, a color, an error and pairs")
        color = tuple(int(word) for word in words[4:7])
        if not 0 <= min(color) <= max(color) <= 255:
            raise ValueError(f"the color of point {words[0]} must be three numbers up to 255")
        points.append(PointEntry(int(words[0]), tuple(float(word) for word in words[1:4]), color))
    return _by_id(points)
