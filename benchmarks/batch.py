# SPDX-License-Identifier: BSD-3-Clause
"""Speed and memory of `epi360 batch`, beside pycolmap on the same pairs and Ray on this machine.

``python benchmarks/batch.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401 - before NumPy
import numpy as np
from _batch_pairs import PAIRS_PER_ROW_GROUP, write_database, write_parquet
from _machine import fact_lines, load_average, machine_facts
from _peers import CONFIDENCE, MIN_TRIALS, pycolmap_camera, pycolmap_essential
from _picture import Entry, add_picture_option, check_picture, panel_of, write_picture
from _summary import Rows, markdown_table, text_table
from _two_view_problems import Problem, cell_from_name, make_problem

from epi360.report.overview import Panel
from epi360.runs.whole_files import write_file

PACKAGES = ("epi360", "pycolmap", "pyarrow", "ray", "numpy")
CELLS = ("room-400-50-0.1", "room-1000-50-0.1")
MEMORY_CELL = "room-20-0-0.1"
THREADS = (1, 2)
NUM_DISTINCT = 500
# Verification by pycolmap takes some thirty times as long a pair.
PEER_SHARE = 10


@dataclass(frozen=True)
class Sizes:
    """How much is run."""

    speed_pairs: int
    memory_pairs: tuple[int, int]
    ray_pairs: tuple[int, int]
    rounds: int


@dataclass(frozen=True)
class Run:
    """What a run took."""

    seconds: float
    cpu_seconds: float  # of all its threads
    peak_mb: float = math.nan  # largest resident set


LONG = Sizes(2_000, (10_000, 100_000), (2_000, 8_000), 2)
SHORT = Sizes(1_000, (2_000, 10_000), (1_000, 2_000), 1)


def main() -> int:
    """Run the benchmark as the command line says; exit code 2 for wrong use."""
    options = _parse_options()
    sections = {"speed": _speed, "memory": _memory, "ray": _ray}
    chosen = [name for name in sections if getattr(options, name)] or list(sections)
    facts = {**machine_facts(PACKAGES), "seed": options.seed, "short": options.short}
    parts = ["\n".join(f"- {line}" for line in fact_lines(facts))]
    print("\n".join(fact_lines(facts)), flush=True)
    panels: list[Panel] = []
    try:
        check_picture(options.picture)
        with tempfile.TemporaryDirectory(prefix="epi360-batch-") as folder:
            for name in chosen:
                title, remark, table = sections[name](Path(folder), options)
                remark += f" Load at the end: {', '.join(map(str, load_average()))}."
                parts += [f"## {title}", remark, markdown_table(table)]
                panels += _PANELS[name](table)
                print(f"\n{title}\n{remark}\n{text_table(table)}", flush=True)
        if options.markdown is not None:
            write_file(options.markdown, ("\n\n".join(parts) + "\n").encode())
        facts["load_average_at_end"] = load_average()
        title = "Many pairs: epi360 batch beside pycolmap"
        write_picture(options.picture, title, panels, facts, columns=2)
    except (OSError, ValueError, ImportError) as error:
        print(f"batch.py: {error}", file=sys.stderr)
        return 2
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Speed and memory of epi360 batch.")
    parser.add_argument("--speed", action="store_true", help="pairs a second, beside pycolmap")
    parser.add_argument("--memory", action="store_true", help="peak memory of few and many pairs")
    parser.add_argument("--ray", action="store_true", help="Ray on this machine against local")
    parser.add_argument("--short", action="store_true", help="few pairs, one round: a quick look")
    parser.add_argument("--seed", type=int, default=0, help="of the problems (0)")
    parser.add_argument("--markdown", type=Path, help="write the tables to this file")
    add_picture_option(parser)
    return parser.parse_args()


def _speed(folder: Path, options: argparse.Namespace) -> tuple[str, str, Rows]:
    """Pairs a second of the whole command, of pycolmap's, and of its estimator alone."""
    sizes = SHORT if options.short else LONG
    header = ["matches", "method", "threads", "pairs", "s", "pairs / s", "without start"]
    table = [[*header, "pairs / CPU s"]]
    for name in CELLS:
        problems = _problems(name, options.seed)
        single = folder / "single.parquet"
        write_parquet(single, problems, 1)
        _command(single)  # the files of the program are in memory from here on
        start = min(_command(single).seconds for _ in range(sizes.rounds))
        runs = _speed_runs(folder, problems, sizes.speed_pairs)
        for (method, threads, count), run in _best_of(sizes.rounds, runs).items():
            rate = f"{count / (run.seconds - start):.0f}" if method == "epi360 batch" else ""
            cells = [str(problems[0].cell.num_matches), method, str(threads), str(count)]
            cells += [f"{run.seconds:.2f}", f"{count / run.seconds:.0f}", rate]
            table.append([*cells, f"{count / run.cpu_seconds:.0f}"])
    remark = (
        f"Best of {sizes.rounds} rounds in which all take turns. `epi360 batch`: the whole command,"
        " Parquet to Parquet, and the rate without the seconds that it takes for a single pair. "
        "`geometric_verification`: pycolmap's call from database to database. "
        "`estimate_essential_matrix`: pycolmap's estimator in a pool of threads on arrays in "
        "memory, no file read or written, no verdict, no covariance. CPU seconds are of all "
        "threads, our start included: the fairer figure where others use the machine."
    )
    return "Pairs per second", remark, table


def _speed_runs(
    folder: Path, problems: list[Problem], num_pairs: int
) -> dict[tuple[str, int, int], Callable[[], Run]]:
    """What to time, by method, threads and pairs."""
    matches, database = folder / "matches.parquet", folder / "matches.db"
    write_parquet(matches, problems, num_pairs)
    few = num_pairs // PEER_SHARE
    write_database(database, problems, few, pycolmap_camera(problems[0].cell)[:2])
    solves = [pycolmap_essential(problem) for problem in problems]
    runs: dict[tuple[str, int, int], Callable[[], Run]] = {}
    for threads in THREADS:
        runs["epi360 batch", threads, num_pairs] = partial(
            _command, matches, "--threads", str(threads)
        )
        runs["geometric_verification", threads, few] = partial(
            _verification, database, problems[0], threads
        )
        runs["estimate_essential_matrix", threads, len(solves)] = partial(_pool, solves, threads)
    return runs


def _verification(database: Path, problem: Problem, threads: int) -> Run:
    """Run pycolmap from a database with matches to one with verified poses."""
    import pycolmap

    pycolmap.logging.minloglevel = pycolmap.logging.ERROR.value
    copy = database.with_name("verified.db")
    shutil.copyfile(database, copy)
    options = pycolmap.TwoViewGeometryOptions(compute_relative_pose=True)
    pixels_per_rad = pycolmap_camera(problem.cell)[2]
    options.ransac.max_error = pixels_per_rad * float(np.radians(problem.cell.gate_deg))
    options.ransac.min_num_trials = MIN_TRIALS
    options.ransac.confidence = CONFIDENCE
    options.ransac.random_seed = 0
    verifier = pycolmap.GeometricVerifierOptions(num_threads=threads)
    pairing = pycolmap.ExistingMatchedPairingOptions()
    return _timed(lambda: pycolmap.geometric_verification(copy, verifier, pairing, options))


def _pool(solves: list[Callable[[], Any]], threads: int) -> Run:
    with ThreadPoolExecutor(threads) as pool:
        return _timed(lambda: list(pool.map(lambda solve: solve(), solves)))


def _timed(work: Callable[[], Any]) -> Run:
    """Run something in this process."""
    cpu_start, start = time.process_time(), time.perf_counter()
    work()
    return Run(time.perf_counter() - start, time.process_time() - cpu_start)


def _memory(folder: Path, options: argparse.Namespace) -> tuple[str, str, Rows]:
    """Peak resident memory of the command over few and over many pairs."""
    sizes = SHORT if options.short else LONG
    problems = _problems(MEMORY_CELL, options.seed)
    table = [["pairs", "input MB", "peak MB", "s"]]
    for num_pairs in sizes.memory_pairs:
        matches = folder / "many.parquet"
        write_parquet(matches, problems, num_pairs)
        run = _command(matches, "--threads", "2")
        size = matches.stat().st_size / 1e6
        table.append([str(num_pairs), f"{size:.0f}", f"{run.peak_mb:.0f}", f"{run.seconds:.1f}"])
    remark = (
        f"Largest resident set of the command on 2 threads; pairs of `{MEMORY_CELL}` (20 matches, "
        f"so that it takes minutes), row groups of {PAIRS_PER_ROW_GROUP} pairs."
    )
    return "Peak memory", remark, table


def _ray(folder: Path, options: argparse.Namespace) -> tuple[str, str, Rows]:
    """Seconds of the command on two local threads and on a Ray of this machine."""
    sizes = SHORT if options.short else LONG
    problems = _problems(CELLS[0], options.seed)
    table = [["pairs", "parts", "local s", "Ray s", "difference s", "a part ms"]]
    small, differences = sizes.ray_pairs[0], []
    for num_pairs in sizes.ray_pairs:
        matches = folder / "ray.parquet"
        write_parquet(matches, problems, num_pairs)
        runs: dict[Any, Callable[[], Run]] = {
            "local": partial(_command, matches, "--threads", "2"),
            "ray": partial(_command, matches, "--engine", "ray"),
        }
        best = {key: run.seconds for key, run in _best_of(sizes.rounds, runs).items()}
        differences.append(best["ray"] - best["local"])
        parts = -(-num_pairs // PAIRS_PER_ROW_GROUP)
        cells = [str(num_pairs), str(parts), f"{best['local']:.2f}", f"{best['ray']:.2f}"]
        table.append([*cells, f"{differences[-1]:.2f}", ""])
    more_parts = (sizes.ray_pairs[1] - small) / PAIRS_PER_ROW_GROUP
    table[-1][-1] = f"{1e3 * (differences[1] - differences[0]) / more_parts:.0f}"
    remark = (
        f"The whole command on `{CELLS[0]}`, best of {sizes.rounds} rounds in which both take "
        f"turns; `--threads 2` against a Ray that is started on all {os.cpu_count()} cores and "
        "stopped. The last column is what a further part costs."
    )
    return "Ray on one machine", remark, table


def _command(matches: Path, *words: str) -> Run:
    """Run `epi360 batch` on a file of matches, without an earlier output."""
    output = matches.with_name("poses.parquet")
    output.unlink(missing_ok=True)
    command = [sys.executable, "-m", "epi360.cli", "batch", str(matches), "--output", str(output)]
    start = time.perf_counter()
    child = subprocess.Popen([*command, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert child.stderr is not None
    message = child.stderr.read().decode()
    _, status, usage = os.wait4(child.pid, 0)
    seconds = time.perf_counter() - start
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        raise ChildProcessError(f"epi360 batch failed: {message.strip()}")
    return Run(seconds, usage.ru_utime + usage.ru_stime, _megabytes(usage))


def _megabytes(usage: resource.struct_rusage) -> float:
    """Peak resident set: kilobytes on Linux, bytes on macOS."""
    return usage.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def _best_of(rounds: int, runs: dict[Any, Callable[[], Run]]) -> dict[Any, Run]:
    """Fewest seconds and CPU seconds of each; all take turns."""
    taken: dict[Any, list[Run]] = {key: [] for key in runs}
    for _ in range(rounds):
        for key, work in runs.items():
            taken[key].append(work())
    return {
        key: Run(min(run.seconds for run in all_), min(run.cpu_seconds for run in all_))
        for key, all_ in taken.items()
    }


def _speed_panels(table: Rows) -> list[Panel]:
    def entries(column: int) -> list[Entry]:
        return [(_row_name(row), _method_name(row[1]), float(row[column])) for row in table[1:]]

    return [
        panel_of("Speed", "pairs a second", entries(5), powers=True),
        panel_of("Work", "pairs a second of processor time", entries(7), powers=True),
    ]


def _row_name(row: list[str]) -> str:
    threads = "1 thread" if row[2] == "1" else f"{row[2]} threads"
    return f"{row[0]} matches, {threads}"


def _method_name(name: str) -> str:
    return name if name.startswith("epi360") else f"pycolmap {name}"


def _memory_panels(table: Rows) -> list[Panel]:
    entries = [(f"{int(row[0]):,} pairs", "epi360 batch", float(row[2])) for row in table[1:]]
    return [panel_of("Peak memory, 2 threads", "MB", entries)]


def _ray_panels(table: Rows) -> list[Panel]:
    entries = [
        (f"{int(row[0]):,} pairs", engine, float(row[column]))
        for row in table[1:]
        for engine, column in (("epi360 batch", 2), ("epi360 batch --engine ray", 3))
    ]
    return [panel_of("Time on one machine", "s", entries)]


_PANELS = {"speed": _speed_panels, "memory": _memory_panels, "ray": _ray_panels}


def _problems(cell: str, seed: int) -> list[Problem]:
    return [make_problem(cell_from_name(cell), index, seed) for index in range(NUM_DISTINCT)]


if __name__ == "__main__":
    sys.exit(main())
