# SPDX-License-Identifier: BSD-3-Clause
"""The files of a tracked sequence: trajectory, table of frames, points, models and log."""

from __future__ import annotations

import csv
import io
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from epi360.cameras import Camera
from epi360.cameras.resizing import resized_camera
from epi360.interop import (
    Observations,
    PosedImage,
    Reconstruction,
    write_colmap_model,
    write_tum_trajectory,
)
from epi360.interop.ply import write_ply_points
from epi360.interop.upright_world import mean_down, moved, upright_from_world
from epi360.jobs.folder.posed_pictures import remark_on_turned, write_transforms
from epi360.odometry.frame_result import FrameResult, MapPoints
from epi360.odometry.key_frames import KeyFrame
from epi360.poses import Pose
from epi360.runs.whole_files import write_file

TRAJECTORY, FRAMES, POINTS, LOG = "trajectory.txt", "frames.csv", "points.ply", "track.json"
MODEL, TRANSFORMS, IMAGES = "sparse/0", "transforms.json", "images"
EARLIER = "earlier"  # results of the run before, until this one is done
CAMERA = "camera.json"  # the lens, if it is another one than was given
RESULTS = TRAJECTORY, FRAMES, POINTS, TRANSFORMS, CAMERA, MODEL, IMAGES
COLUMNS = ("image", "timestamp_s", "status", "num_inliers", "is_keyframe")


def set_aside(output: Path, names: Sequence[str]) -> None:
    """Move the results of a whole run into the folder ``earlier``, with a copy of its log.

    What is there is replaced one by one: wherever this stops, nothing is lost, and the next time
    goes on.
    """
    earlier = output / EARLIER
    earlier.mkdir(exist_ok=True)
    for name in names:
        if _is_there(output / name):
            remove(earlier, [name])
            (earlier / name).parent.mkdir(parents=True, exist_ok=True)
            (output / name).rename(earlier / name)
    shutil.copy2(output / LOG, earlier)


def remove(folder: Path, names: Sequence[str]) -> None:
    """Remove results of a run, and the folder if nothing else is in it."""
    for name in names:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        elif _is_there(path):
            path.unlink()
    for path in (folder / Path(MODEL).parent, folder):
        with suppress(OSError):  # there is more in it, or it is not there
            path.rmdir()


def _is_there(path: Path) -> bool:
    return path.exists() or path.is_symlink()


class FrameTable:
    """``frames.csv`` while frames come in: each row is on the disk before the next frame.

    If the disk is full, the table is given up and the run goes on; ``error`` says why.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.error: str | None = None
        self._file = path.open("w", encoding="utf-8", newline="")
        self._write(COLUMNS)

    def add(self, name: str, result: FrameResult) -> None:
        """Write the row of a frame."""
        self._write(frame_row(name, result))

    def replace(self, names: Sequence[str], results: Sequence[FrameResult]) -> None:
        """Write all rows anew, as the frames are known by now."""
        try:
            write_frames(self.path, names, results)
        except OSError:
            return  # the rows that are there stay
        self.close()
        self._file = self.path.open("a", encoding="utf-8", newline="")
        self.error = None

    def close(self) -> None:
        """Close the file."""
        try:
            self._file.close()
        except OSError as error:
            self.error = self.error or f"{self.path}: {error.strerror}"

    def _write(self, row: Sequence[object]) -> None:
        if self.error is not None:
            return
        try:
            csv.writer(self._file, lineterminator="\n").writerow(row)
            self._file.flush()
        except OSError as error:
            self.error = f"{self.path}: {error.strerror}"


def frame_row(name: str, result: FrameResult) -> tuple[object, ...]:
    """Row of a frame in the order of `COLUMNS`."""
    return (
        name,
        repr(float(result.timestamp_s)),
        result.status,
        result.num_inliers,
        int(result.is_keyframe),
    )


def write_frames(path: Path, names: Sequence[str], results: Sequence[FrameResult]) -> None:
    """Write ``frames.csv`` whole."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(COLUMNS)
    rows.writerows(frame_row(names[result.index], result) for result in results)
    write_file(path, text.getvalue().encode())


def upright_world(results: Sequence[FrameResult]) -> Pose:
    """Rotation of the odometry's world that turns down, as the tracked cameras have it, to +y."""
    tracked = [result.cam_from_world for result in results if result.status == "tracked"]
    return upright_from_world(mean_down(pose.rotation for pose in tracked))


def write_trajectory(path: Path, names: Sequence[str], results: Sequence[FrameResult]) -> None:
    """Write the poses of the frames that have one, in the format of TUM, in the upright world."""
    images = [
        PosedImage(names[result.index], None, result.cam_from_world, result.timestamp_s)
        for result in results
        if result.status == "tracked"
    ]
    trajectory = moved(Reconstruction({}, tuple(images)), upright_world(results))
    write_tum_trajectory(path, trajectory)


def key_frame_model(
    camera: Camera,
    names: Sequence[str] | Mapping[int, str],
    key_frames: Sequence[KeyFrame],
    points: MapPoints,
    sizes: Mapping[int, tuple[int, int]] | None = None,
) -> Reconstruction:
    """Key frames, points and who sees what, as a reconstruction.

    Those frames whose pictures have another size than the camera, which ``sizes`` has by their
    numbers, get the camera of their size.
    """
    given = camera.width, camera.height
    of_frame = [(sizes or {}).get(each.index, given) for each in key_frames]
    ids = {size: str(k) for k, size in enumerate(dict.fromkeys((given, *of_frame)), start=1)}
    cameras = {ids[size]: resized_camera(camera, *size) for size in {*of_frame}}
    images = tuple(
        PosedImage(names[each.index], ids[size], each.cam_from_world)
        for each, size in zip(key_frames, of_frame, strict=True)
    )
    scales = np.array(of_frame).reshape(-1, 2) / given
    pixels = points.pixels * scales[points.key_frame_index]
    seen = Observations(points.point_index, points.key_frame_index, pixels)
    return Reconstruction(cameras, images, points.positions, points.colors, seen)


@dataclass
class Written:
    """What was written, and sentences about what could not be."""

    files: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    failed: bool = False  # a disk that is full, a folder that nobody may write

    def attempt(self, name: str, write: Callable[[], None]) -> None:
        """Write one file; what goes wrong does not stop the others."""
        try:
            write()
            self.files.append(name)
        except OSError as error:
            self.failed = True
            self.remarks.append(f"{name} could not be written: {error.strerror or error}")
        except ValueError as error:
            self.remarks.append(f"{name} was not written: {error}")


def write_model(
    output: Path,
    model: Reconstruction,
    images: Path,
    masks: Mapping[str, Path | None],
    mask_nadir_deg: float,
    written: Written,
) -> None:
    """Write the COLMAP model, ``transforms.json`` and the points of the key frames."""

    def transforms() -> None:
        lacks = write_transforms(output / TRANSFORMS, model, images, masks, mask_nadir_deg)
        if lacks:
            written.remarks.append(f"{lacks}; faces that epi360 cubemap cuts may have all masks")

    written.attempt(POINTS, lambda: write_ply_points(output / POINTS, model.points, model.colors))
    written.attempt(MODEL, lambda: write_colmap_model(output / MODEL, model))
    written.attempt(TRANSFORMS, transforms)
    turned = remark_on_turned([image.name for image in model.images], images)
    if turned:
        written.remarks.append(turned)
