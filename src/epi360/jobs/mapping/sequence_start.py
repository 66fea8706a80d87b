# SPDX-License-Identifier: BSD-3-Clause
"""Poses from which a sequence of images is mapped: those of the odometry over its frames."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.calibration import own
from epi360.cameras.calibration.own import camera_record
from epi360.extras import package_version
from epi360.features.images import nadir_mask, read_mask, read_masked_image
from epi360.jobs.folder.image_set import ImageSet
from epi360.jobs.folder.masks import MaskSource
from epi360.jobs.frames.frame_source import SourceFrame, open_frames
from epi360.jobs.frames.frames_job import content_key
from epi360.jobs.matching.tracked_lens import agreed_camera
from epi360.jobs.pairs.pair_selection import NUMBERED
from epi360.jobs.records.match_store import DIGESTS
from epi360.odometry import Odometry
from epi360.odometry.frame_result import FrameResult
from epi360.odometry.options import OdometryOptions
from epi360.odometry.pictures import joint_mask
from epi360.poses import Pose
from epi360.progress import Progress, no_progress
from epi360.runs.file_digests import FileDigests
from epi360.runs.made_from import fingerprint, read_record, write_record

STAGE = "tracking frames"
# By the given camera, and by the lens that the tracks, or pairs of images, agree on.
TRACKED, BY_TRACKS, BY_PAIRS = "tracked.json", "tracked-again.json", "tracked-by-pairs.json"
RULES = 6  # of what counts as a sequence: other rules, other poses
# From one panorama of a real tour to the next, 0 to 10 of 800 points can be followed; from one
# frame of a video to the next, 700 and more.
_FEWEST_FOLLOWED = 40
_MOST_JUMPS = 0.1  # share of the images
_LEAST_TRACKED = 0.8  # share of the images that need a pose
_FEWEST_IMAGES = 4


@dataclass(frozen=True, eq=False)
class SequenceStart:
    """What the odometry says of the images of a sequence.

    ``depth`` is the median distance of the landmarks around an image, in the unit of the poses.
    ``reason`` says why there are no poses to start from; it is empty if there are. ``past_gaps``
    are the frames before which others are missing, if that is why. ``lens`` is another one on which
    the tracks agree.
    """

    cam_from_world: dict[str, Pose] = field(default_factory=dict)
    depth: dict[str, float] = field(default_factory=dict)
    num_frames: int = 0
    num_tracked: int = 0
    seconds: float = 0.0
    reason: str = ""
    past_gaps: tuple[str, ...] = ()
    lens: Camera | None = None

    def summary(self) -> dict[str, Any]:
        """What a record says of it."""
        return {
            "num_frames": self.num_frames,
            "num_tracked": self.num_tracked,
            "num_images": len(self.cam_from_world),
            "seconds": self.seconds,
            "reason": self.reason,
            "past_gaps": list(self.past_gaps),
        }


def may_be_sequence(images: ImageSet) -> bool:
    """Whether the images of one camera have names that differ in a number only."""
    names = [NUMBERED.fullmatch(image.name) for image in images.images]
    beginnings = {match[1] for match in names if match is not None}
    return (
        None not in names
        and len(beginnings) == 1
        and len(names) >= _FEWEST_IMAGES
        and has_one_camera(images)
    )


def has_one_camera(images: ImageSet) -> bool:
    """Whether one camera has taken all images: the odometry knows no rigs."""
    return not images.cam_from_rig and len({image.camera for image in images.images}) == 1


def track_sequence(
    images: ImageSet,
    output: Path,
    *,
    video: Path | None = None,
    mask: Path | None = None,
    mask_nadir_deg: float = 0.0,
    seed: int = 0,
    keep_cameras: bool = False,
    num_threads: int | None = None,
    record: str = TRACKED,
    progress: Progress = no_progress,
) -> SequenceStart:
    """Poses of the images of a sequence; ``output`` keeps them in a ``record`` for later runs.

    If the images are frames of a ``video``, all its frames are followed up to the last of them,
    with ``mask`` as `MaskSource` takes it. Where points cannot be followed from one image to the
    next, or too many images stay without a pose, it is no sequence, and the result says so. It also
    says if the tracks agree on another lens, see `agreed_camera`, unless ``keep_cameras``.
    """
    frames = _Frames(images, video, mask)
    made_from = frames.fingerprint(output, mask_nadir_deg, seed, keep_cameras)
    before = read_record(output / record, remedy="delete it") or {}
    if before.get("fingerprint") == made_from:
        return _from_record(before)
    found, odometry = _track(frames, images, mask_nadir_deg, seed, progress)
    if odometry is not None and not keep_cameras:
        agreed = agreed_camera(odometry.key_frames(), frames.camera, seed, num_threads)
        found = replace(found, lens=None if agreed is None else agreed.camera)
    poses = {name: pose.matrix().tolist() for name, pose in found.cam_from_world.items()}
    kept = {**found.summary(), "depth": found.depth, "cam_from_world": poses}
    kept["lens"] = None if found.lens is None else camera_record(found.lens)
    write_record(output / record, {"fingerprint": made_from, **kept})
    return found


def _from_record(record: dict[str, Any]) -> SequenceStart:
    matrices = record["cam_from_world"]
    return SequenceStart(
        {name: Pose.from_matrix(np.array(matrix)) for name, matrix in matrices.items()},
        record["depth"],
        record["num_frames"],
        record["num_tracked"],
        record["seconds"],
        record["reason"],
        tuple(record["past_gaps"]),
        None if record["lens"] is None else own.read(record["lens"])["camera"],
    )


class _Frames:
    """Frames to follow, in order, with their masks."""

    def __init__(self, images: ImageSet, video: Path | None, mask: Path | None) -> None:
        self._images, self._video = images, video
        self._masks = {image.name: image.mask for image in images.images}
        self._others = MaskSource(mask)  # of frames of the video that are no images
        self.camera: Camera = images.cameras[images.images[0].camera]
        self._source = None if video is None else open_frames(video)
        total = len(images.images) if self._source is None else self._source.num_frames
        self.num_frames = total or 0

    def fingerprint(self, output: Path, *options: object) -> str:
        """Hash of all that the poses depend on, beside what is in the output."""
        digests = FileDigests(output / DIGESTS)
        rules = (RULES, package_version(), OdometryOptions(), self.camera, *options)
        pieces: list[object] = [rules]
        pieces.append(b"" if self._video is None else content_key(self._video))
        files: list[tuple[str, Sequence[Path | None]]] = [
            (image.name, (image.path, image.mask)) for image in self._images.images
        ]
        if self._video is not None:
            files.append(("masks of other frames", self._others.files()))
        for name, paths in files:
            pieces.append((name,))
            for path in paths:
                try:
                    pieces.append(b"" if path is None else digests.digest_of(path))
                except OSError:
                    pieces.append(b"?")
        digests.save()
        return fingerprint(*pieces)

    def __iter__(self) -> Iterator[SourceFrame]:
        """Frames up to the last image."""
        if self._source is None:
            yield from self._pictures()
            return
        last = self._images.images[-1].name
        for frame in self._source:
            yield frame
            if frame.name == last:
                return

    def _pictures(self) -> Iterable[SourceFrame]:
        for image in self._images.images:
            try:
                yield SourceFrame(image.name, None, *read_masked_image(image.path))
            except (OSError, ValueError) as error:
                yield SourceFrame(image.name, None, error)

    def mask_of(self, name: str) -> NDArray[np.bool_] | None:
        """Pixels of a frame to use; ``OSError`` or ``ValueError`` if its mask is no picture."""
        path = self._masks[name] if name in self._masks else self._others.mask_of(name)
        return None if path is None else read_mask(path, (self.camera.height, self.camera.width))


def _track(
    frames: _Frames, images: ImageSet, mask_nadir_deg: float, seed: int, progress: Progress
) -> tuple[SequenceStart, Odometry | None]:
    """Poses of the images, and the odometry that found them; None where it was given up."""
    begun = time.perf_counter()
    usable = nadir_mask(frames.camera, mask_nadir_deg)
    odometry = Odometry(frames.camera, mask=None if usable.all() else usable, seed=seed)
    names: list[str] = []
    past_gaps: list[int] = []
    num_jumps, most_jumps = 0, max(1.0, _MOST_JUMPS * len(images.images))
    progress(STAGE, 0, max(frames.num_frames, 1))
    for frame in frames:
        names.append(frame.name)
        result = _added(odometry, frame, frames)
        num_jumps += len(names) > 1 and result.num_tracked < _FEWEST_FOLLOWED
        progress(STAGE, len(names), max(frames.num_frames, len(names)))
        if result.follows_gap:  # what comes then may be another part of a place that repeats itself
            past_gaps.append(result.index)
        if num_jumps > most_jumps:
            reason = "points cannot be followed from image to image"
            return _given_up(reason, names, begun), None
    past_gaps = [index for index in past_gaps if not odometry.began_past(index)]
    if past_gaps:
        reason = f"frames seem to be missing before {names[past_gaps[0]]}"
        told = tuple(names[index] for index in past_gaps)
        return replace(_given_up(reason, names, begun), past_gaps=told), None
    if len(names) < frames.num_frames:  # the rest of the video shows nothing of the images
        progress(STAGE, len(names), len(names))
    odometry.finish()
    return _start_from(odometry, names, images, time.perf_counter() - begun), odometry


def _given_up(reason: str, names: Sequence[str], begun: float) -> SequenceStart:
    """No poses, for a reason."""
    seconds = time.perf_counter() - begun
    return SequenceStart(num_frames=len(names), seconds=seconds, reason=reason)


def _added(odometry: Odometry, frame: SourceFrame, frames: _Frames) -> FrameResult:
    """Follow one more frame."""
    if isinstance(frame.image, Exception):
        return odometry.skip_frame(str(frame.image), frame.timestamp_s)
    try:
        mask = joint_mask(frames.camera, frames.mask_of(frame.name), frame.usable)
    except (OSError, ValueError) as error:
        return odometry.skip_frame(str(error), frame.timestamp_s)
    return odometry.add_frame(frame.image, frame.timestamp_s, mask=mask)


def _start_from(
    odometry: Odometry, names: list[str], images: ImageSet, seconds: float
) -> SequenceStart:
    results = odometry.results()
    tracked = {
        name: result.cam_from_world
        for name, result in zip(names, results, strict=True)
        if result.status == "tracked"
    }
    poses = {image.name: tracked[image.name] for image in images.images if image.name in tracked}
    if len(poses) < _LEAST_TRACKED * len(images.images):
        said = {result.status for result in results}
        reason = f"{len(poses)} of {len(images.images)} images can be tracked"
        if said <= {"static", "turning", "waiting"}:
            reason = "the camera has not moved far enough"
        return SequenceStart({}, {}, len(names), len(tracked), seconds, reason)
    index_of = {name: index for index, name in enumerate(names)}
    depth = _depths(odometry, {name: index_of[name] for name in poses})
    return SequenceStart(poses, depth, len(names), len(tracked), seconds)


def _depths(odometry: Odometry, index_of: dict[str, int]) -> dict[str, float]:
    """Median distance of the landmarks that the key frame nearest in time sees, by image."""
    key_frames, points = odometry.key_frames(), odometry.points()
    centers = np.array([frame.center for frame in key_frames])
    offsets = points.positions[points.point_index] - centers[points.key_frame_index]
    distances = np.linalg.norm(offsets, axis=1)
    everywhere = float(np.median(distances)) if len(distances) else float("inf")
    seen = [distances[points.key_frame_index == row] for row in range(len(key_frames))]
    medians = [float(np.median(each)) if len(each) else everywhere for each in seen]
    times = np.array([frame.index for frame in key_frames])
    return {
        name: medians[int(np.argmin(np.abs(times - index)))] for name, index in index_of.items()
    }
