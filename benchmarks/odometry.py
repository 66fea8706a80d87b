# SPDX-License-Identifier: BSD-3-Clause
"""Odometry of 360 and fisheye sequences beside pycolmap's mappers: speed, errors, coverage, memory.

``python benchmarks/odometry.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from _data import data_folder
from _machine import fact_lines, load_average, machine_facts
from _odometry_data import CLIPS, EFFECTS, KNOWN, Clip, real_clip, rendered_clip
from _odometry_methods import METHODS, Placed
from _picture import add_picture_option, check_picture, panel_of, write_picture
from _summary import markdown_table, text_table

from epi360.jobs.evaluation import Evaluation, Statistics, evaluate
from epi360.jobs.trajectories import posed_frames
from epi360.report.files import check_writable
from epi360.runs.whole_files import write_file

PACKAGES = ("epi360", "pycolmap", "numpy", "opencv-python-headless")
HEADER = (
    "sequence", "method", "poses", "ATE %", "largest %", "RPE, frame", "RPE, m %", "rot deg",
    "frames/s", "with reading", "s", "CPU s",
)  # fmt: skip
BETWEEN_LINES = 500  # frames, of --memory


@dataclass(frozen=True)
class Run:
    """One method on one sequence; errors are NaN where there is no truth or no model."""

    sequence: str
    method: str
    num_frames: int
    num_poses: int
    ate_percent: float  # rms of the positions after Sim(3), of the path
    largest_percent: float
    rpe_frame: float  # rms of the translation from one frame to the next, in units of the truth
    rpe_metre_percent: float
    rotation_deg: float
    seconds: float
    reading_s: float  # decoding frames and masks; 0 where it is a part of the seconds
    cpu_s: float
    statuses: dict[str, int]

    def cells(self) -> list[str]:
        """Row of the table."""
        return [
            self.sequence,
            self.method,
            f"{self.num_poses}/{self.num_frames}",
            f"{self.ate_percent:.3f}",
            f"{self.largest_percent:.3f}",
            f"{self.rpe_frame:.5f}",
            f"{self.rpe_metre_percent:.2f}",
            f"{self.rotation_deg:.3f}",
            f"{self.num_frames / self.seconds:.1f}",
            f"{self.num_frames / (self.seconds + self.reading_s):.1f}",
            f"{self.seconds:.1f}",
            f"{self.cpu_s:.1f}",
        ]


def main() -> int:
    """Run the benchmark as the command line says; exit code 2 for wrong use."""
    options = _parse_options()
    try:
        for path, name in ((options.json, "--json"), (options.markdown, "--markdown")):
            if path is not None:
                check_writable(path, name=name)
        check_picture(options.picture)
        if unknown := set(options.methods.split(",")) - set(METHODS):
            raise ValueError(f"unknown method {', '.join(sorted(unknown))}")
        facts = machine_facts(PACKAGES)
        print("\n".join(fact_lines(facts)), flush=True)
        if options.memory is not None:
            return _memory(_clip(options.sequences.split(",")[0], options), options.memory)
        runs = [
            _measure(clip, method)
            for clip in (_clip(name, options) for name in options.sequences.split(","))
            for method in options.methods.split(",")
        ]
    except (FileNotFoundError, ValueError) as error:
        print(f"odometry.py: {error}", file=sys.stderr)
        return 2
    facts["load_average_at_end"] = load_average()
    _report(runs, facts, options)
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Trajectories of 360 and fisheye sequences.")
    parser.add_argument("--data", help="folder of the sets; $EPI360_DATA, else ../shared/data")
    parser.add_argument(
        "--sequences",
        default="living_room_360,studio_360",
        help=f"comma-separated: {', '.join(KNOWN)}; a rendered one also as NAME-loop (it returns "
        f"to its start) and NAME+EFFECT ({', '.join(EFFECTS)})",
    )
    parser.add_argument("--methods", default="track", help=f"comma-separated: {', '.join(METHODS)}")
    parser.add_argument("--frames", type=int, default=60, help="of the rendered sequences")
    parser.add_argument("--every", type=int, default=1, help="take every n-th frame")
    parser.add_argument(
        "--rendered",
        type=Path,
        default=Path("out/sequences"),
        help="folder of the rendered sequences; those that are missing are rendered into it",
    )
    parser.add_argument("--no-masks", action="store_true", help="leave out the masks of the clips")
    parser.add_argument(
        "--memory",
        type=int,
        metavar="FRAMES",
        help="only say how the memory grows while the first sequence is tracked again and again, "
        "there and back (a -loop in one direction)",
    )
    parser.add_argument("--json", type=Path, help="file for every figure")
    parser.add_argument("--markdown", type=Path, help="file for the table")
    add_picture_option(parser)
    return parser.parse_args()


def _clip(name: str, options: argparse.Namespace) -> Clip:
    if name in CLIPS or name == "theta_flat":
        clip = real_clip(data_folder(options.data), name)
    else:
        clip = rendered_clip(options.rendered, name, options.frames)
    if options.no_masks:
        clip = dataclasses.replace(clip, masks={})
    return dataclasses.replace(clip, frames=clip.frames[:: options.every])


def _measure(clip: Clip, name: str) -> Run:
    with tempfile.TemporaryDirectory() as scratch:
        cpu = time.process_time()
        placed = METHODS[name](clip, Path(scratch))
        cpu_s = time.process_time() - cpu if np.isnan(placed.cpu_s) else placed.cpu_s
    errors = _errors(clip, placed)
    run = Run(
        clip.name, name, len(clip.frames), len(placed.world_from_cam), *errors, placed.seconds,
        placed.reading_s, cpu_s, placed.statuses,
    )  # fmt: skip
    print("  ".join(run.cells()), placed.statuses or "", flush=True)
    return run


def _errors(clip: Clip, placed: Placed) -> tuple[float, float, float, float, float]:
    """ATE and its largest in percent of the path, RPE of a frame and a metre, rotation in deg."""
    result = _evaluation(clip, placed)
    if result is None:
        return (np.nan,) * 5
    ate = Statistics.of(result.position_errors_m)
    stretches = result.stretches
    return (
        100 * ate.rmse / result.path_m,
        100 * ate.max / result.path_m,
        Statistics.of(result.steps.translation_m).rmse,
        100 * Statistics.of(stretches.translation_m / stretches.length_m).rmse,
        Statistics.of(result.orientation_errors_deg).rmse,
    )


def _evaluation(clip: Clip, placed: Placed) -> Evaluation | None:
    if clip.truth is None or len(placed.world_from_cam) < 3:
        return None
    wanted = {path.name for path in clip.frames}
    rows = [row for row, name in enumerate(clip.truth.names) if name in wanted]
    truth = dataclasses.replace(clip.truth.rows(np.array(rows)), times_s=None)
    names = [name for name in truth.names if name in placed.world_from_cam]
    found = posed_frames(names, None, [placed.world_from_cam[name] for name in names])
    return evaluate(found, truth)


def _memory(clip: Clip, num_frames: int) -> int:
    """Track a sequence again and again and print the memory of the process."""
    import epi360
    from epi360.features import read_image

    odometry = epi360.Odometry(clip.camera)
    count = len(clip.frames)
    begun, spent, cpu_s = time.perf_counter(), 0.0, 0.0
    for index in range(num_frames):
        if clip.name.endswith("-loop"):
            at = index % (count - 1)  # the last frame is the first one
        else:
            at = min(index % (2 * count - 2), (2 * count - 2) - index % (2 * count - 2))
        image = read_image(clip.frames[at])
        before, cpu_before = time.perf_counter(), time.process_time()
        odometry.add_frame(image, index / 30)
        spent += time.perf_counter() - before
        cpu_s += time.process_time() - cpu_before
        if (index + 1) % BETWEEN_LINES == 0 or index + 1 == num_frames:
            frames = odometry.key_frames()
            count_since = (index % BETWEEN_LINES) + 1
            print(
                f"{index + 1} frames: {_resident_mb():.0f} MB, {len(frames)} key frames, "
                f"{count_since / spent:.1f} frames/s and {1000 * cpu_s / count_since:.1f} ms of "
                f"processor time a frame since the last line "
                f"({time.perf_counter() - begun:.0f} s in all)",
                flush=True,
            )
            spent, cpu_s = 0.0, 0.0
    return 0


def _resident_mb() -> float:
    """Memory of this process now; its peak where the system does not say that."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * 4096 / 2**20
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


_SERIES = {"track": "epi360 track", "map": "epi360 map"}  # as the picture names them


def _frames_per_second(run: Run) -> float:
    return run.num_frames / run.seconds


def _cpu_ms(run: Run) -> float:
    return 1e3 * run.cpu_s / run.num_frames


def _report(runs: list[Run], facts: dict[str, Any], options: argparse.Namespace) -> None:
    rows = [list(HEADER), *(run.cells() for run in runs)]
    print(f"\n{text_table(rows)}")
    if options.json is not None:
        document = {**facts, "runs": [dataclasses.asdict(run) for run in runs]}
        write_file(options.json, json.dumps(document, indent=1).encode())
    if options.markdown is not None:
        lines = "\n".join(f"- {line}" for line in fact_lines(facts))
        write_file(options.markdown, f"{lines}\n\n{markdown_table(rows)}\n".encode())
    fields = (
        ("Frames with a pose", "%", lambda run: 100.0 * run.num_poses / run.num_frames, False),
        ("ATE, rms", "% of the path", lambda run: run.ate_percent, True),
        ("Rotation error, rms", "degrees", lambda run: run.rotation_deg, True),
        ("Speed without reading the frames", "frames a second", _frames_per_second, True),
        ("Processor time", "ms a frame, all threads", _cpu_ms, True),
        ("RPE of a metre or a tenth of the path", "%", lambda run: run.rpe_metre_percent, True),
    )
    panels = [
        panel_of(
            title,
            axis,
            [(run.sequence, _SERIES.get(run.method, run.method), value(run)) for run in runs],
            powers=log,
        )
        for title, axis, value, log in fields
    ]
    write_picture(options.picture, "Trajectories of sequences", panels, facts)


if __name__ == "__main__":
    sys.exit(main())
