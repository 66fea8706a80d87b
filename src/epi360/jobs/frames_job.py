# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a video as images in a folder, with a table of their times."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features.images import nadir_mask, read_mask
from epi360.features.picture_writing import encode_picture
from epi360.interop.video import Video, VideoFrame, open_video
from epi360.jobs.frame_selection import ChosenFrame, FrameChooser
from epi360.jobs.frame_source import FRAMES_RECORD, FRAMES_TABLE, frame_name
from epi360.jobs.given_cameras import read_given_cameras
from epi360.progress import Progress, no_progress
from epi360.runs.made_from import first_difference, read_record, write_record
from epi360.runs.whole_files import write_file

# Without a parallax, the first of these that gives enough frames to map.
PARALLAXES_DEG, ENOUGH_FRAMES = (3.0, 1.0, 0.3), 20
_ENDS = 2**20  # bytes of the beginning and of the end of a video by which it is known again


@dataclass(frozen=True)
class FramesOptions:
    """Which frames are written, and how."""

    every: int | None = None  # every n-th frame; None: by sharpness and parallax
    parallax_deg: float | None = None  # None: 3 degrees, less if that gives few frames
    start_s: float | None = None
    end_s: float | None = None
    jpeg_quality: int = 95
    camera: str | None = None  # calibration file; None: panoramas
    mask: Path | None = None  # of all frames, for the choice of frames only
    mask_nadir_deg: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        if self.every is not None and self.every < 1:
            raise ValueError(f"every must be 1 or more, got {self.every}")
        if self.parallax_deg is not None and not 0 < self.parallax_deg < 90:
            raise ValueError(f"parallax_deg must be between 0 and 90, got {self.parallax_deg}")
        if not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"jpeg_quality must be from 1 to 100, got {self.jpeg_quality}")
        if self.start_s is not None and self.end_s is not None and self.end_s < self.start_s:
            raise ValueError(f"end must not be before start, got {self.end_s} < {self.start_s}")


@dataclass(frozen=True)
class FramesRun:
    """What `extract_frames` wrote."""

    folder: Path
    chosen: tuple[ChosenFrame, ...]
    num_frames: int  # of the video, between start and end
    num_new: int  # images that were not there
    remarks: tuple[str, ...]  # sentences: damaged frames, an early end, a camera that stands still


def extract_frames(
    video: str | Path, folder: Path, options: FramesOptions, *, progress: Progress = no_progress
) -> FramesRun:
    """Write chosen frames of a video as JPEG files, and ``frames.csv`` with their times.

    A run that was stopped goes on. Frames are decoded twice, once to choose and once to write, so
    that no more than a few small pictures are in memory.

    Raises
    ------
    ValueError
        As `open_video`; if the folder holds other files or frames of other options, if no frame can
        be decoded, or if the frames are no panoramas and no camera is given.
    OSError
        If a file cannot be written.
    """
    opened = open_video(video)
    record = _open_folder(folder, opened, options)
    if "frames" not in record:
        record |= _choose(opened, options, progress)
        write_record(folder / FRAMES_RECORD, record)
    chosen = tuple(
        ChosenFrame(index, time, float("nan") if parallax is None else parallax)
        for index, time, parallax in record["frames"]
    )
    num_new = _write(opened, folder, chosen, options.jpeg_quality, progress)
    write_file(folder / FRAMES_TABLE, _table(opened.path, chosen))
    return FramesRun(folder, chosen, record["num_frames"], num_new, tuple(record["remarks"]))


def _open_folder(folder: Path, video: Video, options: FramesOptions) -> dict[str, Any]:
    """Record of a folder that is new or holds frames of the same video and options."""
    wanted = {
        **asdict(options),
        "mask": None if options.mask is None else str(options.mask),
        "video": video.path.name,
        "content": content_key(video.path),
    }
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the frames must go into a folder, {folder} is a file")
    found = (
        read_record(folder / FRAMES_RECORD, remedy="choose another folder")
        if folder.exists()
        else None
    )
    if found is None:
        if folder.is_dir() and any(folder.iterdir()):
            raise ValueError(f"{folder} is not empty and holds no frames; choose a new folder")
        folder.mkdir(parents=True, exist_ok=True)
        write_record(folder / FRAMES_RECORD, wanted)
        return wanted
    different = first_difference(found, wanted)
    if different is not None:
        raise ValueError(
            f"{folder} holds frames with {different.name} {different.before}, not "
            f"{different.now}; choose another folder, or the same options to go on"
        )
    return found


def content_key(path: Path) -> str:
    """Hash of the size, the beginning and the end of a file: all of it would take minutes."""
    size = path.stat().st_size
    digest = blake2b(str(size).encode(), digest_size=16)
    with path.open("rb") as file:
        digest.update(file.read(_ENDS))
        file.seek(max(0, size - _ENDS))
        digest.update(file.read(_ENDS))
    return digest.hexdigest()


def _choose(video: Video, options: FramesOptions, progress: Progress) -> dict[str, Any]:
    reader = _Reader(video, options, progress)
    if options.every is None:
        chosen, notes = _by_parallax(video, reader, options)
    else:
        chosen, notes = _every(reader, options.every), []
    if not chosen:
        between = options.start_s is not None or options.end_s is not None
        where = " between these times" if between else ""
        raise ValueError(f"video {video.path} has no frame to use{where}")
    frames = [
        [frame.index, frame.timestamp_s, _null_for_nan(frame.parallax_deg)] for frame in chosen
    ]
    return {
        "frames": frames,
        "num_frames": reader.num_read,
        "remarks": [*reader.remarks(), *notes],
    }


def _every(reader: _Reader, every: int) -> list[ChosenFrame]:
    return [
        ChosenFrame(frame.index, frame.timestamp_s, float("nan"))
        for count, frame in enumerate(reader)
        if count % every == 0
    ]


def _by_parallax(
    video: Video, reader: _Reader, options: FramesOptions
) -> tuple[list[ChosenFrame], list[str]]:
    """Chosen frames, and sentences about a camera that moved little."""
    levels = PARALLAXES_DEG if options.parallax_deg is None else (options.parallax_deg,)
    chosen: list[ChosenFrame] = []
    for parallax_deg in levels:
        chooser, chosen = _chooser(video, options, parallax_deg), []
        for frame in reader:
            chosen += chooser.add(frame.index, frame.timestamp_s, _picture(frame))
        chosen += chooser.finish()
        if len(chosen) >= min(ENOUGH_FRAMES, reader.num_read):
            break
    if len(chosen) == 1 and reader.num_read > 1:
        return chosen, [
            f"the camera moved less than {parallax_deg:g} degrees of parallax in all of the video: "
            "one frame was chosen; --parallax-deg or --every give more"
        ]
    if parallax_deg != levels[0]:
        return chosen, [f"the camera moved little: frames are {parallax_deg:g} degrees apart"]
    return chosen, []


def _null_for_nan(number: float) -> float | None:
    return None if np.isnan(number) else number


def _chooser(video: Video, options: FramesOptions, parallax_deg: float) -> FrameChooser:
    camera = _camera(video, options)
    mask: NDArray[np.bool_] | None = None
    if options.mask is not None:
        mask = read_mask(options.mask, (camera.height, camera.width))
    if options.mask_nadir_deg:
        below = nadir_mask(camera, options.mask_nadir_deg)
        mask = below if mask is None else mask & below
    return FrameChooser(camera, parallax_deg, mask)


def _camera(video: Video, options: FramesOptions) -> Camera:
    info = video.info
    if options.camera is None:
        try:
            return info.camera()
        except ValueError as error:
            raise ValueError(
                f"video {video.path} shows no panoramas ({error}); give its camera (--camera FILE),"
                " or take every n-th frame (--every N)"
            ) from None
    camera = read_given_cameras(options.camera).only()
    if (camera.width, camera.height) != (info.width, info.height):
        raise ValueError(
            f"video {video.path} is {info.width}x{info.height} but its camera is "
            f"{camera.width}x{camera.height}; give the camera of this size"
        )
    return camera


class _Reader:
    """The frames of a video that can be decoded, and what there is to say about the others."""

    def __init__(self, video: Video, options: FramesOptions, progress: Progress) -> None:
        self._video, self._options, self._progress = video, options, progress
        self.num_read, self._num_passes = 0, 0
        self._damaged: list[VideoFrame] = []

    def __iter__(self) -> Iterator[VideoFrame]:
        info = self._video.info
        total = info.num_frames or round((info.duration_s or 0.0) * (info.frame_rate or 0.0))
        self.num_read, self._damaged = 0, []
        self._num_passes += 1
        stage = "choosing" if self._num_passes == 1 else f"choosing, pass {self._num_passes}"
        self._progress(stage, 0, max(total, 1))
        for frame in self._video.frames(self._options.start_s, self._options.end_s):
            self.num_read += 1
            self._progress(stage, self.num_read, max(total, self.num_read + (total == 0)))
            if frame.image is not None and frame.image.shape[:2] == (info.height, info.width):
                yield frame
            else:
                self._damaged.append(frame)
        if self.num_read != total:
            self._progress(stage, self.num_read, self.num_read)

    def remarks(self) -> list[str]:
        sentences = [] if self._video.ending is None else [self._video.ending]
        if self._damaged:
            first = self._damaged[0]
            sentences.append(
                f"{len(self._damaged)} frames are damaged or of another size and were left out, "
                f"the first is frame {first.index} ({first.timestamp_s:.2f} s)"
            )
        return sentences


def _picture(frame: VideoFrame) -> NDArray[np.uint8]:
    assert frame.image is not None  # the reader leaves the others out
    return frame.image


def _write(
    video: Video,
    folder: Path,
    chosen: tuple[ChosenFrame, ...],
    jpeg_quality: int,
    progress: Progress,
) -> int:
    """Write the images that are missing and return how many they were."""
    path_of = {frame.index: folder / frame_name(video.path, frame.index) for frame in chosen}
    missing = {index for index, path in path_of.items() if not path.is_file()}
    done = len(chosen) - len(missing)
    progress("frames", done, len(chosen))
    if not missing:
        return 0
    times = [frame.timestamp_s for frame in chosen if frame.index in missing]
    start_s = times[0] if times[0] > 0 else None
    num_new = 0
    for frame in video.frames(start_s):
        if frame.index in missing and frame.image is not None:
            data = encode_picture(frame.image, ".jpg", jpeg_quality=jpeg_quality)
            write_file(path_of[frame.index], data)
            missing.remove(frame.index)
            num_new += 1
            progress("frames", done + num_new, len(chosen))
        if not missing:
            return num_new
    raise ValueError(f"video {video.path} changed while its frames were written; start again")


def _table(video: Path, chosen: tuple[ChosenFrame, ...]) -> bytes:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["image", "timestamp_s", "index", "parallax_deg"])
    for frame in chosen:
        parallax = "" if np.isnan(frame.parallax_deg) else f"{frame.parallax_deg:.3f}"
        name = frame_name(video, frame.index)
        rows.writerow([name, repr(frame.timestamp_s), frame.index, parallax])
    return text.getvalue().encode()
