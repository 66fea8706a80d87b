# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 track``: a video or a folder of images to a trajectory and a map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from epi360.cli.command import (
    FAILURE,
    OUT_NAMES,
    POSES,
    SUCCESS,
    Flag,
    app,
    show_bars,
)
from epi360.cli.report_option import check_report

if TYPE_CHECKING:
    from epi360.jobs.tracking.track_job import TrackOptions, TrackRun, Watcher

NAMED = 20  # messages that are printed one by one; the log has all of them


@Parameter(name="*", group=Group("Frames", sort_key=1))
@dataclass(frozen=True)
class TrackInput:
    """What is known about the frames."""

    camera: str | None = None
    """Calibration file, FILE or FILE:NAME; without it, frames are panoramas."""
    keep_cameras: Flag = False
    """Keep the lens as it is given, even where the tracks agree that its angles are other ones."""
    mask: Path | None = None
    """Mask of all frames, or a folder with one for each; white = use. Large moving things, and
    whoever holds the camera, are best masked."""
    mask_nadir_deg: float = 0.0
    """Ignore this angle around straight down: a tripod and its holder."""
    upright: float | None = None
    """The frames stand upright to so many degrees (one sigma), as those of a camera that levels its
    panoramas. Not for frames that tilt with the hand."""
    start: float | None = None
    """Seconds of the video to begin at."""
    end: float | None = None
    """Seconds of the video to end at."""


@Parameter(name="*", group=Group("Tracking", sort_key=2))
@dataclass(frozen=True)
class TrackWork:
    """How frames are tracked."""

    max_width: int = 1600
    """Wider frames are tracked at this width."""
    max_points: int = 800
    """Most points that are followed at a time."""
    key_frame_parallax_deg: float = 3.0
    """A key frame is made when half of the points have moved by this angle."""
    no_loop_closure: Flag = False
    """Do not correct the trajectory where a place is seen again."""
    refine: Flag = False
    """Hand the key frames to COLMAP's bundle adjustment in the end (pycolmap)."""
    seed: int = 0
    """Random seed; the same seed gives the same result."""


ANY_FRAMES, DEFAULT_WORK = TrackInput(), TrackWork()
OUTPUT = Parameter(group=Group("Output", sort_key=3))


@app.command(group=POSES, sort_key=4)
def track(
    source: Path,
    /,
    *,
    given: TrackInput = ANY_FRAMES,
    work: TrackWork = DEFAULT_WORK,
    out: Annotated[Path | None, OUTPUT, Parameter(name=OUT_NAMES)] = None,
    view: Annotated[Flag, OUTPUT] = False,
    recording: Annotated[Path | None, OUTPUT] = None,
    report: Annotated[Path | None, OUTPUT] = None,
) -> int:
    """Follow the camera through a video or a folder of frames: trajectory and sparse map.

    Writes trajectory.txt (TUM), frames.csv, points.ply, a COLMAP model of the key frames in
    sparse/0, transforms.json and the log track.json. Exit code 0 with a trajectory, 1 without one
    or if a file could not be written, 2 for wrong use.

    Parameters
    ----------
    source
        Video, or folder of images in the order of their names.
    out
        Folder for the results; NAME-track in the current folder by default. An earlier track of
        the same frames is replaced there, that of others is not.
    view
        Show the trajectory and the map while they grow, in Rerun.
    recording
        Write what --view shows into this file (.rrd), with or without a window.
    report
        Write a page that a browser opens offline: the way and the map in 3D, what is known of each
        frame, pictures of the key frames; .html.

    Returns
    -------
    code
        Exit code.
    """
    from epi360.jobs.tracking.track_job import track_frames

    page = None if report is None else _Page(report, source)
    options = _options(given, work)
    out = _default_output(source) if out is None else out
    watchers: list[Watcher] = []
    if view or recording is not None:
        from epi360.jobs.tracking.track_view import TrackView

        watchers.append(TrackView(window=view, recording=recording))
    if page is not None:
        watchers.append(page.pictures)
    with show_bars() as progress:
        run = track_frames(
            source,
            out,
            options,
            progress=progress,
            watchers=watchers,
            interrupted=None if page is None else page.write,
        )
    print(_describe(run), flush=True)
    if page is not None:
        page.write(run)
        print(f"wrote {page.path}", flush=True)
    tracked = run.counts["tracked"]
    return SUCCESS if tracked and not run.written.failed else FAILURE


class _Page:
    """The report of a sequence, which an interrupted run writes too."""

    def __init__(self, path: Path, source: Path) -> None:
        from epi360.report.track_pictures import TrackPictures

        check_report(path)
        self.path, self._name = path, source.resolve().name
        self.pictures = TrackPictures()

    def write(self, run: TrackRun) -> None:
        """Write the page."""
        from epi360.report.track_page import write_track_report

        write_track_report(self.path, self._name, run, self.pictures)


def _options(given: TrackInput, work: TrackWork) -> TrackOptions:
    from epi360.jobs.tracking.track_job import TrackOptions
    from epi360.odometry import OdometryOptions

    odometry = OdometryOptions(
        max_points=work.max_points,
        max_width=work.max_width,
        key_frame_parallax_deg=work.key_frame_parallax_deg,
        loop_closure=not work.no_loop_closure,
    )
    return TrackOptions(
        camera=given.camera,
        mask=given.mask,
        mask_nadir_deg=given.mask_nadir_deg,
        upright_deg=given.upright,
        start_s=given.start,
        end_s=given.end,
        odometry=odometry,
        refine=work.refine,
        keep_cameras=given.keep_cameras,
        seed=work.seed,
    )


def _default_output(source: Path) -> Path:
    """NAME-track in the current folder, but never among the images."""
    if source.is_file():
        return Path(f"{source.stem}-track")
    images, here = source.resolve(), Path.cwd()
    name = f"{images.name}-track"
    return images.parent / name if here == images or images in here.parents else Path(name)


def _describe(run: TrackRun) -> str:
    """Lines for people: how many frames have a pose, from which one on, and what was odd."""
    from epi360.report.track_words import agreed_sentence, why_no_trajectory

    counts, results = run.counts, run.results
    tracked = [result for result in results if result.status == "tracked"]
    lines = [f"tracked      {len(tracked)} of {len(results)} frames"]
    others = [f"{count} {status}" for status, count in counts.items() if status != "tracked"]
    if others:
        lines[0] += f" ({', '.join(others)})"
    if tracked:
        lines.append(f"map          {run.num_key_frames} key frames, {run.num_points} points")
    else:
        lines.append(f"no trajectory: {why_no_trajectory(run)}")
    if run.num_maps > 1:
        lines.append(f"parts        {run.num_maps}; the results are of the one with most frames")
    if run.agreed:
        lines.append(f"lens         {agreed_sentence(run)}")
    lines.append(
        f"time         {run.seconds:.1f} s in all; "
        f"{run.frames_per_second:.1f}/s without reading the frames"
    )
    lines += [f"note         {message}" for message in run.messages[:NAMED]]
    if len(run.messages) > NAMED:
        lines.append(f"note         and {len(run.messages) - NAMED} more in track.json")
    lines += [f"note         {remark}" for remark in run.written.remarks]
    return "\n".join([*lines, f"wrote {run.output}"])
