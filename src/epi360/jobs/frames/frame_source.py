# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a video or of a folder of images, one after the other, for commands that take both."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.features.image_cameras import find_panorama
from epi360.features.images import read_image, read_masked_image
from epi360.image_folders import IMAGE_SUFFIXES, existing_folder
from epi360.interop.video import Video, is_video, open_video
from epi360.jobs.folder.folder_files import files_below
from epi360.runs.input_files import read_text
from epi360.runs.inside import inside
from epi360.runs.whole_files import PathLike

FRAMES_RECORD = "epi360-frames.json"  # of a folder that `epi360 frames` wrote
FRAMES_TABLE = "frames.csv"  # of `epi360 frames` and `epi360 track`: image, timestamp_s, ...
_LARGEST_TABLE = 2**28  # bytes: of millions of frames


class SourceFrame(NamedTuple):
    """A frame: its name, its time where that is known, its RGB picture or why there is none.

    ``usable`` (H, W) are the pixels that are not transparent, None where all are.
    """

    name: str
    timestamp_s: float | None
    image: NDArray[np.uint8] | Exception
    usable: NDArray[np.bool_] | None = None


class FrameSource(Protocol):
    """Frames in order. Each loop begins at the first one and holds one picture at a time."""

    path: Path

    def __iter__(self) -> Iterator[SourceFrame]:
        """Frames, also those that cannot be read."""

    @property
    def num_frames(self) -> int | None:
        """How many frames there are, None if a video does not say it."""

    @property
    def names(self) -> list[str] | None:
        """Names of all frames in order, None if a video must be read to know them."""

    @property
    def is_selection(self) -> bool:
        """Whether frames between these were left out on purpose, as `epi360 frames` does."""

    @property
    def ending(self) -> str | None:
        """After a loop: a sentence if the source ended earlier than it should."""

    def camera(self) -> Equirectangular:
        """Camera of panoramas; ``ValueError`` if the frames are none."""


def open_frames(
    path: PathLike, *, start_s: float | None = None, end_s: float | None = None
) -> FrameSource:
    """Frames of a video, or the images below a folder in natural order.

    Images get their times from the folder's ``frames.csv`` if there is one; those that it lists and
    that are missing are frames that cannot be read. The errors are those of `open_video`, and
    ``FileNotFoundError`` for a folder without images.
    """
    path = Path(path)
    if path.is_file() or is_video(path):
        return _VideoFrames(open_video(path), start_s, end_s)
    return _FolderFrames(existing_folder(path, "image folder"), start_s, end_s)


def check_times(start_s: float | None, end_s: float | None) -> None:
    """Raise where no frames can be between two times."""
    for name, time_s in (("start", start_s), ("end", end_s)):
        if time_s is not None and not math.isfinite(time_s):
            raise ValueError(f"{name} must be a number of seconds, got {time_s}")
    if start_s is not None and end_s is not None and end_s < start_s:
        raise ValueError(f"end must not be before start, got {end_s} < {start_s}")


def frame_name(video: PathLike, index: int) -> str:
    """File name of a frame of a video."""
    return f"{Path(video).stem}_{index:06d}.jpg"


def read_frame_times(folder: Path) -> dict[str, float | None]:
    """Time of each image that the ``frames.csv`` of a folder lists, in its order."""
    path = folder / FRAMES_TABLE
    return read_frame_table(path) if path.is_file() else {}


def read_frame_table(path: Path) -> dict[str, float | None]:
    """Times of images in a table with the columns ``image`` and ``timestamp_s``, in its order.

    An empty cell, or a number that is not finite, is no time.
    """
    try:
        rows = csv.DictReader(io.StringIO(read_text(path, largest=_LARGEST_TABLE)))
        if not {"image", "timestamp_s"} <= set(rows.fieldnames or ()):
            raise ValueError(f"{path} must have the columns image and timestamp_s")
        cells = [(row["image"], row["timestamp_s"]) for row in rows]
    except UnicodeDecodeError:
        raise ValueError(f"{path} must be a text file in UTF-8") from None
    except csv.Error as error:
        raise ValueError(f"{path} must be a table with commas ({error})") from None
    try:
        return {name: _time(cell) for name, cell in cells if name}
    except ValueError:
        raise ValueError(f"{path} must hold numbers in its column timestamp_s") from None


def _time(cell: str | None) -> float | None:
    time = float(cell or "nan")
    return time if math.isfinite(time) else None


class _VideoFrames:
    """The frames of a video."""

    def __init__(self, video: Video, start_s: float | None, end_s: float | None) -> None:
        self.path, self._video = video.path, video
        self._start_s, self._end_s = start_s, end_s

    def __iter__(self) -> Iterator[SourceFrame]:
        for frame in self._video.frames(self._start_s, self._end_s):
            image = ValueError(frame.error) if frame.image is None else frame.image
            yield SourceFrame(frame_name(self.path, frame.index), frame.timestamp_s, image)

    @property
    def num_frames(self) -> int | None:
        info = self._video.info
        if self._start_s is None and self._end_s is None and info.num_frames is not None:
            return info.num_frames
        if info.frame_rate is None or info.duration_s is None:
            return None
        end_s = min(info.duration_s, math.inf if self._end_s is None else self._end_s)
        return max(0, math.ceil((end_s - (self._start_s or 0.0)) * info.frame_rate))

    names = None
    is_selection = False

    @property
    def ending(self) -> str | None:
        return self._video.ending

    def camera(self) -> Equirectangular:
        try:
            return self._video.info.camera()
        except ValueError as error:
            raise ValueError(f"video {self.path}: {error}") from None


class _FolderFrames:
    """The images of a folder and its sub-folders."""

    ending = None

    def __init__(self, folder: Path, start_s: float | None, end_s: float | None) -> None:
        self.path = folder
        files = dict(files_below(folder))
        images = {name: path for name, path in files.items() if _is_image(path)}
        if not images:
            raise FileNotFoundError(
                f"image folder {folder} has no JPEG, PNG, TIFF, WebP or BMP files"
            )
        times: Mapping[str, float | None] = read_frame_times(folder)
        listed = {name: inside(folder, name) for name in times}
        self._files = {**listed, **{name: images[name] for name in images if name not in listed}}
        if not times.keys() & images.keys():  # a table of other images
            times, self._files = {}, images
        self._times = times
        if start_s is not None or end_s is not None:
            self._files = {name: self._files[name] for name in self._between(start_s, end_s)}

    def _between(self, start_s: float | None, end_s: float | None) -> list[str]:
        if not self._times:
            raise ValueError(
                f"image folder {self.path} has no {FRAMES_TABLE}, so its images have no times"
            )
        low, high = -math.inf if start_s is None else start_s, math.inf if end_s is None else end_s
        return [
            name for name, time in self._times.items() if time is not None and low <= time <= high
        ]

    def __iter__(self) -> Iterator[SourceFrame]:
        for name, path in self._files.items():
            time = self._times.get(name)
            try:
                yield SourceFrame(name, time, *read_masked_image(path))
            except (OSError, ValueError) as error:
                yield SourceFrame(name, time, error)

    @property
    def num_frames(self) -> int | None:
        return len(self._files)

    @property
    def names(self) -> list[str] | None:
        return list(self._files)

    @property
    def is_selection(self) -> bool:
        return (self.path / FRAMES_RECORD).is_file()

    def camera(self) -> Equirectangular:
        for name, path in self._files.items():
            try:
                picture = read_image(path)
            except (OSError, ValueError):
                continue
            return find_panorama(path, picture, name)
        raise ValueError(f"image folder {self.path} has no image that can be read")


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in IMAGE_SUFFIXES
