# SPDX-License-Identifier: BSD-3-Clause
"""Accuracy and speed on real image pairs with known poses, beside pycolmap on the same pairs.

``python benchmarks/real_pairs.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _data import (
    FLOW_REQUIREMENTS,
    POOLED_REQUIREMENTS,
    REQUIREMENTS,
    ImagePair,
    Matches,
    PairSet,
    data_folder,
    flow_matches,
    load_set,
)
from _machine import fact_lines, load_average, machine_facts
from _methods import Epi360, Estimate, Method, Pycolmap
from _picture import Entry, add_picture_option, check_picture, panel_of, write_picture
from _summary import (
    PairRun,
    markdown_table,
    pair_rows,
    speed_rows,
    summarise,
    summary_rows,
    text_table,
)

from epi360.cameras import Camera
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.report.files import check_writable
from epi360.report.overview import Panel
from epi360.runs.whole_files import write_file

PACKAGES = ("epi360", "pycolmap", "numpy", "opencv-python-headless")


def main() -> int:
    """Run the benchmark as the command line says; exit code 2 for wrong use."""
    options = _parse_options()
    try:
        _check_outputs(options)
        sets = _load_sets(options)
    except ValueError as error:
        print(f"real_pairs.py: {error}", file=sys.stderr)
        return 2
    seeds = range(options.seed, options.seed + options.repeat)
    with tempfile.TemporaryDirectory() as scratch:
        methods, remarks = _methods(options, Path(scratch))
        facts = {**machine_facts(PACKAGES), "seeds": [*seeds], "remarks": remarks}
        print("\n".join(fact_lines(facts)), flush=True)
        runs: list[PairRun] = []
        done: list[PairSet] = []
        for pair_set in sets:
            for derived, more in _run_set(pair_set, methods, seeds):
                done.append(derived)
                runs += more
    facts["load_average_at_end"] = load_average()
    _report(done, [method.name for method in methods], runs, facts, options)
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Accuracy and speed on real image pairs.")
    flag = argparse.BooleanOptionalAction
    parser.add_argument("--data", help="folder of the sets; $EPI360_DATA, else ../shared/data")
    parser.add_argument("--sets", help=f"comma-separated; all: {','.join(REQUIREMENTS)}")
    parser.add_argument("--pairs-per-set", type=_positive, help="only so many, evenly spaced")
    parser.add_argument("--ours", action=flag, default=True, help="run epi360")
    parser.add_argument("--peer", action=flag, default=True, help="run pycolmap if installed")
    parser.add_argument("--peer-max-error-px", type=float, help="pycolmap's gate, instead of 4")
    parser.add_argument("--repeat", type=_positive, default=1, help="runs of each pair, own seeds")
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    parser.add_argument("--json", type=Path, help="file for every figure")
    parser.add_argument("--markdown", type=Path, help="file for the tables")
    add_picture_option(parser)
    return parser.parse_args()


def _positive(text: str) -> int:
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {number}")
    return number


def _check_outputs(options: argparse.Namespace) -> None:
    for path, name in ((options.json, "--json"), (options.markdown, "--markdown")):
        if path is not None:
            check_writable(path, name=name)
    check_picture(options.picture)


def _load_sets(options: argparse.Namespace) -> list[PairSet]:
    folder = data_folder(options.data)
    names = options.sets.split(",") if options.sets else list(REQUIREMENTS)
    return [load_set(folder / name, max_pairs=options.pairs_per_set) for name in names]


def _methods(options: argparse.Namespace, scratch: Path) -> tuple[list[Method], list[str]]:
    """Methods that can run here, and why another cannot."""
    methods: list[Method] = [Epi360()] if options.ours else []
    if not options.peer:
        return methods, ["pycolmap was not asked for"]
    try:
        peer = Pycolmap(scratch, max_error_px=options.peer_max_error_px)
    except ImportError as error:
        return methods, [f"pycolmap is not installed ({error}): pip install 'epi360[bench]'"]
    gate = options.peer_max_error_px
    return [*methods, peer], [f"pycolmap: defaults, {'4' if gate is None else f'{gate:g}'} px"]


def _run_set(
    pair_set: PairSet, methods: Sequence[Method], seeds: Sequence[int]
) -> list[tuple[PairSet, list[PairRun]]]:
    """All pairs with all methods, printed as they come; then the poses from given matches."""
    truths = [pair.reference for pair in pair_set.pairs]
    counts = ", ".join(f"{name} ({truths.count(name)})" for name in dict.fromkeys(truths))
    print(f"\n{pair_set.name}: {len(truths)} of {pair_set.num_available} pairs, truth: {counts}")
    for method in methods:
        method.prepare(pair_set.pairs)
        method.from_images(pair_set.pairs[0], seeds[0])  # what is done once a process is not timed
    results: list[tuple[PairRun, Estimate]] = []
    for seed in seeds:
        for index, pair in enumerate(pair_set.pairs):
            for method in methods if index % 2 == 0 else methods[::-1]:  # neither is always first
                estimate_pose = partial(method.from_images, pair, seed)
                results.append(_measure(pair_set, pair, method, seed, estimate_pose))
    done = [(pair_set, [run for run, _ in results])]
    if any(pair.flow is not None for pair in pair_set.pairs):
        done.append(_run_flow(pair_set, methods, seeds))
    if pair_set.rig_cameras is not None:
        done.append(_run_pooled(pair_set, pair_set.rig_cameras, methods, seeds, results))
    return done


def _measure(
    pair_set: PairSet,
    pair: ImagePair,
    method: Method,
    seed: int,
    estimate_pose: Callable[[], Estimate],
) -> tuple[PairRun, Estimate]:
    """One timed estimate and its errors."""
    cpu_start, start = time.process_time(), time.perf_counter()
    estimate = estimate_pose()
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    run = PairRun(
        set=pair_set.name,
        pair=pair.id,
        kind=pair.kind,
        reference=pair.reference,
        method=method.name,
        seed=seed,
        rotation_error_deg=rotation_error_deg(estimate.cam2_from_cam1, pair.cam2_from_cam1),
        translation_error_deg=translation_error_deg(estimate.cam2_from_cam1, pair.cam2_from_cam1),
        num_inliers=estimate.num_inliers,
        num_matches=estimate.num_matches,
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        status=estimate.status,
        accepted=estimate.accepted,
        rotation_sigma_deg=estimate.rotation_sigma_deg,
        translation_sigma_deg=estimate.translation_sigma_deg,
    )
    widths = (8, 8, 12, 8, 0)
    cells = "".join(cell.ljust(width) for cell, width in zip(run.cells(), widths, strict=True))
    print(f"{run.pair:24}{run.method:10}{cells}", flush=True)
    return run, estimate


def _run_flow(
    pair_set: PairSet, methods: Sequence[Method], seeds: Sequence[int]
) -> tuple[PairSet, list[PairRun]]:
    """Poses from exact correspondences: the pairs of the set that come with an optical flow."""
    pairs = tuple(
        dataclasses.replace(pair, id=f"{pair.id}, flow")
        for pair in pair_set.pairs
        if pair.flow is not None
    )
    flow_set = PairSet(f"{pair_set.name}, flow", pairs, FLOW_REQUIREMENTS, len(pairs))
    runs = []
    for pair in pairs:
        matches = flow_matches(pair.folder / str(pair.flow))
        for method in methods:
            for seed in seeds:
                estimate_pose = partial(method.from_matches, matches, seed)
                runs.append(_measure(flow_set, pair, method, seed, estimate_pose)[0])
    return flow_set, runs


def _run_pooled(
    pair_set: PairSet,
    cameras: tuple[Camera, Camera],
    methods: Sequence[Method],
    seeds: Sequence[int],
    results: Sequence[tuple[PairRun, Estimate]],
) -> tuple[PairSet, list[PairRun]]:
    """Pose of a rigid rig from the matches of all its pairs, each method with its own matches."""
    pair = dataclasses.replace(pair_set.pairs[0], id=f"all {len(pair_set.pairs)} pairs")
    num_missing = pair_set.num_available - len(pair_set.pairs)
    pooled_set = PairSet(f"{pair_set.name}, pooled", (pair,), POOLED_REQUIREMENTS, 1 + num_missing)
    runs = []
    for method in methods:
        for seed in seeds:
            own = [one for run, one in results if (run.method, run.seed) == (method.name, seed)]
            matches = Matches(
                *cameras,
                np.concatenate([estimate.keypoints1 for estimate in own]),
                np.concatenate([estimate.keypoints2 for estimate in own]),
            )
            estimate_pose = partial(method.from_matches, matches, seed)
            runs.append(_measure(pooled_set, pair, method, seed, estimate_pose)[0])
    return pooled_set, runs


def _report(
    sets: Sequence[PairSet],
    methods: Sequence[str],
    runs: Sequence[PairRun],
    facts: dict[str, Any],
    options: argparse.Namespace,
) -> None:
    """Summary on stdout, and the files that were asked for."""
    summaries = [summarise(pair_set, runs, method) for pair_set in sets for method in methods]
    tables = [summary_rows(summaries), speed_rows(summaries, Epi360.name, Pycolmap.name)]
    for table in tables:
        print(f"\n{text_table(table)}")
    if options.json is not None:
        records = [run.record() for run in runs]
        document = {**facts, "summaries": summaries, "runs": records}
        write_file(options.json, json.dumps(document, indent=1, allow_nan=False).encode())
    if options.markdown is not None:
        lines = [f"- {line}" for line in fact_lines(facts)]
        blocks = [
            "\n".join(lines),
            *(markdown_table(table) for table in [*tables, pair_rows(runs)]),
        ]
        write_file(options.markdown, ("\n\n".join(blocks) + "\n").encode())
    write_picture(
        options.picture,
        "Real image pairs with known poses",
        _panels(sets, runs, methods),
        facts,
        remark="Errors are medians over all pairs of a set, also of refused poses.",
    )


def _panels(
    sets: Sequence[PairSet], runs: Sequence[PairRun], methods: Sequence[str]
) -> list[Panel]:
    """What is within the first bounds of each set, errors, gross errors, time."""
    own = {
        (pair_set.name, method): [
            run for run in runs if (run.set, run.method) == (pair_set.name, method)
        ]
        for pair_set in sets
        for method in methods
    }

    def entries(value: Callable[[list[PairRun], PairSet], float]) -> list[Entry]:
        return [
            (pair_set.name, method, value(own[pair_set.name, method], pair_set))
            for pair_set in sets
            for method in methods
            if own[pair_set.name, method]
        ]

    def within(group: list[PairRun], pair_set: PairSet) -> float:
        bounds = pair_set.requirements[0]
        asked = [run for run in group if bounds.kind in ("", run.kind)]
        return 100.0 * float(np.mean([run.is_within(bounds) for run in asked] or [np.nan]))

    def median(name: str) -> Callable[[list[PairRun], PairSet], float]:
        return lambda group, _: float(np.nanmedian([getattr(run, name) for run in group]))

    wrong = entries(lambda group, _: 100.0 * float(np.mean([r.is_grossly_wrong for r in group])))
    return [
        panel_of("Poses within the bounds that are asked of the set", "%", entries(within)),
        panel_of("Accepted, but more than 10° off", "%", wrong),
        panel_of("Processor time", "s a pair, all threads", entries(median("cpu_seconds"))),
        panel_of("Rotation error", "degrees", entries(median("rotation_error_deg")), powers=True),
        panel_of(
            "Error of the direction", "degrees", entries(median("translation_error_deg")),
            powers=True,
        ),
        panel_of("Wall time", "s a pair", entries(median("seconds"))),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
