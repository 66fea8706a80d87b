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
from epi360.jobs.folder.given_cameras import read_given_cameras
from epi360.jobs.frames.frame_selection import ChosenFrame, FrameChooser
from epi360.jobs.frames.frame_source import FRAMES_RECORD, FRAMES_TABLE, check_times, frame_name
from epi360.progress import Progress, no_progress
from epi360.runs.input_files import read_file
from epi360.runs.made_from import (
    Difference,
    fingerprint,
    first_difference,
    read_record,
    write_record,
)
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
        if self.every is not None and self.parallax_deg is not None:
            raise ValueError(
                "parallax_deg must not be given with every: every n-th frame is taken, however far "
                "the camera moved"
            )
        check_times(self.start_s, self.end_s)


@dataclass(frozen=True)
class FramesRun:
    """What `extract_frames` wrote."""

    folder: Path
    chosen: tuple[ChosenFrame, ...]
    num_frames: int  # of the video, between start and end
    num_new: int  # images that were not there
    remarks: tuple[str, ...]  # sentences: damaged frames, an early end, a camera that stands still


def extract_frames(
    video: str | Path,
    folder: Path,
    options: FramesOptions,
    *,
    restart: bool = False,
    remedy: str = "choose another folder, or the same options to go on",
    progress: Progress = no_progress,
) -> FramesRun:
    """Write chosen frames of a video as JPEG files, and ``frames.csv`` with their times.

    A run that was stopped goes on. Frames are decoded twice, once to choose and once to write, so
    that no more than a few small pictures are in memory. With ``restart``, frames of other options
    are thrown away; without it, they are refused, and the message says the ``remedy``.

    Raises
    ------
    ValueError
        As `open_video`; if the folder holds other files or frames of other options, if no frame can
        be decoded, or if the frames are no panoramas and no camera is given.
    OSError
        If a file cannot be written.
    """
    opened = open_video(video)
    camera, mask = _check(opened, options)
    record = _open_folder(folder, _made_from(opened, options), restart=restart, remedy=remedy)
    if "frames" not in record:
        record |= _choose(opened, camera, mask, options, progress)
        write_record(folder / FRAMES_RECORD, record)
    chosen = tuple(
        ChosenFrame(index, time, float("nan") if parallax is None else parallax)
        for index, time, parallax in record["frames"]
    )
    num_new = _write(opened, folder, chosen, options.jpeg_quality, progress)
    write_file(folder / FRAMES_TABLE, _table(opened.path, chosen))
    return FramesRun(folder, chosen, record["num_frames"], num_new, tuple(record["remarks"]))


def _check(video: Video, options: FramesOptions) -> tuple[Camera | None, NDArray[np.bool_] | None]:
    """Camera and mask of the frames; what is wrong is said before a folder is made."""
    duration_s = video.info.duration_s
    if options.start_s is not None and duration_s is not None and options.start_s > duration_s:
        raise ValueError(
            f"video {video.path} has no frame to use between these times: it ends at "
            f"{duration_s:.2f} s"
        )
    camera: Camera | None = None
    if options.every is None or options.camera is not None:
        camera = _camera(video, options)
    mask: NDArray[np.bool_] | None = None
    if options.mask is not None:
        mask = read_mask(options.mask, (video.info.height, video.info.width))
    if options.mask_nadir_deg and camera is not None:
        below = nadir_mask(camera, options.mask_nadir_deg)
        mask = below if mask is None else mask & below
    return camera, mask


def _made_from(video: Video, options: FramesOptions) -> dict[str, Any]:
    """What the choice of the frames depends on; the mask may be moved or copied."""
    mask = None if options.mask is None else fingerprint(read_file(options.mask))
    return {
        **asdict(options),
        "mask": mask,
        "video": video.path.name,
        "content": content_key(video.path),
    }


def _open_folder(
    folder: Path, wanted: dict[str, Any], *, restart: bool, remedy: str
) -> dict[str, Any]:
    """Record of a folder that is new or holds frames of the same video and options."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"the frames must go into a folder, {folder} is a file")
    path = folder / FRAMES_RECORD
    found = read_record(path, remedy="choose another folder") if folder.exists() else None
    if found is None and folder.is_dir() and any(folder.iterdir()):
        raise ValueError(f"{folder} is not empty and holds no frames; choose a new folder")
    different = None if found is None else first_difference(found, wanted)
    if found is not None and different is None:
        return found
    if found is not None and "frames" in found:
        if not restart:
            raise ValueError(f"{folder} holds frames {_other_frames(different)}; {remedy}")
        _throw_away(folder, found)
    # A record without frames is that of a run which ended before it had chosen any.
    folder.mkdir(parents=True, exist_ok=True)
    write_record(path, wanted)
    return wanted


def _other_frames(different: Difference | None) -> str:
    """What is different about the frames that are there, in the words of the command."""
    if different is None or different.name in ("video", "content"):
        return "of another video"
    if different.name == "mask":
        return "that were chosen with another mask, or without one"
    option = f"--{different.name.removesuffix('_s').replace('_', '-')}"
    before, now = (
        f"no {option}" if value is None else f"{option} {value}"
        for value in (different.before, different.now)
    )
    return f"with {before}, not {now}"


def _throw_away(folder: Path, found: dict[str, Any]) -> None:
    for index, *_ in found["frames"]:
        (folder / frame_name(str(found.get("video")), index)).unlink(missing_ok=True)
    (folder / FRAMES_TABLE).unlink(missing_ok=True)


def content_key(path: Path) -> str:
    """Hash of the size, the beginning and the end of a file: all of it would take minutes."""
    size = path.stat().st_size
    digest = blake2b(str(size).encode(), digest_size=16)
    with path.open("rb") as file:
        digest.update(file.read(_ENDS))
        file.seek(max(0, size - _ENDS))
        digest.update(file.read(_ENDS))
    return digest.hexdigest()


def _choose(
    video: Video,
    camera: Camera | None,
    mask: NDArray[np.bool_] | None,
    options: FramesOptions,
    progress: Progress,
) -> dict[str, Any]:
    reader = _Reader(video, options, progress)
    notes: list[str] = []
    if options.every is not None:
        chosen = _every(reader, options.every)
    else:
        assert camera is not None  # `_check` has it where frames are chosen by parallax
        chosen, notes = _by_parallax(camera, mask, reader, options)
    if not chosen:
        raise ValueError(f"video {video.path} has no frame to use{_why_none(reader, options)}")
    frames = [
        [frame.index, frame.timestamp_s, _null_for_nan(frame.parallax_deg)] for frame in chosen
    ]
    return {
        "frames": frames,
        "num_frames": reader.num_read,
        "remarks": [*reader.remarks(), *notes],
    }


def _why_none(reader: _Reader, options: FramesOptions) -> str:
    if reader.num_read == 0:
        between = options.start_s is not None or options.end_s is not None
        return " between these times" if between else ""
    if reader.num_damaged == reader.num_read:
        return ": all of them are damaged or of another size; copy or export it again"
    return (
        ": they are too dark, too blurred or too even to tell how the camera moves; --every N "
        "takes every n-th frame without looking at it"
    )


def _every(reader: _Reader, every: int) -> list[ChosenFrame]:
    return [
        ChosenFrame(frame.index, frame.timestamp_s, float("nan"))
        for count, frame in enumerate(reader)
        if count % every == 0
    ]


def _by_parallax(
    camera: Camera, mask: NDArray[np.bool_] | None, reader: _Reader, options: FramesOptions
) -> tuple[list[ChosenFrame], list[str]]:
    """Chosen frames, and sentences about a camera that moved little."""
    levels = PARALLAXES_DEG if options.parallax_deg is None else (options.parallax_deg,)
    chosen: list[ChosenFrame] = []
    for parallax_deg in levels:
        chooser, chosen = FrameChooser(camera, parallax_deg, mask), []
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
        return chosen, [f"the camera moved little: a frame is taken each {parallax_deg:g} deg"]
    return chosen, []


def _null_for_nan(number: float) -> float | None:
    return None if np.isnan(number) else number


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

    @property
    def num_damaged(self) -> int:
        return len(self._damaged)

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
    missing = {
        frame.index: frame.timestamp_s for frame in chosen if not path_of[frame.index].is_file()
    }
    done = len(chosen) - len(missing)
    progress("frames", done, len(chosen))
    if not missing:
        return 0
    first_s = min(missing.values())
    start_s = first_s if first_s > 0 else None
    num_new = 0
    for frame in video.frames(start_s):
        wanted_s = missing.get(frame.index)
        if frame.timestamp_s == wanted_s and frame.image is not None:
            data = encode_picture(frame.image, ".jpg", jpeg_quality=jpeg_quality)
            write_file(path_of[frame.index], data)
            del missing[frame.index]
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
