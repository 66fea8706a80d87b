# SPDX-License-Identifier: BSD-3-Clause
"""A tracked sequence in whole sentences: where its trajectory starts and ends, and what is lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np
from numpy.typing import NDArray

from epi360.odometry.frame_result import FrameResult, FrameStatus
from epi360.report.text import counted

if TYPE_CHECKING:
    from epi360.jobs.tracking.track_job import TrackRun

STATUS_MEANINGS: dict[FrameStatus, str] = {
    "tracked": "the frame has a pose",
    "waiting": "the camera has moved, but too little for a first map",
    "static": "it has not moved since the first frame",
    "turning": "it has only turned since the first frame",
    "lost": "the frame shows nothing that the map knows, or could not be read",
}
assert tuple(STATUS_MEANINGS) == get_args(FrameStatus)
_NAMED = 8  # stretches without a pose, and loops, that are said one by one


@dataclass(frozen=True)
class Stretch:
    """Frames in a row with the same status."""

    status: str
    first: int
    last: int


def stretches_of(results: Sequence[FrameResult]) -> list[Stretch]:
    """Return the runs of frames with one status, in order."""
    found: list[Stretch] = []
    for number, result in enumerate(results):
        first = number
        if found and found[-1].status == result.status:
            first = found.pop().first
        found.append(Stretch(result.status, first, number))
    return found


def why_no_trajectory(run: TrackRun) -> str:
    """Return what most frames say where there is no trajectory."""
    counts = run.counts
    if counts["static"] + counts["turning"] > 0.5 * len(run.results):
        return "the camera does not move" + (", it only turns" if counts["turning"] else "")
    if counts["lost"] > 0.5 * len(run.results):
        return "most frames cannot be used"
    return "the camera moves too little"


def agreed_sentence(run: TrackRun) -> str:
    """Return what is said of a lens that is another one than was given."""
    return (
        f"The tracks agree on other angles of the lens: {run.agreed}. All frames were tracked "
        "again by these, which camera.json in the output has; --keep-cameras keeps those that "
        "were given."
    )


def track_sentences(run: TrackRun) -> list[str]:
    """Return what became of a sequence, the most important first."""
    num_tracked = run.counts["tracked"]
    ending = []
    if run.was_interrupted:
        ending = [f"The run was interrupted after {counted(len(run.results), 'frame')}."]
    if not num_tracked:
        return [
            *ending,
            f"There is no trajectory: {why_no_trajectory(run)}.",
            *_stretch_words(run.results),
        ]
    first = next(result for result in run.results if result.status == "tracked")
    parts = ""
    if run.num_maps > 1:
        parts = (
            f" The sequence fell into {run.num_maps} parts that could not be connected, and what "
            "is shown is the part with most frames."
        )
    return [
        *ending,
        f"The camera was followed through {num_tracked} of {len(run.results)} frames, from frame "
        f"{first.index} on.{parts}",
        f"The map has {counted(run.num_key_frames, 'key frame')} and {run.num_points} points.",
        *([agreed_sentence(run)] if run.agreed else []),
        *_way_words(run.results),
        *_loop_words(run.results),
        *_stretch_words(run.results),
    ]


def positions_of(results: Sequence[FrameResult]) -> NDArray[np.float64]:
    """Return where the camera was (F, 3), NaN for frames without a pose."""
    return np.array(
        [-(each.cam_from_world.rotation.T @ each.cam_from_world.translation) for each in results]
    ).reshape(-1, 3)


def _way_words(results: Sequence[FrameResult]) -> list[str]:
    positions = positions_of(results)
    known = positions[np.isfinite(positions).all(axis=1)]
    length = float(np.linalg.norm(np.diff(known, axis=0), axis=1).sum())
    apart = float(np.linalg.norm(known[-1] - known[0]))
    return [
        f"The way is {length:.3g} units long, and its ends are {apart:.3g} units apart. A unit is "
        "the distance between the two frames with which the map began: one camera alone does not "
        "know metres."
    ]


def _loop_words(results: Sequence[FrameResult]) -> list[str]:
    found = [result for result in results if result.loop_frame is not None]
    joins = [each for each in found if "joins map" in each.message]
    loops = [each for each in found if each not in joins]
    sentences = ["No loop was closed."]
    if loops:
        how_many = "One loop was" if len(loops) == 1 else f"{len(loops)} loops were"
        sentences = [f"{how_many} closed: {_where(loops)}."]
    if joins:
        sentences.append(f"The sequence fell into parts that were joined again: {_where(joins)}.")
    return sentences


def _where(found: Sequence[FrameResult]) -> str:
    """Which frames are where others were, the first few of them."""
    items = [f"frame {each.index} is where frame {each.loop_frame} was" for each in found]
    more = f", and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return f"{', '.join(items[:_NAMED])}{more}"


def _stretch_words(results: Sequence[FrameResult]) -> list[str]:
    others = [each for each in stretches_of(results) if each.status != "tracked"]
    sentences = [_stretch_sentence(each, results) for each in others[:_NAMED]]
    if len(others) > _NAMED:
        sentences.append(f"There are {len(others) - _NAMED} more stretches without a pose.")
    return sentences


def _stretch_sentence(stretch: Stretch, results: Sequence[FrameResult]) -> str:
    are = "are" if stretch.last > stretch.first else "is"
    which = f"Frame {stretch.first}"
    if stretch.last > stretch.first:
        which = f"Frames {stretch.first} to {stretch.last}"
    inside = results[stretch.first : stretch.last + 1]
    said = next((each.message for each in inside if each.message), "")
    return f"{which} {are} {stretch.status}.{f' The log says of {said}.' if said else ''}"
