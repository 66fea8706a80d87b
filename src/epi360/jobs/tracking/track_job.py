# SPDX-License-Identifier: BSD-3-Clause
"""A video or a folder of images to a trajectory and a map, with its files."""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.calibration import camera_file
from epi360.cameras.calibration.own import camera_record
from epi360.cameras.upright import DOWN, check_upright, gravity_of
from epi360.features.images import nadir_mask, read_mask
from epi360.features.picture_writing import encode_picture
from epi360.interop.upright_world import moved
from epi360.interop.video import is_video
from epi360.jobs.folder.given_cameras import read_given_cameras
from epi360.jobs.folder.masks import MaskSource
from epi360.jobs.frames.frame_source import FrameSource, SourceFrame, check_times, open_frames
from epi360.jobs.frames.frames_job import content_key
from epi360.jobs.matching.tracked_lens import AgreedCamera, agreed_camera
from epi360.jobs.tracking import track_files as files
from epi360.jobs.tracking.refine_map import refine_with_colmap
from epi360.odometry import Odometry, OdometryOptions
from epi360.odometry.frame_result import FrameResult
from epi360.odometry.pictures import joint_mask
from epi360.progress import Progress, no_progress
from epi360.runs.interrupts import interrupted_later
from epi360.runs.made_from import first_difference, read_record, write_record
from epi360.runs.whole_files import write_file

STAGE = "tracking frames"
_SECONDS_BETWEEN_FILES = 10.0  # a run that is killed loses no more of its trajectory
_JPEG_QUALITY = 95
_NUMBERED = re.compile(r"(.*?)(\d+)(\.\w+)")  # a name with a number before its extension


class Watcher(Protocol):
    """Who is shown each frame as soon as it is tracked, and the map in the end."""

    def __call__(
        self, odometry: Odometry, result: FrameResult, image: NDArray[np.uint8] | None
    ) -> None:
        """Show a frame."""

    def close(self, odometry: Odometry) -> None:
        """Show the final map."""


@dataclass(frozen=True)
class TrackOptions:
    """How a sequence is tracked, and what is known of its frames."""

    camera: str | None = None  # calibration file; None: panoramas
    mask: Path | None = None  # of all frames, or a folder with one for each
    mask_nadir_deg: float = 0.0
    start_s: float | None = None
    end_s: float | None = None
    upright_deg: float | None = None  # gravity is straight down in every frame, to one sigma
    odometry: OdometryOptions = field(default_factory=OdometryOptions)
    refine: bool = False
    keep_cameras: bool = False  # even where the tracks agree that the lens is another one
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the times."""
        check_times(self.start_s, self.end_s)


@dataclass(frozen=True, eq=False)
class TrackRun:
    """What `track_frames` found and wrote."""

    output: Path
    results: tuple[FrameResult, ...]
    names: tuple[str, ...]
    num_key_frames: int
    num_points: int
    num_maps: int
    frames_per_second: float  # of the odometry, reading the frames not counted
    seconds: float
    messages: tuple[str, ...]  # sentences about single frames, with their numbers
    written: files.Written
    was_interrupted: bool = False
    agreed: str = ""  # what is said of a lens that is another one than was given

    @property
    def counts(self) -> Counter[str]:
        """Number of frames of each status."""
        return Counter(result.status for result in self.results)


def track_frames(
    path: Path,
    output: Path,
    options: TrackOptions | None = None,
    *,
    progress: Progress = no_progress,
    watchers: Sequence[Watcher] = (),
    interrupted: Callable[[TrackRun], None] | None = None,
) -> TrackRun:
    """Track the frames of a video or folder, and write trajectory, map and log into ``output``.

    Rows of ``frames.csv`` are written while frames come in, and the trajectory every ten seconds;
    at the end all files are written whole. A frame that cannot be read is counted and named, and
    the run goes on. An interrupted run writes what it has, and hands it to ``interrupted`` before
    it raises KeyboardInterrupt.

    Where the tracks of the key frames agree that the lens is another one than was given, see
    `agreed_camera`, all frames are tracked once more by that, unless ``keep_cameras``;
    ``camera.json`` has it. Watchers are shown the frames again. Interrupted then, the run writes
    what it found by the given lens.

    What an earlier run into the same output has found is kept in its folder ``earlier`` until this
    one is done.

    Raises
    ------
    FileNotFoundError
        If the video or folder does not exist, or a folder has no images.
    ValueError
        If it is no video, its frames are no panoramas and no camera is given, a mask has another
        size than its frame, or the output holds files of something else or the track of another
        source.
    ImportError
        If PyAV is missing for a video, or pycolmap for a refinement.
    OSError
        If the output cannot be made.
    """
    options = options or TrackOptions()
    check_upright(options.upright_deg)
    source = open_frames(path, start_s=options.start_s, end_s=options.end_s)
    if options.camera is None:
        camera: Camera = source.camera()
    else:
        camera = read_given_cameras(options.camera).only()
    if options.upright_deg is not None:
        gravity_of(camera, None, path.name)  # refuses what is no panorama
    made_from = _made_from(source.path)
    run = _Run(source, camera, output, options, watchers, made_from)
    _prepare(output, made_from, options.camera)
    whole = run  # the last one that is to be finished where the next one is interrupted
    try:
        run.track(progress)
        agreed = None if options.keep_cameras else run.agreed_camera()
        if agreed is not None:
            run = run.by_another(agreed)
            run.track(progress)
        whole = run
        return run.finish(progress)
    except KeyboardInterrupt:
        found = whole.finish(progress, interrupted=True)
        if interrupted is not None:
            interrupted(found)
        raise


def _prepare(output: Path, made_from: Mapping[str, str], camera: str | None) -> None:
    """Make the output, or check that it is one of this function and of the same source.

    What an earlier run has written is moved aside until this one is done, but for the file of the
    camera that is given.
    """
    is_whole = False
    if output.exists() and not output.is_dir():
        raise ValueError(f"the output must be a folder, {output} is a file")
    if output.is_dir() and any(output.iterdir()):
        record = read_record(output / files.LOG, remedy="choose another folder")
        if record is None or "track" not in record:
            raise ValueError(
                f"{output} is not empty and holds no result of epi360 track; choose a new folder"
            )
        _check_source(output, record, made_from)
        is_whole = record["track"] == "done"
    given = None if camera is None else camera_file(camera)[0].resolve()
    results = [name for name in files.RESULTS if (output / name).resolve() != given]
    if is_whole:
        files.set_aside(output, results)
    else:
        files.remove(output, results)
    output.mkdir(parents=True, exist_ok=True)
    write_record(output / files.LOG, {"track": "began", "made_from": made_from})


def _made_from(source: Path) -> dict[str, str]:
    """What a track is of: a folder by its place, a video, which may be moved, by its content."""
    if source.is_dir():
        return {"folder": str(source.resolve())}
    return {"video": source.name, "content": content_key(source)}


def _check_source(output: Path, record: Mapping[str, Any], made_from: Mapping[str, str]) -> None:
    """Raise where the output holds the track of something else; earlier versions did not say."""
    before = record.get("made_from")
    if isinstance(before, dict) and first_difference(before, made_from):
        name = before.get("video") or before.get("folder")
        raise ValueError(
            f"{output} holds the track of another video or folder, {name}; choose another folder"
        )


def _check_masks(masks: MaskSource, source: FrameSource, camera: Camera) -> None:
    """Raise where a mask has another size than its frame, or no frame has one."""
    found = [masks.mask_of(name) for name in source.names or ()]
    used = dict.fromkeys(masks.files() if source.names is None else found)
    for mask in used:
        wrong = "" if mask is None else masks.wrong_size(mask, (camera.width, camera.height))
        if wrong:
            raise ValueError(f"each frame of {source.path} {wrong}")
    if source.names is not None:
        masks.check_used(found)


class _Run:
    """One sequence that is being tracked."""

    def __init__(
        self,
        source: FrameSource,
        camera: Camera,
        output: Path,
        options: TrackOptions,
        watchers: Sequence[Watcher],
        made_from: Mapping[str, str],
    ) -> None:
        self._source, self._camera, self._output = source, camera, output
        self._options, self._watchers, self._made_from = options, watchers, made_from
        self._masks = MaskSource(options.mask)
        _check_masks(self._masks, source, camera)
        one_mask = options.mask if options.mask is not None and options.mask.is_file() else None
        usable = nadir_mask(camera, options.mask_nadir_deg)
        if one_mask is not None:
            usable = usable & read_mask(one_mask, usable.shape)
        self.odometry = Odometry(
            camera,
            mask=None if usable.all() else usable,
            options=options.odometry,
            gravity=None if options.upright_deg is None else DOWN,
            gravity_sigma_deg=options.upright_deg or 1.0,
            seed=options.seed,
        )
        self._names: list[str] = []
        self._sizes: dict[int, tuple[int, int]] = {}  # of pictures with another one than the camera
        self._messages: list[str] = []
        self._status = ""  # of the frame before
        self._numbered: re.Match[str] | None = None  # the name of the frame before
        self._name_step = 0  # between the numbers of the first two names
        self._refused: set[str] = set()  # why masks are not used
        self._seconds = 0.0
        self._begun = time.perf_counter()
        self._agreed = ""  # what is said of a lens that is another one than was given

    def track(self, progress: Progress) -> None:
        """Track all frames."""
        table = files.FrameTable(self._output / files.FRAMES)
        save_at = time.monotonic() + _SECONDS_BETWEEN_FILES
        total = self._source.num_frames or 0
        progress(STAGE, 0, max(total, 1))
        try:
            for frame in self._source:
                with interrupted_later():
                    result = self._add(frame)
                table.add(frame.name, result)
                done = len(self._names)
                progress(STAGE, done, max(total, done))
                if time.monotonic() > save_at:
                    took = -time.monotonic()
                    self._save(table)
                    took += time.monotonic()
                    # No more than a twentieth of the time, however many frames there are.
                    save_at = time.monotonic() + max(_SECONDS_BETWEEN_FILES, 20 * took)
        finally:
            table.close()
        if table.error is not None:
            self._messages.append(f"{table.error}: rows were lost until the end of the run")
        if self._source.ending:
            self._messages.append(self._source.ending)

    def agreed_camera(self) -> AgreedCamera | None:
        """Another lens on which the tracks agree clearly."""
        return agreed_camera(self.odometry.key_frames(), self._camera, self._options.seed)

    def by_another(self, agreed: AgreedCamera) -> _Run:
        """The same sequence by another lens, with no frame tracked."""
        run = _Run(
            self._source,
            agreed.camera,
            self._output,
            self._options,
            self._watchers,
            self._made_from,
        )
        run._agreed, run._begun = agreed.said, self._begun
        return run

    def finish(self, progress: Progress, *, interrupted: bool = False) -> TrackRun:
        """Adjust the map once more, and write all files."""
        written = files.Written()
        if not interrupted:
            with interrupted_later():
                self.odometry.finish()
        if self._options.refine and interrupted:
            written.remarks.append("the map was not refined: the run was interrupted")
        elif self._options.refine and self.odometry.key_frames():
            try:
                self._messages.append(refine_with_colmap(self.odometry, self._camera))
            except ValueError as error:
                written.remarks.append(f"the map was not refined: {error}")
        results, output = self.odometry.results(), self._output
        points = self.odometry.points()
        if any(result.status == "tracked" for result in results):
            written.attempt(
                files.TRAJECTORY,
                lambda: files.write_trajectory(output / files.TRAJECTORY, self._names, results),
            )
        written.attempt(
            files.FRAMES, lambda: files.write_frames(output / files.FRAMES, self._names, results)
        )
        if self.odometry.key_frames():
            self._write_map(written, progress)
        if self._agreed:
            camera = camera_record(self._camera)
            written.attempt(files.CAMERA, lambda: write_record(output / files.CAMERA, camera))
        run = TrackRun(
            self._output,
            tuple(results),
            tuple(self._names),
            len(self.odometry.key_frames()),
            len(points.positions),
            self.odometry.num_segments,
            len(results) / self._seconds if self._seconds > 0 else 0.0,
            time.perf_counter() - self._begun,
            tuple(self._messages),
            written,
            interrupted,
            self._agreed,
        )
        for watcher in self._watchers:
            watcher.close(self.odometry)
        earlier = self._output / files.EARLIER
        is_needed = interrupted or written.failed
        if is_needed and earlier.is_dir():
            written.remarks.append(f"what an earlier run has found of all frames is in {earlier}")
        log = json.dumps(_log(run, self._made_from, self._options), indent=1).encode()
        written.attempt(files.LOG, lambda: write_file(self._output / files.LOG, log))
        if not is_needed and not written.failed:
            files.remove(earlier, (*files.RESULTS, files.LOG))
        return run

    def _add(self, frame: SourceFrame) -> FrameResult:
        """Track one frame; how long reading it took does not count."""
        begun = time.perf_counter()
        image: NDArray[np.uint8] | None = None
        if isinstance(frame.image, Exception):
            reason = " ".join(str(frame.image).split()) or type(frame.image).__name__
            result = self.odometry.skip_frame(f"cannot be read: {reason}", frame.timestamp_s)
        else:
            image = frame.image
            mask = joint_mask(self._camera, self._mask_of(frame.name), frame.usable)
            result = self.odometry.add_frame(image, frame.timestamp_s, mask=mask)
        self._seconds += time.perf_counter() - begun
        if not self._source.is_selection:
            self._name_gap(frame.name, result.index)
        self._names.append(frame.name)
        size = None if image is None else (image.shape[1], image.shape[0])
        if size is not None and size != (self._camera.width, self._camera.height):
            self._sizes[result.index] = size
        is_new = result.status in ("tracked", "lost") or result.status != self._status
        if result.message and is_new:
            self._messages.append(f"{result.message} ({frame.name})")
        self._status = result.status
        for watcher in self._watchers:
            watcher(self.odometry, result, image)
        return result

    def _name_gap(self, name: str, index: int) -> None:
        """Say that numbers are left out between the names of two images."""
        before, now = self._numbered, _NUMBERED.fullmatch(name)
        self._numbered = now
        if before is None or now is None or before[1] != now[1] or before[3] != now[3]:
            return
        step = int(now[2]) - int(before[2])
        if self._name_step and step > self._name_step:
            missing = step // self._name_step - 1
            self._messages.append(
                f"frame {index}: {missing} before it {'is' if missing == 1 else 'are'} missing, "
                f"{before[0]} is followed by {name}"
            )
        elif not self._name_step:
            self._name_step = step

    def _mask_of(self, name: str) -> NDArray[np.bool_] | None:
        mask = self._options.mask
        if mask is None or mask.is_file():
            return None
        path = self._masks.mask_of(name)
        if path is None:
            return None
        try:
            return read_mask(path, (self._camera.height, self._camera.width))
        except (OSError, ValueError) as error:
            if str(error) not in self._refused:
                self._messages.append(
                    f"the mask of {name}, and others like it, is not used: {error}"
                )
                self._refused.add(str(error))
            return None

    def _save(self, table: files.FrameTable) -> None:
        """Bring trajectory and table of the frames up to date while the run goes on."""
        results = self.odometry.results()
        if not self.odometry.key_frames():
            return
        try:
            path = self._output / files.TRAJECTORY
            files.write_trajectory(path, self._names, results)
        except OSError:
            return  # the end of the run tries again, and says so if it fails
        table.replace(self._names, results)

    def _write_map(self, written: files.Written, progress: Progress) -> None:
        key_frames = self.odometry.key_frames()
        model = files.key_frame_model(
            self._camera, self._names, key_frames, self.odometry.points(), self._sizes
        )
        model = moved(model, files.upright_world(self.odometry.results()))
        images = self._source.path
        if is_video(images) or images.is_file():
            images = self._output / files.IMAGES
            wanted = {self._names[each.index] for each in key_frames}
            written.attempt(
                files.IMAGES, lambda: _write_pictures(self._source, wanted, images, progress)
            )
        # Masks have the size of the camera: those of other pictures would not fit.
        masks = {
            self._names[each.index]: self._masks.mask_of(self._names[each.index])
            for each in key_frames
            if each.index not in self._sizes
        }
        nadir_deg = self._options.mask_nadir_deg
        files.write_model(self._output, model, images, masks, nadir_deg, written)


def _write_pictures(
    source: FrameSource, wanted: set[str], folder: Path, progress: Progress
) -> None:
    """Write the pictures of key frames of a video: the video is decoded once more."""
    folder.mkdir(exist_ok=True)
    done = 0
    progress("writing key frames", 0, len(wanted))
    for frame in source:
        if frame.name in wanted and not isinstance(frame.image, Exception):
            picture = encode_picture(frame.image, ".jpg", jpeg_quality=_JPEG_QUALITY)
            write_file(folder / frame.name, picture)
            done += 1
            progress("writing key frames", done, len(wanted))
        if done == len(wanted):
            return


def _log(run: TrackRun, made_from: Mapping[str, str], options: TrackOptions) -> dict[str, Any]:
    """What the JSON log says."""
    tracked = [result.index for result in run.results if result.status == "tracked"]
    recorded = asdict(replace(options, mask=None))
    recorded["mask"] = None if options.mask is None else str(options.mask)
    return {
        "track": "interrupted" if run.was_interrupted else "done",
        "made_from": made_from,
        "num_frames": len(run.results),
        "statuses": dict(run.counts),
        "first_tracked": tracked[0] if tracked else None,
        "num_key_frames": run.num_key_frames,
        "num_points": run.num_points,
        "num_maps": run.num_maps,
        "frames_per_second": round(run.frames_per_second, 2),
        "seconds": round(run.seconds, 2),
        "messages": list(run.messages),
        "agreed": run.agreed,
        "remarks": list(run.written.remarks),
        "options": recorded,
    }
