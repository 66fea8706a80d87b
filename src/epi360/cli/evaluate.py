# SPDX-License-Identifier: BSD-3-Clause
"""``epi360 evaluate``: an estimated trajectory against the true one."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from epi360.cli.command import FILES, SUCCESS, app


@app.command(group=FILES, sort_key=4)
def evaluate(
    estimate: Path,
    truth: Path,
    /,
    *,
    align: Literal["sim3", "se3", "none"] = "sim3",
    max_gap_s: float = 0.01,
    distance_m: float | None = None,
    frames: Path | None = None,
    json: Path | None = None,
    figure: Path | None = None,
) -> int:
    """Errors of a trajectory: ATE, RPE for a frame and for a metre, errors of pairs, coverage.

    Parameters
    ----------
    estimate
        TUM trajectory (rows t tx ty tz qx qy qz qw of world_from_cam), COLMAP model, output folder
        of epi360 map, nerfstudio's transforms.json or OpenSfM's reconstruction.json.
    truth
        The same; frm_ref.txt of epi360 render is a TUM trajectory.
    align
        Lay the estimate on the truth with rotation, translation and scale (sim3: one camera has no
        scale), without scale (se3), or not at all (none).
    max_gap_s
        Frames of both are the same if their times differ by no more. Files without times are
        compared by the names of the images.
    distance_m
        Way over which relative poses are compared; 1 by default, a tenth of a way below 2.
    frames
        Table frames.csv (image, timestamp_s) with the times of the images, for a file that has
        names only.
    json
        Write all numbers to this file.
    figure
        Draw both trajectories and the errors.
    """
    from epi360.jobs.evaluation import evaluate as errors_of
    from epi360.jobs.frames.frame_source import read_frame_table
    from epi360.jobs.trajectories import read_trajectory
    from epi360.report.files import check_distinct, check_figure_name, check_writable
    from epi360.report.trajectory import describe_evaluation
    from epi360.runs.input_files import as_file

    outputs = {"--json": json, "--figure": figure}
    given = {name: path for name, path in outputs.items() if path is not None}
    for name, path in given.items():
        check_writable(path, name=name)
    check_distinct(given, {"the estimate": estimate, "the truth": truth})
    if figure is not None:
        check_figure_name(figure, name="--figure")
    times = None if frames is None else read_frame_table(frames)
    # A pipe gives its content once, but finding the format and reading it are two looks.
    with as_file(estimate) as file, as_file(truth) as true_file:
        result = errors_of(
            read_trajectory(file, times),
            read_trajectory(true_file, times),
            alignment=align,
            max_gap_s=max_gap_s,
            distance_m=distance_m,
        )
    print(describe_evaluation(result), flush=True)
    if json is not None:
        from epi360.report.records import write_json
        from epi360.report.trajectory import evaluation_record

        write_json(json, evaluation_record(result))
    if figure is not None:
        from epi360.features.picture_writing import encode_figure
        from epi360.report.trajectory_figure import evaluation_figure
        from epi360.runs.whole_files import write_file

        suffix = figure.suffix.lower().removeprefix(".")
        write_file(figure, encode_figure(evaluation_figure(result), suffix))
    return SUCCESS
