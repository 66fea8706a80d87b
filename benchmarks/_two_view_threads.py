# SPDX-License-Identifier: BSD-3-Clause
"""Pairs a second of many pairs on one and two threads, beside pycolmap in a loop of threads."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from _machine import fact_lines, load_average
from _peers import pycolmap_essential
from _summary import Rows, markdown_table, text_table
from _two_view_methods import FAST_PEER, usable_methods
from _two_view_problems import Problem, cell_from_name, make_problem

import epi360
from epi360.runs.whole_files import write_file

CELL, NUM_PAIRS, NUM_ROUNDS = "room-400-50-0.1", 200, 3
THREADS = (1, 2)


def thread_report(options: argparse.Namespace, facts: dict[str, Any]) -> None:
    """Write ``threads.md``."""
    cell = cell_from_name(CELL)
    problems = [make_problem(cell, index, options.seed) for index in range(NUM_PAIRS)]
    runs, remarks = _runs(problems)
    table = _table(runs)
    text = "\n\n".join(
        [
            "# Many pairs on few threads",
            "\n".join(f"- {line}" for line in fact_lines(facts)),
            f"{NUM_PAIRS} pairs of `{CELL}`, best of {NUM_ROUNDS} rounds in which all take turns; "
            f"load at the end {load_average()}. pycolmap: `{FAST_PEER}` from a pool of threads.",
            *remarks,
            markdown_table(table),
        ]
    )
    write_file(options.out / "threads.md", (text + "\n").encode())
    print("\n" + "\n".join([*remarks, text_table(table)]), flush=True)


def _runs(problems: list[Problem]) -> tuple[dict[tuple[str, int], Callable[[], Any]], list[str]]:
    """What to time, by name and number of threads, and why something is missing."""
    runs: dict[tuple[str, int], Callable[[], Any]] = {}
    remarks = []
    pairs = [(problem.bearings1, problem.bearings2) for problem in problems]
    many: Any = getattr(epi360, "estimate_relative_poses", None)
    one = epi360.estimate_relative_pose
    if many is None:
        remarks.append("This epi360 has no `estimate_relative_poses`: one pair after the other.")
        runs["epi360", 1] = lambda: [one(*pair) for pair in pairs]
    peers, missing = usable_methods([FAST_PEER])
    remarks += missing
    for count in THREADS:
        if many is not None:
            runs["epi360", count] = lambda count=count: many(pairs, num_threads=count)
        if peers:
            solves = [pycolmap_essential(problem) for problem in problems]
            runs["pycolmap", count] = lambda count=count, solves=solves: _in_threads(solves, count)
    return runs, remarks


def _in_threads(solves: list[Callable[[], Any]], count: int) -> list[Any]:
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(lambda solve: solve(), solves))


def _table(runs: dict[tuple[str, int], Callable[[], Any]]) -> Rows:
    seconds: dict[tuple[str, int], list[float]] = {key: [] for key in runs}
    for _ in range(NUM_ROUNDS):
        for key, work in runs.items():
            start = time.perf_counter()
            work()
            seconds[key].append(time.perf_counter() - start)
    best = {key: float(np.min(values)) for key, values in seconds.items()}
    table = [["method", "threads", "pairs / s", "of one thread"]]
    for (name, count), value in best.items():
        gain = best[name, 1] / value
        table.append([name, str(count), f"{NUM_PAIRS / value:.0f}", f"{gain:.2f}"])
    return table
