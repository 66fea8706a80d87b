# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 frames``: images of a video, and the video that a command takes in place of a folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Group, Parameter

from epi360.cli.command import FILES, SUCCESS, app, show_bars

if TYPE_CHECKING:
    from epi360.jobs.frames.frames_job import FramesRun


@Parameter(name="*", group=Group("Choice", sort_key=1))
@dataclass(frozen=True)
class FramesChoice:
    """Which frames are written."""

    every: int | None = None
    """Every n-th frame. Without it, sharp frames between which the camera has moved."""
    parallax_deg: float | None = None
    """Parallax between a chosen frame and the next: half of the points move by more, what the
    camera turned taken out. Default: 3, or 1 or 0.3 where that gives less than 20 frames."""
    start: float | None = None
    """Seconds of the video to begin at."""
    end: float | None = None
    """Seconds of the video to end at."""


@Parameter(name="*", group=Group("Pictures", sort_key=2))
@dataclass(frozen=True)
class FramesPictures:
    """What is known of the pictures, and how they are written."""

    camera: str | None = None
    """Calibration file, FILE or FILE:NAME; without it, frames are panoramas."""
    mask: Path | None = None
    """Mask of all frames, white = use: what is black does not count in the choice."""
    mask_nadir_deg: float = 0.0
    """The same for this angle around straight down."""
    jpeg_quality: int = 95
    """Quality of the JPEG files, 1 to 100."""


ANY_FRAMES, ANY_PICTURES = FramesChoice(), FramesPictures()


@app.command(group=FILES, sort_key=1)
def frames(
    video: Path,
    out: Path,
    /,
    *,
    choice: FramesChoice = ANY_FRAMES,
    pictures: FramesPictures = ANY_PICTURES,
) -> int:
    """Write frames of a video as images, chosen by how far the camera moved and by sharpness.

    OUT gets NAME_000123.jpg, ... with the numbers of the frames in the video from 0, and
    frames.csv: image, timestamp_s (the file's own times), index and parallax_deg to the frame
    before. The same command goes on where it was stopped; while it chose frames, it begins again.

    Parameters
    ----------
    video
        MP4, MOV, MKV, or an .insv or .360 file that holds a stitched stream.
    out
        New folder, or one that the same command began.
    """
    from epi360.jobs.frames.frames_job import FramesOptions, extract_frames

    options = FramesOptions(
        every=choice.every,
        parallax_deg=choice.parallax_deg,
        start_s=choice.start,
        end_s=choice.end,
        jpeg_quality=pictures.jpeg_quality,
        camera=pictures.camera,
        mask=pictures.mask,
        mask_nadir_deg=pictures.mask_nadir_deg,
    )
    with show_bars() as progress:
        run = extract_frames(video, out, options, progress=progress)
    print(_describe(run), flush=True)
    return SUCCESS


def folder_of(
    source: Path,
    output: Path,
    *,
    camera: str | None,
    mask: Path | None,
    mask_nadir_deg: float,
    restart: bool,
) -> Path:
    """Return a folder of images as it is; frames of a video are written below the output first."""
    from epi360.interop.video import is_video
    from epi360.jobs.frames.frames_job import FramesOptions, extract_frames

    if not (is_video(source) or source.is_file()):
        return source
    options = FramesOptions(
        camera=camera,
        mask=mask if mask is not None and mask.is_file() else None,
        mask_nadir_deg=mask_nadir_deg,
    )
    with show_bars() as progress:
        run = extract_frames(
            source,
            output / "frames",
            options,
            restart=restart,
            remedy="choose another --output, or --restart to choose frames again",
            progress=progress,
        )
    print(_describe(run), flush=True)
    return run.folder


def _describe(run: FramesRun) -> str:
    first, last = run.chosen[0], run.chosen[-1]
    lines = [
        f"{len(run.chosen)} of {run.num_frames} frames, {first.timestamp_s:.2f} to "
        f"{last.timestamp_s:.2f} s, in {run.folder}",
        *(f"note: {remark}" for remark in run.remarks),
    ]
    return "\n".join(lines)
