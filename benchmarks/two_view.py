# SPDX-License-Identifier: BSD-3-Clause
"""Accuracy, verdict and speed of the robust estimator on synthetic matches, beside its peers.

``python benchmarks/two_view.py --help``; README.md beside this file says what is measured. Real
image pairs are the business of ``real_pairs.py``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401 - before NumPy
from _machine import fact_lines, load_average, machine_facts
from _picture import add_picture_option, check_picture
from _two_view_kernels import kernel_report
from _two_view_methods import METHODS, usable_methods
from _two_view_problems import chosen_cells
from _two_view_records import RawTable, package_commit, package_digest
from _two_view_report import write_report
from _two_view_run import Plan, run
from _two_view_threads import thread_report
from _two_view_thresholds import threshold_report

PACKAGES = ("epi360", "pycolmap", "poselib", "panorai", "numpy", "opencv-python-headless")
PEERS = PACKAGES[1:]


def main() -> int:
    """Run the benchmark as the command line says; exit code 2 for wrong use."""
    options = _parse_options()
    facts = {**machine_facts(PACKAGES), "epi360 is of commit": package_commit()}
    facts |= {"epi360 digest": package_digest(), "seed": options.seed, "workers": options.jobs}
    sections: dict[str, tuple[bool, Callable[[argparse.Namespace, dict[str, Any]], None]]] = {
        "cells": (options.everything or not _wants_section(options), _run_cells),
        "kernels": (options.everything or options.kernels, kernel_report),
        "threads": (options.everything or options.threads, thread_report),
        "thresholds": (options.everything or options.thresholds, threshold_report),
    }
    print("\n".join(fact_lines(facts)), flush=True)
    try:
        check_picture(options.picture)
        options.out.mkdir(parents=True, exist_ok=True)
        for is_wanted, run_section in sections.values():
            if is_wanted:
                run_section(options, facts)
    except (ValueError, OSError) as error:
        print(f"two_view.py: {error}", file=sys.stderr)
        return 2
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="The robust estimator beside its peers.")
    parser.add_argument("--out", type=Path, default=Path("out/two_view"), help="folder of results")
    parser.add_argument("--cells", help="comma-separated names or patterns, as room-400-50-*")
    parser.add_argument("--full", action="store_true", help="the whole grid, which takes days")
    parser.add_argument("--problems", type=_positive, default=100, help="of each cell (100)")
    parser.add_argument("--methods", help=f"comma-separated; all: {', '.join(METHODS)}")
    parser.add_argument("--seed", type=int, default=0, help="of the problems (0)")
    parser.add_argument("--jobs", type=_positive, default=2, help="processes of one thread (2)")
    parser.add_argument("--fresh", action="store_true", help="forget an earlier run in --out")
    parser.add_argument("--kernels", action="store_true", help="solvers and refinement alone")
    parser.add_argument("--threads", action="store_true", help="pairs a second on two threads")
    parser.add_argument("--thresholds", action="store_true", help="auto against the best gate")
    parser.add_argument("--everything", action="store_true", help="cells and all other sections")
    add_picture_option(parser)
    return parser.parse_args()


def _positive(text: str) -> int:
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {number}")
    return number


def _wants_section(options: argparse.Namespace) -> bool:
    return bool(options.kernels or options.threads or options.thresholds)


def _run_cells(options: argparse.Namespace, facts: dict[str, Any]) -> None:
    """All cells, resumed where an earlier run of the same program stopped, and their report."""
    cells = chosen_cells(options.cells, full=options.full)
    methods, missing = usable_methods(_method_names(options.methods))
    path = options.out / "raw.csv"
    if options.fresh:
        path.unlink(missing_ok=True)
    peers = {name: facts["versions"][name] for name in PEERS}
    versions = " ".join(f"{name} {version}" for name, version in peers.items() if version)
    table = RawTable(path, f"epi360 {facts['epi360 digest']} {versions} seed {options.seed}")
    if missing:
        print("\n".join(missing), flush=True)
    plan = Plan(cells, methods, options.problems, options.seed)
    start = time.perf_counter()
    for done in run(plan, table, jobs=options.jobs):
        if done % 50 == 0:
            print(f"{done} problems, {time.perf_counter() - start:.0f} s", flush=True)
    facts = {
        **facts,
        "load_average_at_end": load_average(),
        "seconds of this run": round(time.perf_counter() - start),
        "left out": missing or "nothing",
    }
    write_report(options.out, cells, table.rows.values(), facts, options.picture)


def _method_names(text: str | None) -> list[str]:
    if text is None:
        return list(METHODS)
    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in METHODS]
    if unknown:
        raise ValueError(f"--methods must be of {', '.join(METHODS)}, got {unknown[0]!r}")
    return names


if __name__ == "__main__":
    sys.exit(main())
