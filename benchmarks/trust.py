# SPDX-License-Identifier: BSD-3-Clause
"""Whether an "ok" holds: accepted, right and wrong poses on tours and on anybody's matches.

``python benchmarks/trust.py --sets zind,learned,tours,cells,degenerate`` prints for each set how
many poses are accepted, how many of them are right and wrong, how many right ones remain where
wrong ones are kept out, and whether stated probabilities are kept, with pycolmap on the same
matches beside us. README.md beside this file says more.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import _one_thread  # noqa: F401 - before NumPy
from _data import data_folder
from _machine import fact_lines, load_average, machine_facts
from _picture import Entry, add_picture_option, check_picture, panel_of, write_picture
from _summary import markdown_table, text_table
from _trust_coherence import coherence_rows
from _trust_corners import corner_verdicts
from _trust_lone import PAIR, few_verdicts, pair_verdicts, small_verdicts, tour_pair_verdicts
from _trust_pairs import (
    FOLDER,
    OURS,
    Plan,
    given_verdicts,
    learned_verdicts,
    tour_verdicts,
    zind_verdicts,
)
from _trust_records import (
    PRECISIONS,
    Judged,
    count_rows,
    for_json,
    precision_rows,
    relation_rows,
    wrong_lines,
)
from _trust_reliability import draw_reliability, held, held_rows, stated_probabilities
from _trust_synthetic import (
    Trial,
    camera_trials,
    cell_trials,
    degenerate_trials,
    trial_rows,
)

from epi360.report.files import check_writable
from epi360.report.overview import Panel
from epi360.runs.whole_files import write_file

PACKAGES = ("epi360", "pycolmap", "numpy", "opencv-python-headless")
PAIR_SETS: dict[str, Callable[[Plan], Iterator[Judged]]] = {
    "zind": zind_verdicts,
    "learned": learned_verdicts,
    "corners": corner_verdicts,
    "tours": tour_verdicts,
    "given": given_verdicts,
    "pairs": pair_verdicts,
    "tourpairs": tour_pair_verdicts,
    "few": few_verdicts,
    "small": small_verdicts,
}
SETS = (*PAIR_SETS, "cells", "degenerate", "cameras")
NEEDS_DATA = ("zind", "learned", "corners", "pairs")


def main() -> int:
    """Run the benchmark as the command line says; exit code 2 for wrong use."""
    options = _parse_options()
    try:
        for path, name in (
            (options.json, "--json"),
            (options.markdown, "--markdown"),
            (options.reliability, "--reliability"),
        ):
            if path is not None:
                check_writable(path, name=name)
        check_picture(options.picture)
        sets = _chosen_sets(options.sets)
        plan = _plan(options, sets)
    except ValueError as error:
        print(f"trust.py: {error}", file=sys.stderr)
        return 2
    facts = {
        **machine_facts(PACKAGES),
        "sets": sets,
        "seed": options.seed,
        "jobs": options.jobs,
        "homes": options.homes,
        "photographed": options.photographed,
        "lens_deg": options.lens,
        "trials": options.trials,
        "data": str(plan.data),
    }
    print("\n".join(fact_lines(facts)), flush=True)
    judged, trials = _run(sets, plan, options)
    facts["load_average_at_end"] = load_average()
    _write(facts, judged, trials, options)
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="How far verdicts can be trusted.")
    flag = argparse.BooleanOptionalAction
    parser.add_argument("--sets", default=",".join(SETS), help=f"all: {','.join(SETS)}")
    parser.add_argument("--data", help="folder of the sets; $EPI360_DATA, else ../shared/data")
    parser.add_argument("--out", type=Path, default=Path("out/trust"), help="pictures and matches")
    parser.add_argument("--homes", type=_positive, default=4, help="rendered homes (4)")
    parser.add_argument("--width", type=_positive, default=1024, help="of rendered panoramas")
    parser.add_argument(
        "--photographed", action="store_true", help="rendered homes as cameras may take them"
    )
    parser.add_argument(
        "--lens",
        type=_field_of_view,
        metavar="DEG",
        help="take what a fisheye lens of this field of view shows of homes",
    )
    parser.add_argument("--trials", type=_positive, default=100, help="of each synthetic kind")
    parser.add_argument("--peer", action=flag, default=True, help="run pycolmap if installed")
    parser.add_argument("--seed", type=int, default=0, help="of homes, problems and sampling (0)")
    parser.add_argument("--jobs", type=_positive, default=2, help="processes or threads (2)")
    parser.add_argument("--list-wrong", action="store_true", help="print each wrong pose of ours")
    parser.add_argument("--reliability", type=Path, help="PNG file for the reliability diagram")
    parser.add_argument("--json", type=Path, help="file for every verdict")
    parser.add_argument("--markdown", type=Path, help="file for the tables")
    add_picture_option(parser)
    return parser.parse_args()


def _positive(text: str) -> int:
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, got {number}")
    return number


def _field_of_view(text: str) -> float:
    if not 0.0 < (degrees := float(text)) <= 360.0:
        raise argparse.ArgumentTypeError(f"must be in (0, 360] degrees, got {text}")
    return degrees


def _chosen_sets(text: str) -> list[str]:
    names = text.split(",")
    unknown = [name for name in names if name not in SETS]
    if unknown:
        raise ValueError(f"--sets must be of {', '.join(SETS)}, got {unknown[0]!r}")
    return names


def _plan(options: argparse.Namespace, sets: list[str]) -> Plan:
    needs_data = any(name in NEEDS_DATA for name in sets)
    return Plan(
        data=data_folder(options.data) if needs_data else Path(),
        out=options.out,
        num_homes=options.homes,
        tour_width=options.width,
        photographed=options.photographed,
        lens_deg=options.lens,
        seed=options.seed,
        jobs=options.jobs,
        with_peer=options.peer and _has_peer(),
    )


def _has_peer() -> bool:
    try:
        import pycolmap  # noqa: F401
    except ImportError as error:
        print(f"pycolmap is not installed ({error}): pip install 'epi360[bench]'")
        return False
    return True


def _run(
    sets: Iterable[str], plan: Plan, options: argparse.Namespace
) -> tuple[list[Judged], list[Trial]]:
    """All sets, each reported as soon as it is done."""
    judged: list[Judged] = []
    trials: list[Trial] = []
    for name in sets:
        if name in PAIR_SETS:
            found = list(PAIR_SETS[name](plan))
            judged += found
            _print_judged(found, list_wrong=options.list_wrong)
        else:
            done = list(_trials(name, plan, options))
            trials += done
            for table in _tables([], done):
                print(f"\n{text_table(table)}", flush=True)
    for table in _shown([coherence_rows(judged)]):
        print(f"\n{text_table(table)}", flush=True)
    return judged, trials


def _trials(name: str, plan: Plan, options: argparse.Namespace) -> Iterator[Trial]:
    if name == "cells":
        return cell_trials(options.trials, plan.seed, plan.jobs, with_peer=plan.with_peer)
    make = camera_trials if name == "cameras" else degenerate_trials
    return make(options.trials, plan.seed, plan.jobs)


def _tables(judged: list[Judged], trials: list[Trial]) -> list[list[list[str]]]:
    tables = [make(judged) for make in (count_rows, relation_rows, precision_rows)]
    tables += [trial_rows(trials), held_rows(held(stated_probabilities(judged, trials)))]
    return _shown(tables)


def _shown(tables: list[list[list[str]]]) -> list[list[list[str]]]:
    """Tables that have more than a header."""
    return [table for table in tables if len(table) > 1]


def _print_judged(judged: list[Judged], *, list_wrong: bool) -> None:
    for table in _tables(judged, []):
        print(f"\n{text_table(table)}")
    for method in (OURS, f"{OURS}, gravity", FOLDER, PAIR) if list_wrong else ():
        for line in wrong_lines(judged, method):
            print(f"accepted and wrong by {method}: {line}")
    sys.stdout.flush()


def _write(
    facts: dict[str, Any], judged: list[Judged], trials: list[Trial], options: argparse.Namespace
) -> None:
    """Write the files that were asked for."""
    if options.json is not None:
        document = {
            **facts,
            "verdicts": [run.record() for run in judged],
            "synthetic": [for_json(asdict(trial)) for trial in trials],
        }
        write_file(options.json, json.dumps(document, indent=1, allow_nan=False).encode())
    if options.reliability is not None:
        draw_reliability(held(stated_probabilities(judged, trials)), options.reliability)
    if options.markdown is not None:
        lines = "\n".join(f"- {line}" for line in fact_lines(facts))
        tables = [*_tables(judged, trials), *_shown([coherence_rows(judged)])]
        blocks = [lines, *map(markdown_table, tables)]
        write_file(options.markdown, ("\n\n".join(blocks) + "\n").encode())
    write_picture(
        options.picture,
        "Whether an accepted pose holds",
        _panels(judged, trials),
        facts,
        remark="Right: both errors below 5°. Wrong: one above 10°.",
    )


def _panels(judged: list[Judged], trials: list[Trial]) -> list[Panel]:
    """Counts and shares of the tables as dots."""
    counts, held = count_rows(judged)[1:], precision_rows(judged)[1:]
    found = [row for row in counts if "=" in row[8]]
    synthetic = trial_rows(trials)[1:]

    def shares(rows: list[list[str]], column: int, whole: int) -> list[Entry]:
        return [
            (row[0], row[1], 100.0 * int(row[column]) / max(int(row[whole]), 1)) for row in rows
        ]

    recall = [(row[0], row[1], float(row[8].partition("= ")[2].rstrip("%"))) for row in found]
    at_level = [(row[0], row[1], float(row[4 + PRECISIONS.index(0.99)])) for row in held]
    return [
        panel_of("Accepted poses that are wrong", "% of the accepted", shares(counts, 6, 3)),
        panel_of("Recall: pairs that can be asked for", "%, accepted and right", recall),
        panel_of("Right poses kept where 99 % are not wrong", "poses", at_level),
        panel_of("Synthetic: accepted and right", "% of the trials", shares(synthetic, 4, 2)),
        panel_of("Synthetic: accepted and wrong", "% of the trials", shares(synthetic, 5, 2)),
        panel_of(
            "Synthetic: said to be a pure rotation", "% of the trials", shares(synthetic, 6, 2)
        ),
    ]


if __name__ == "__main__":
    sys.exit(main())
