# SPDX-License-Identifier: BSD-3-Clause
"""Microseconds of each estimator of the paper, beside PoseLib's eight-point solver and the paper.

``python benchmarks/paper_methods.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # before NumPy is loaded: everything here runs on one thread

from _machine import fact_lines, load_average, machine_facts  # noqa: E402
from _picture import (  # noqa: E402
    add_picture_option,
    check_picture,
    panel_of,
    write_picture,
)
from _summary import markdown_table  # noqa: E402

import epi360  # noqa: E402
from epi360 import _core, epipolar  # noqa: E402
from epi360.estimation import PAPER_METHODS, paper_pose_reference  # noqa: E402
from epi360.report.files import check_writable  # noqa: E402
from epi360.report.overview import Panel  # noqa: E402
from epi360.runs.whole_files import write_file  # noqa: E402
from epi360.synthetic import TwoViewScene, two_view_scene  # noqa: E402

PACKAGES = ("epi360", "poselib", "numpy")
POINTS = (100, 200, 400, 5000)
# Tables 1 and 2 of the paper, milliseconds, on some 200 tracks.
PAPER_MS = {
    "8pa": 40.33,
    "8pa_isotropic": 40.33,
    "8pa_non_isotropic": 40.33,
    "8pa_isotropic_non_isotropic": 40.88,
    "opt_sk": 45.52,
    "opt_sk, lm": 45.52,  # as printed
    "gsm": 45.318,
    "gsm, se3": 45.318,  # as printed
    "gsm_w_xi": 50.279,
    "gsm_w_sk": 58.651,
    "gsm_irls_xi": 218.598,
    "gsm_irls_sk": 212.924,
    "gsm_w_xi_t": 50.279,
    "gsm_w_sk_t": 53.795,
    "gsm_irls_xi_t": 48.126,
    "gsm_irls_sk_t": 58.836,
}
AIMS = {"8pa": 0.6, "opt_sk": 5.0, "gsm_w_sk": 12.0}  # times PoseLib, at 200 points
AIM_POINTS = 200
PEER = "PoseLib essential_matrix_8pt (E)"
# A clock of the thread's own work where the system has a fine one: other programs do not count.
CLOCK = time.thread_time if time.get_clock_info("thread_time").resolution < 1e-6 else None

Call = Callable[[], Any]


@dataclass(frozen=True)
class Row:
    """One line of a table: an estimator in its three forms; a form that is missing is None."""

    name: str
    native: Call | None
    public: Call | None
    twin: Call | None


def main() -> int:
    """Run the benchmark as the command line says; exit code 2 for wrong use."""
    options = _parse_options()
    try:
        if options.markdown is not None:
            check_writable(options.markdown, name="--markdown")
        check_picture(options.picture)
    except ValueError as error:
        print(f"paper_methods.py: {error}", file=sys.stderr)
        return 2
    facts = machine_facts(PACKAGES)
    facts["scenes"] = f"{options.scenes} rooms, 20 % outliers, noise kappa 500 in one view"
    facts["times"] = f"median over the scenes of the least of {options.repeat} interleaved runs"
    facts["clock"] = "CPU time of the thread" if CLOCK else "wall time"
    blocks = ["\n".join(f"- {line}" for line in fact_lines(facts))]
    print(blocks[0], flush=True)
    panels = []
    for num_points in options.points:
        times = _measure(num_points, options)
        panels.append(_panel(num_points, times))
        blocks += [f"## {num_points} points", markdown_table(_table(times))]
        if num_points == AIM_POINTS:
            blocks.append(_aims(times))
        print("\n" + "\n\n".join(blocks[-3 if num_points == AIM_POINTS else -2 :]), flush=True)
    blocks.append(f"Load at the end: {load_average()}")
    if options.markdown is not None:
        write_file(options.markdown, ("\n\n".join(blocks) + "\n").encode())
    facts["load_average_at_end"] = load_average()
    remark = "(E): ends at the essential matrix. The paper's times are of some 200 tracks."
    title = "Times of the paper's estimators"
    write_picture(
        options.picture, title, panels, facts, hollow=("paper",), columns=2, remark=remark
    )
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Microseconds of the paper's estimators.")
    parser.add_argument("--points", type=int, nargs="+", default=POINTS, help="matches a scene")
    parser.add_argument("--scenes", type=int, default=9, help="scenes of each size")
    parser.add_argument("--repeat", type=int, default=7, help="interleaved runs of each")
    parser.add_argument("--markdown", type=Path, help="file for the tables")
    add_picture_option(parser)
    return parser.parse_args()


def _rows(scene: TwoViewScene) -> list[Row]:
    data = (scene.bearings1, scene.bearings2)
    rows = [
        Row(PEER, _peer(*data), None, None),
        Row(
            "8pa (E)",
            partial(_core.eight_point, *data),
            partial(epi360.eight_point, *data),
            partial(epipolar.eight_point, *data),
        ),
        Row(
            "taubin (E)",
            partial(_core.solve_linear, *data, "none", True),
            partial(epi360.eight_point, *data, constraint="taubin"),
            partial(epipolar.eight_point, *data, constraint="taubin"),
        ),
    ]
    variants = [
        *((name, (name, "line", "manifold")) for name in PAPER_METHODS),
        ("opt_sk, lm", ("opt_sk", "lm", "manifold")),
        ("gsm, se3", ("gsm", "line", "se3")),
    ]
    functions = (_core.paper_pose, epi360.paper_pose, paper_pose_reference)
    rows += [Row(name, *(partial(f, *data, *how) for f in functions)) for name, how in variants]
    return rows


def _peer(bearings1: Any, bearings2: Any) -> Call | None:
    try:
        import poselib
    except ImportError:
        return None
    return partial(poselib.essential_matrix_8pt, bearings1, bearings2)


def _measure(num_points: int, options: argparse.Namespace) -> dict[str, list[float | None]]:
    """Microseconds (native, public, twin) by name."""
    scenes = [
        two_view_scene(seed, num_matches=num_points, outlier_ratio=0.2, kappa=500.0)
        for seed in range(options.scenes)
    ]
    rows = [_rows(scene) for scene in scenes]
    least: dict[tuple[int, str, int], float] = {}
    for _ in range(options.repeat):
        for index, scene_rows in enumerate(rows):
            for row in scene_rows:
                for form, call in enumerate((row.native, row.public, row.twin)):
                    key = (index, row.name, form)
                    # The twins are slow: one run, on three scenes.
                    if call is None or (form == 2 and (key in least or index > 2)):
                        continue
                    least[key] = min(_microseconds(call), least.get(key, float("inf")))
    names = [row.name for row in rows[0]]
    return {name: [_median_of(least, name, form) for form in range(3)] for name in names}


def _microseconds(call: Call) -> float:
    """Time of one call, from as many as take two milliseconds."""
    clock = CLOCK or time.perf_counter
    count, elapsed = 1, 0.0
    while True:
        start = clock()
        for _ in range(count):
            call()
        elapsed = clock() - start
        if elapsed > 2e-3:
            return 1e6 * elapsed / count
        count *= 4


def _median_of(least: dict[tuple[int, str, int], float], name: str, form: int) -> float | None:
    values = [value for key, value in least.items() if key[1:] == (name, form)]
    return median(values) if values else None


def _table(times: dict[str, list[float | None]]) -> list[list[str]]:
    peer = times[PEER][0]
    table = [["method", "paper ms", "native us", "public us", "twin us", "native / PoseLib"]]
    for name, (native, public, twin) in times.items():
        ratio = f"{native / peer:.2f}" if peer and native else "-"
        paper = f"{PAPER_MS[name]:g}" if name in PAPER_MS else "-"
        table.append([name, paper, *(_number(value) for value in (native, public, twin)), ratio])
    return table


def _panel(num_points: int, times: dict[str, list[float | None]]) -> Panel:
    names = ("native core", "public function", "NumPy twin")
    entries = [
        (name, "PoseLib" if name == PEER else form, value)
        for name, forms in times.items()
        for form, value in zip(names, forms, strict=True)
        if value is not None
    ]
    entries += [(name, "paper", 1e3 * ms) for name, ms in PAPER_MS.items() if name in times]
    return panel_of(f"{num_points} points", "microseconds a call", entries, powers=True)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}" if value < 1000.0 else f"{value:.0f}"


def _aims(times: dict[str, list[float | None]]) -> str:
    peer = times[PEER][0]
    if peer is None:
        return "PoseLib is not installed: pip install 'epi360[bench]'"
    lines: Sequence[str] = [
        f"- `{name}`: {native / peer:.2f} x PoseLib, aim {aim:g}: "
        f"{'holds' if native <= aim * peer else 'does not hold'}"
        for name, aim in AIMS.items()
        if (native := times[name][0]) is not None
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
