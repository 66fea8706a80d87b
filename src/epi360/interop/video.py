# SPDX-License-Identifier: BSD-3-Clause
"""Frames of a video file with their own time stamps (PyAV, ``pip install 'epi360[video]'``)."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.cameras.gpano import GPano
from epi360.extras import extra_library
from epi360.features.image_files import MAX_PIXELS
from epi360.features.images import looks_like_dual_fisheye
from epi360.image_folders import IMAGE_SUFFIXES
from epi360.interop.video_boxes import SphereBoxes, read_sphere_boxes
from epi360.interop.video_sphere import VideoSphere, sphere_of_boxes, sphere_of_side_data
from epi360.runs.input_files import check_is_file
from epi360.runs.whole_files import PathLike

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".avi", ".webm", ".insv", ".360")
_CAMERA_SUFFIXES = (".insv", ".360")  # raw files, unless a stitched stream is in them
_EXPORT = "export a stitched 360 video from the camera's program first"


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """A frame of a video.

    ``index`` counts the frames of the whole video from 0 in the order in which they are shown.
    ``image`` is RGB, (H, W, 3) uint8, or None where the frame cannot be decoded: then ``error``
    says why in a sentence.
    """

    index: int
    timestamp_s: float
    image: NDArray[np.uint8] | None
    error: str | None = None


@dataclass(frozen=True)
class VideoInfo:
    """What the headers of a video say; None where they do not say it."""

    width: int
    height: int
    frame_rate: float | None
    duration_s: float | None
    num_frames: int | None
    sphere: VideoSphere

    @property
    def is_360(self) -> bool:
        """Whether the metadata call the video spherical."""
        return self.sphere.projection is not None

    def camera(self) -> Equirectangular:
        """Camera of the frames: a panorama, or the part of one that the metadata describe.

        Raises
        ------
        ValueError
            If the frames are not 2:1 and the metadata do not say which part they show.
        """
        return GPano(part=self.sphere.part).camera(self.width, self.height)


class Video:
    """A video that can be read; `open_video` makes one. Each loop over it starts at its beginning.

    ``ending`` is None until a loop has met the end of the file too early; then it is a sentence
    that says where the video ends.
    """

    def __init__(self, path: Path, info: VideoInfo, stream: int) -> None:
        self.path, self.info = path, info
        self.ending: str | None = None
        self._stream = stream

    def __iter__(self) -> Iterator[VideoFrame]:
        return self.frames()

    def frames(
        self, start_s: float | None = None, end_s: float | None = None
    ) -> Iterator[VideoFrame]:
        """Frames with ``start_s <= timestamp_s <= end_s``; time stamps are those of the file."""
        self.ending = None
        num_read, last_s = 0, math.nan
        for index, timestamp_s, frame in self._decoded(start_s):
            num_read, last_s = index + 1, timestamp_s
            if end_s is not None and timestamp_s > end_s:
                return
            if start_s is None or timestamp_s >= start_s:
                yield _video_frame(index, timestamp_s, frame)
        self.ending = self._early_end(num_read, last_s)

    def _decoded(self, start_s: float | None) -> Iterator[tuple[int, float, Any]]:
        """Index, time and decoded frame, which is None if it is damaged, from before a time on."""
        av = extra_library("av", extra="video", purpose="videos")
        with _opened(av, self.path) as container:
            stream = container.streams[self._stream]
            stream.thread_type = "AUTO"
            times, key = self._seek(av, container, stream, start_s)
            order, step_s = _ShownOrder(times), 1.0 / (self.info.frame_rate or 30.0)
            last_s = math.nan
            for packet in _packets(av, container, stream):
                order.expect(packet, key)
                try:
                    frames = [frame for frame in stream.decode(packet) if frame is not None]
                except av.error.FFmpegError:
                    if packet is None or packet.size == 0:
                        break  # what the decoder still held
                    # Where packets have times, the gap in them shows which frame is missing.
                    frames = [None] if packet.pts is None else []
                for frame in frames:
                    shown = None if frame is None else frame.pts
                    # Frames before the key frame may lack what they were made from.
                    if shown is not None and (shown < key or order.is_past(shown)):
                        continue
                    for index, pts in order.missing_before(shown):
                        last_s = float(pts * stream.time_base)
                        yield index, last_s, None
                    damaged = frame is None or frame.is_corrupt
                    time = None if frame is None else frame.time
                    guess_s = 0.0 if math.isnan(last_s) else last_s + step_s
                    last_s = guess_s if time is None else time
                    yield order.take(), last_s, None if damaged else frame
            for index, pts in order.missing_before(math.inf):
                yield index, float(pts * stream.time_base), None

    def _seek(
        self, av: Any, container: Any, stream: Any, start_s: float | None
    ) -> tuple[list[int], float]:
        """Go to the last key frame before a time; times before it and its own, in stream units."""
        if start_s is None or stream.time_base is None:
            return [], -math.inf
        start = round(start_s / stream.time_base)
        times, key = self._packet_times(av, start)
        try:
            container.seek(key, stream=stream)
        except av.error.FFmpegError:  # it cannot: decode from the beginning
            return [], -math.inf
        return times[: bisect_left(times, key)], key

    def _packet_times(self, av: Any, until: int) -> tuple[list[int], int]:
        """Sorted times of the packets up to a time, and of the last key frame before it."""
        # Packets are not decoded for this: that takes a hundredth of the time.
        times, key = [], None
        with _opened(av, self.path) as container:
            for packet in _packets(av, container, container.streams[self._stream]):
                if packet is None or packet.pts is None or packet.is_discard:
                    continue
                times.append(packet.pts)
                if packet.is_keyframe and packet.pts <= until:
                    key = packet.pts
                if packet.dts is not None and packet.dts > until:
                    break
        return sorted(times), min(times, default=0) if key is None else key

    def _early_end(self, num_read: int, last_s: float) -> str | None:
        expected_s, rate = self.info.duration_s, self.info.frame_rate
        if num_read == 0:
            return f"video {self.path} has no frame that can be decoded; copy or export it again"
        if expected_s is None or rate is None:
            return None
        # The last frame of an uneven video may be shown for long, so that the count decides if the
        # header states it.
        stated = self.info.num_frames
        if num_read >= stated if stated else expected_s - last_s < max(0.5, 4.0 / rate):
            return None
        return (
            f"video {self.path} ends at frame {num_read - 1} ({last_s:.2f} s) although its header "
            f"states {expected_s:.2f} s: the file is cut off; copy or export it again"
        )


class _ShownOrder:
    """Index of each frame: the rank of its time among those of all packets, decoded or not.

    So a frame has the same index however many frames before it are damaged, and wherever decoding
    began. When a decoder gives a frame, it has been given all packets that are shown before.
    """

    def __init__(self, times_before: list[int]) -> None:
        self._times, self._next = times_before, len(times_before)

    def expect(self, packet: Any, key: float) -> None:
        """Note a packet that the decoder gets."""
        if packet is None or packet.pts is None or packet.is_discard or packet.pts < key:
            return
        insort(self._times, packet.pts)

    def is_past(self, pts: int) -> bool:
        """Whether the frame of this time has come: damaged groups give one a second time."""
        end = bisect_right(self._times, pts)
        return 0 < end <= self._next and self._times[end - 1] == pts

    def missing_before(self, pts: float | None) -> Iterator[tuple[int, int]]:
        """Index and time of each frame that should have come before this one and did not."""
        while pts is not None and self._next < len(self._times):
            if self._times[self._next] >= pts:
                return
            self._next += 1
            yield self._next - 1, self._times[self._next - 1]

    def take(self) -> int:
        """Index of the frame that has come."""
        self._next += 1
        return self._next - 1


def is_video(path: PathLike) -> bool:
    """Whether a path names a file, not a folder, with the extension of a video."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES and not Path(path).is_dir()


def open_video(path: PathLike) -> Video:
    """Return a video whose headers and first frame were read.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it is no video, is cut off before its index, holds raw fisheye circles, a cube map or
        two eyes, or has frames of more than `MAX_PIXELS` pixels. The message is one sentence.
    ImportError
        If PyAV is missing.
    """
    path = Path(path)
    av = extra_library("av", extra="video", purpose="videos")
    if not path.exists():
        raise FileNotFoundError(f"video {path} does not exist")
    if path.is_dir():
        raise ValueError(f"video {path} is a folder, expected a video file")
    if path.suffix.lower() in IMAGE_SUFFIXES:  # FFmpeg would take it for a video of one frame
        raise ValueError(f"{path} is one image, expected a folder of images or a video")
    try:
        check_is_file(path)
    except ValueError as error:
        raise ValueError(f"video {error}: it is read more than once") from None
    try:
        boxes = read_sphere_boxes(path)
        container = _opened(av, path)
    except av.error.FFmpegError as error:
        raise ValueError(_unreadable(path, boxes, error)) from None
    except OSError as error:
        raise ValueError(f"video {path} cannot be read: {error.strerror}") from None
    if boxes.has_media and not boxes.has_index:
        container.close()
        raise ValueError(_unreadable(path, boxes, None))
    with container:
        stream = _best_stream(path, container)
        first = _first_frame(av, path, container, stream)
        image = _upright(first)
        height, width = image.shape[:2]
        sphere = sphere_of_boxes(boxes, width, height)
        if sphere == VideoSphere():
            sphere = sphere_of_side_data(_side_data(first), width, height)
        _check_sphere(path, image, sphere)
        info = VideoInfo(width, height, *_times(container, stream), sphere)
        return Video(path, info, stream.index)


def _opened(av: Any, path: Path) -> Any:
    """The file's container; a title that is no UTF-8 is no reason to refuse a video."""
    if int(av.__version__.partition(".")[0]) < 19:  # from then on such bytes are never an error
        return av.open(str(path), metadata_errors="replace")
    return av.open(str(path))


def _unreadable(path: Path, boxes: SphereBoxes, error: Exception | None) -> str:
    if path.stat().st_size == 0:
        return f"video {path} is empty"
    if boxes.has_media and not boxes.has_index:
        return (
            f"video {path} is cut off: the index that cameras write last is missing; copy it again"
            " or repair it with a program such as untrunc"
        )
    reason = getattr(error, "strerror", None) or type(error).__name__
    return f"video {path} is no video file that FFmpeg can read ({reason})"


def _best_stream(path: Path, container: Any) -> Any:
    """Return the largest video stream; two square ones are the raw circles of a camera."""
    streams = [
        stream
        for stream in container.streams.video
        if stream.codec_context is not None  # FFmpeg knows its codec
        and stream.width
        and stream.height
        and not _is_cover(stream)
    ]
    if not streams:
        raise ValueError(f"video {path} holds no video stream, only sound or other data")
    best = max(streams, key=lambda stream: stream.width * stream.height)
    twins = [s for s in streams if (s.width, s.height) == (best.width, best.height)]
    is_panorama = abs(best.width - 2 * best.height) <= 0.02 * best.width
    raw = path.suffix.lower() in _CAMERA_SUFFIXES
    if not is_panorama and (len(twins) > 1 or raw):
        raise ValueError(
            f"video {path} is a raw 360 video ({len(twins)} streams of {best.width}x{best.height})"
            f"; {_EXPORT}"
        )
    if best.width * best.height > MAX_PIXELS:
        raise ValueError(f"video {path} has frames of more than {MAX_PIXELS} pixels; reduce it")
    return best


def _is_cover(stream: Any) -> bool:
    """Whether a stream is the still picture of a file, such as a preview."""
    return "attached_pic" in str(stream.disposition).lower()


def _first_frame(av: Any, path: Path, container: Any, stream: Any) -> Any:
    for packet in _packets(av, container, stream):
        try:
            for frame in stream.decode(packet):
                return frame
        except av.error.FFmpegError:
            continue
    raise ValueError(f"video {path} has no frame that can be decoded; copy or export it again")


def _packets(av: Any, container: Any, stream: Any) -> Iterator[Any]:
    """Packets of a stream, and at the end an empty one or None, which empty the decoder."""
    try:
        yield from container.demux(stream)
    except av.error.FFmpegError:  # cut off inside a packet
        yield None


def _side_data(frame: Any) -> bytes | None:
    for item in frame.side_data:
        if getattr(getattr(item, "type", None), "name", "") == "SPHERICAL":
            return bytes(item)
    return None


def _check_sphere(path: Path, image: NDArray[np.uint8], sphere: VideoSphere) -> None:
    if looks_like_dual_fisheye(image) or sphere.projection == "fisheye":
        raise ValueError(
            f"video {path} shows raw dual fisheye frames (two circles on black); {_EXPORT}"
        )
    if sphere.projection not in (None, "equirectangular", "half equirectangular", "rectilinear"):
        raise ValueError(
            f"video {path} has the projection {sphere.projection}; export it as equirectangular"
        )
    if sphere.stereo not in (None, "mono"):
        raise ValueError(f"video {path} has two eyes ({sphere.stereo}); export one of them")


def _times(container: Any, stream: Any) -> tuple[float | None, float | None, int | None]:
    """Frame rate, time at which the last frame ends, and number of frames."""
    rate = stream.average_rate or stream.guessed_rate
    duration = None
    if stream.duration is not None and stream.time_base is not None:
        duration = float((stream.duration + (stream.start_time or 0)) * stream.time_base)
    elif container.duration is not None and len(container.streams) == 1:
        duration = (container.duration + max(container.start_time or 0, 0)) / 1e6
    return float(rate) if rate else None, duration, stream.frames or None


def _video_frame(index: int, timestamp_s: float, frame: Any) -> VideoFrame:
    if frame is None:
        error = f"frame {index} ({timestamp_s:.2f} s) is damaged"
        return VideoFrame(index, timestamp_s, None, error)
    return VideoFrame(index, timestamp_s, _upright(frame))


def _upright(frame: Any) -> NDArray[np.uint8]:
    """RGB picture of a frame, turned as the file says: phones write how they were held."""
    image: NDArray[np.uint8] = frame.to_ndarray(format="rgb24")
    turns = round(getattr(frame, "rotation", 0) / 90) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image
