# SPDX-License-Identifier: BSD-3-Clause
"""Reading the files of COLMAP's sparse models: https://colmap.github.io/format.html.

pycolmap does not read them here, because its reader takes whatever it finds beyond the end of a
truncated file for numbers. Images of a rig have their pose in ``images`` like all others.
"""

import struct
from collections.abc import Callable
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, load_cameras
from epi360.cameras.calibration.colmap import camera_of_model, model_of_number, num_parameters
from epi360.interop.colmap_rigs import CAMERA
from epi360.runs.input_files import read_file

PIXEL = np.dtype([("pixel", "<f8", 2), ("point", "<i8")])  # the point is -1 if there is none
NEEDED = ("cameras", "images", "points3D")  # rigs and frames came with COLMAP 3.12
AT_ORIGIN = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # the reference sensor has no pose in the file
SENSOR_TYPES = {"CAMERA": "0", "IMU": "1"}
T = TypeVar("T")


class ImageEntry(NamedTuple):
    """An image of a model; its pose is a quaternion, w first, and a translation."""

    id: int
    name: str
    camera: str
    pose: NDArray[np.float64]
    pixels: NDArray[Any]  # of PIXEL


class PointEntry(NamedTuple):
    """A point of a model."""

    id: int
    xyz: tuple[float, ...]
    color: tuple[int, ...]


class RigEntry(NamedTuple):
    """A rig of a model, with the pose of each of its cameras that has one."""

    id: int
    cam_from_rig: dict[str, tuple[float, ...]]


class FrameEntry(NamedTuple):
    """A frame of a model."""

    id: int
    rig_id: int
    image_ids: tuple[int, ...]


Entry = TypeVar("Entry", ImageEntry, PointEntry)


def read_model_files(folder: Path) -> tuple[dict[str, Camera], list[ImageEntry], list[PointEntry]]:
    """Return cameras by id, images and points of a folder, each in the order of the ids."""
    kind = _kind(folder)
    cameras, images, points = (folder / f"{name}.{kind}" for name in NEEDED)
    if kind == "bin":
        return (
            _parsed(cameras, _cameras_of_bytes),
            _parsed(images, lambda data: _by_id(_of_bytes(data, _image_of_bytes))),
            _parsed(points, lambda data: _by_id(_of_bytes(data, _point_of_bytes))),
        )
    return (
        load_cameras(cameras),
        _parsed(images, lambda data: _by_id(_images_of_text(data))),
        _parsed(points, lambda data: _by_id(_of_lines(data, _point_of_line))),
    )


def read_rig_files(folder: Path) -> tuple[list[RigEntry], list[FrameEntry]]:
    """Return rigs and frames of a folder; none if a file is missing, as in older models."""
    kind = _kind(folder)
    rigs, frames = (folder / f"{name}.{kind}" for name in ("rigs", "frames"))
    if not (rigs.is_file() and frames.is_file()):
        return [], []
    if kind == "bin":
        return (
            _parsed(rigs, lambda data: _of_bytes(data, _rig)),
            _parsed(frames, lambda data: _of_bytes(data, _frame)),
        )
    return (
        _parsed(rigs, lambda data: _of_lines(data, lambda line: _rig(_Words(line)))),
        _parsed(frames, lambda data: _of_lines(data, lambda line: _frame(_Words(line)))),
    )


def _parsed(path: Path, parse: Callable[[bytes], T]) -> T:
    """What ``parse`` makes of the content of a file; its errors name the file."""
    try:
        return parse(read_file(path))
    except (ValueError, OverflowError, struct.error) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"COLMAP model file {path} cannot be used: {reason}") from None


def _kind(folder: Path) -> str:
    """Extension of the files of a model; "bin" if a folder has both kinds."""
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
    """Entries in the order of their ids, which must differ."""
    entries.sort(key=lambda entry: entry.id)
    for entry, following in pairwise(entries):
        if entry.id == following.id:
            raise ValueError(f"id {entry.id} is there twice")
    if entries and not 0 <= entries[0].id <= entries[-1].id < 2**63:
        raise ValueError(f"ids must be 0 to 2^63 - 1, got {entries[0].id} to {entries[-1].id}")
    return entries


class _Cursor:
    """Bytes that are read in their order; reading beyond their end is a ``ValueError``."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    def take(self, num_bytes: int) -> bytes:
        start, self._position = self._position, self._position + num_bytes
        if self._position > len(self._data):
            raise ValueError(f"it is truncated at {len(self._data)} bytes")
        return self._data[start : self._position]

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


def _of_bytes(data: bytes, read: Callable[[_Cursor], T]) -> list[T]:
    """What ``read`` makes of each entry of a binary file, which begins with their number."""
    cursor = _Cursor(data)
    entries = [read(cursor) for _ in range(cursor.count())]
    cursor.check_is_at_end()
    return entries


def _of_lines(data: bytes, read: Callable[[str], T]) -> list[T]:
    """What ``read`` makes of each line of a text file that holds something."""
    lines = data.decode("utf-8").splitlines()
    return [read(line) for line in lines if line.strip() and not line.startswith("#")]


def _rig(source: _Cursor | _Words) -> RigEntry:
    rig_id, num_sensors = source.values("II")
    cam_from_rig: dict[str, tuple[float, ...]] = {}
    for index in range(num_sensors):
        kind, sensor_id = source.values("iI")
        pose = AT_ORIGIN
        if index:
            (has_pose,) = source.values("B")
            pose = source.values("7d") if has_pose else ()
        if kind == CAMERA and pose:
            cam_from_rig[str(sensor_id)] = pose
    return RigEntry(rig_id, cam_from_rig)


def _frame(source: _Cursor | _Words) -> FrameEntry:
    frame_id, rig_id = source.values("II")
    source.values("7d")  # the images have poses of their own
    (count,) = source.values("I")
    data = [source.values("iI") + source.values("Q") for _ in range(count)]
    return FrameEntry(frame_id, rig_id, tuple(image for kind, _, image in data if kind == CAMERA))


def _cameras_of_bytes(data: bytes) -> dict[str, Camera]:
    cameras: dict[int, Camera] = {}
    for camera_id, camera in _of_bytes(data, _camera_of_bytes):
        if camera_id in cameras:
            raise ValueError(f"camera {camera_id} is there twice")
        cameras[camera_id] = camera
    return {str(camera_id): cameras[camera_id] for camera_id in sorted(cameras)}


def _camera_of_bytes(cursor: _Cursor) -> tuple[int, Camera]:
    camera_id, number, width, height = cursor.values("IiQQ")
    model = model_of_number(number)
    try:
        parameters = cursor.values(f"{num_parameters(model)}d")
        return camera_id, camera_of_model(model, width, height, list(parameters))
    except ValueError as error:
        raise ValueError(f"camera {camera_id}: {error}") from None


def _image_of_bytes(cursor: _Cursor) -> ImageEntry:
    image_id, *pose, camera_id = cursor.values("I7dI")
    name = cursor.text()
    pixels = np.frombuffer(cursor.take(cursor.count() * PIXEL.itemsize), PIXEL)
    return ImageEntry(image_id, name, str(camera_id), np.array(pose), pixels)


def _point_of_bytes(cursor: _Cursor) -> PointEntry:
    point_id, x, y, z, red, green, blue, _ = cursor.values("Q3d3Bd")
    cursor.take(8 * cursor.count())  # the images have the track as well
    return PointEntry(point_id, (x, y, z), (red, green, blue))


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
        entries.append(ImageEntry(int(image_id), name, str(int(camera_id)), numbers, pixels))
    return entries


def _point_of_line(line: str) -> PointEntry:
    words = line.split()
    if len(words) < 8 or len(words) % 2:
        raise ValueError(f"point {words[0]} must have 3 numbers, a color, an error and pairs")
    color = tuple(int(word) for word in words[4:7])
    if not 0 <= min(color) <= max(color) <= 255:
        raise ValueError(f"the color of point {words[0]} must be three numbers up to 255")
    return PointEntry(int(words[0]), tuple(float(word) for word in words[1:4]), color)
