# SPDX-License-Identifier: BSD-3-Clause
"""The report of a sequence: its way and map in 3D, and what is known of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from epi360.odometry import FrameResult
from epi360.report.html_page import Page, escaped, packed
from epi360.report.model_scene import cloud_scene
from epi360.report.text import counted
from epi360.report.track_pictures import TrackPictures
from epi360.report.track_words import (
    STATUS_MEANINGS,
    positions_of,
    stretches_of,
    track_sentences,
)
from epi360.report.webgl import MISSING, find_webgl_library
from epi360.runs.whole_files import PathLike, write_file

if TYPE_CHECKING:
    from epi360.jobs.tracking.track_job import TrackRun

Array = NDArray[np.float64]

SCRIPTS = ("geometry.js", "scene.js", "table.js", "timeline.js", "track.js")
_MOST_CAMERAS = 400  # key frames that are drawn; the way is drawn whole
_LOST_SHOWN = 12  # stretches of lost frames whose first picture is shown
_LOG_LINES = 500


def write_track_report(path: PathLike, name: str, run: TrackRun, pictures: TrackPictures) -> None:
    """Write the report of `track_frames`; ``pictures`` has watched the run."""
    write_file(path, track_page(name, run, pictures).encode())


def track_page(name: str, run: TrackRun, pictures: TrackPictures) -> Page:
    """Return the page of a tracked sequence."""
    scene, shown = _scene(run, pictures)
    webgl = find_webgl_library() if scene else None
    lost = [each.first for each in stretches_of(run.results) if each.status == "lost"]
    addresses = pictures.addresses(sorted({*shown, *lost[:_LOST_SHOWN]}))
    data = {
        "names": list(run.names),
        "times": [round(float(result.timestamp_s), 4) for result in run.results],
        "statuses": [result.status for result in run.results],
        "messages": {str(each.index): _message(each) for each in run.results if each.message},
        "keys": [result.index for result in run.results if result.is_keyframe],
        "loops": [
            [each.index, each.loop_frame] for each in run.results if each.loop_frame is not None
        ],
        "curves": _curves(run.results),
        "cameras": shown,
        "pictures": [{"frame": frame, "picture": text} for frame, text in addresses.items()],
        "scene": scene,
        "has_webgl": webgl is not None,
    }
    title = f"Trajectory of {name}"
    body = _body(title, run, has_scene=scene is not None, has_webgl=webgl is not None)
    return Page(title, body, data, SCRIPTS, webgl)


def _message(result: FrameResult) -> str:
    return result.message.removeprefix(f"frame {result.index}: ").rstrip(".")


def _scene(run: TrackRun, pictures: TrackPictures) -> tuple[dict[str, Any] | None, list[int]]:
    """Return the scene, and the frames of its cameras."""
    odometry = pictures.odometry
    if odometry is None or not odometry.key_frames():
        return None, []
    key_frames = odometry.key_frames()
    chosen = key_frames[:: max(1, -(-len(key_frames) // _MOST_CAMERAS))]
    points = odometry.points()
    poses = [each.cam_from_world for each in chosen]
    positions = positions_of(run.results)
    loops = [
        [positions[each.index].tolist(), positions[each.loop_frame].tolist()]
        for each in run.results
        if each.loop_frame is not None and each.status == "tracked"
    ]
    scene = cloud_scene([""] * len(poses), poses, points.positions, points.colors)
    scene |= {
        "path": packed(positions),
        "loops": [ends for ends in loops if np.isfinite(ends).all()],
    }
    return scene, [each.index for each in chosen]


def _curves(results: Sequence[FrameResult]) -> list[dict[str, Any]]:
    """Return what is plotted over the frames; None where a frame has no value."""
    tracked = [result.status == "tracked" for result in results]
    inliers = [
        each.num_inliers if is_in else None for each, is_in in zip(results, tracked, strict=True)
    ]
    stamps = np.array([result.timestamp_s for result in results])
    has_times = not np.array_equal(stamps, np.arange(len(stamps)))
    unit = "second" if has_times else "frame"
    speeds, turns = _steps(results, stamps)
    return [
        {"title": "points of the map that agree", "values": inliers},
        {"title": f"speed (units a {unit})", "values": _plain(speeds)},
        {"title": f"turn (degrees a {unit})", "values": _plain(turns)},
    ]


def _steps(results: Sequence[FrameResult], stamps: Array) -> tuple[Array, Array]:
    """Return speed and turn from the frame before to each frame; NaN where one has no pose."""
    speeds = np.full(len(results), np.nan)
    turns = np.full(len(results), np.nan)
    positions = positions_of(results)
    for i in range(1, len(results)):
        duration = stamps[i] - stamps[i - 1]
        if not duration > 0:
            continue
        speeds[i] = np.linalg.norm(positions[i] - positions[i - 1]) / duration
        before, now = (results[k].cam_from_world.rotation for k in (i - 1, i))
        # The chord between two rotations: arccos of the trace loses small angles.
        half_chord = np.linalg.norm(now - before) / np.sqrt(8.0)
        turns[i] = np.degrees(2.0 * np.arcsin(np.clip(half_chord, 0.0, 1.0))) / duration
    return speeds, turns


def _plain(values: Array) -> list[float | None]:
    return [round(float(f"{value:.4g}"), 4) if np.isfinite(value) else None for value in values]


def _body(title: str, run: TrackRun, *, has_scene: bool, has_webgl: bool) -> str:
    sentences = "".join(f"<p>{escaped(text)}</p>" for text in track_sentences(run))
    kind = " ok" if run.counts["tracked"] > 0.5 * len(run.results) else ""
    hint = "Point at the plot to see what is known of a frame, and click to choose it."
    options = "".join(f"<option>{status}</option>" for status in STATUS_MEANINGS)
    return f"""<h1>{escaped(title)}</h1>
<section class="verdict{kind}">{sentences}</section>
{_view(has_scene, has_webgl)}
<h2>Each frame</h2>
{_legend(run)}
<div class="timeline"></div>
<p class="says">{hint}</p>
<h2>Key frames and lost frames</h2>
<p>Click a picture to choose it. Of each stretch of lost frames the first one is shown.</p>
<div class="row thumbnails"></div>
{_log(run)}
<h2>The frames</h2>
<div class="table"><div class="filters">
<label>Name or message contains <input type="search" name="text"></label>
<label>Status <select name="status"><option value="">all</option>{options}</select></label>
<label><input type="checkbox" name="keys"> key frames only</label></div>
<p class="count" aria-live="polite"></p>
<div class="wide"><table class="frames"><thead></thead><tbody></tbody></table></div>
<p><button name="more">Show more frames</button></p></div>"""


def _view(has_scene: bool, has_webgl: bool) -> str:
    chosen = """<figure class="chosen"><img alt="The chosen frame">
<figcaption></figcaption><p class="bar"><button name="earlier">Previous picture</button>
<button name="later">Next picture</button></p></figure>"""
    if not has_scene:
        return f"<h2>The pictures</h2>{chosen}"
    how = (
        "Drag to turn, scroll to zoom, and click a yellow camera to see its picture. Each key "
        "frame has its axes: x in red, y in green, z in blue. The grey line is the way of all "
        "frames; a red line joins the two frames of a loop."
    )
    if not has_webgl:
        how = f"The way from above, x to the right and z up. Click a camera. {MISSING}"
    return (
        f"<h2>The way and the map</h2><p>{escaped(how)}</p>"
        f'<div class="side"><div class="scene"></div>{chosen}</div>'
    )


def _legend(run: TrackRun) -> str:
    counts = run.counts
    items = "".join(
        f'<li><svg viewBox="0 0 14 14"><rect class="{status}" width="14" height="14"/></svg>'
        f"<b>{status}</b>, {counted(counts[status], 'frame')}: {meaning}</li>"
        for status, meaning in STATUS_MEANINGS.items()
        if counts[status]
    )
    return f'<ul class="statuses">{items}</ul>'


def _log(run: TrackRun) -> str:
    lines = [*run.messages, *run.written.remarks]
    if not lines:
        return ""
    items = "".join(f"<li>{escaped(line)}</li>" for line in lines[:_LOG_LINES])
    if len(lines) > _LOG_LINES:
        items += f"<li>and {len(lines) - _LOG_LINES} more in track.json</li>"
    return f'<h2>What the log says</h2><ul class="log">{items}</ul>'
