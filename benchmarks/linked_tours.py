# SPDX-License-Identifier: BSD-3-Clause
"""How ``epi360 match`` judges real virtual tours, held against the links that their makers put.

``python benchmarks/linked_tours.py TOURS --out DIR`` takes every tour below the folder TOURS that
the Marzipano Tool has exported (`_linked_tours`), and prints for each how many pairs were accepted;
of those that are linked there and back, how many say the same as their links and how many do not;
and the same of the poses that the matches determine and `match` refuses. Links may be wrong; so it
also prints how many of the accepted pairs close a loop with the others, those of most inliers, and
how many of these loops close in rotation. README.md beside this file says which public tours were
measured.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import _one_thread  # noqa: F401 - before NumPy
import numpy as np
from _linked_tours import LinkedTour, linked_tours
from _summary import text_table

from epi360.jobs.folder.image_set import find_images
from epi360.jobs.matching.match_folder import MatchOptions, PairVerdict, match_images
from epi360.poses import rotation_error_deg

WIDTH = 2048  # of the panoramas, in pixels
ACCEPTED, REFUSED = "accepted", "refused"
SAYINGS = {True: "as linked", False: "not as linked", None: "not linked"}
COLUMNS = [(kind, saying) for kind in (ACCEPTED, REFUSED) for saying in SAYINGS.values()]
LOOPS = ["loops", "that close"]
CLOSES_DEG = 5.0


def main() -> None:
    """Print a row for each tour, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tours", type=Path, help="folder of exported tours")
    parser.add_argument("--out", type=Path, default=Path("linked_tours"), help="keeps pictures")
    parser.add_argument("--jobs", type=int, default=2, help="threads (2)")
    parser.add_argument(
        "--list", action="store_true", help="print the pairs that are not as linked"
    )
    options = parser.parse_args()
    rows = [["tour", "panoramas", "pairs", *(", ".join(column) for column in COLUMNS), *LOOPS]]
    total: Counter[tuple[str, str]] = Counter()
    loops = np.zeros(2, dtype=int)
    for tour in linked_tours(options.tours):
        verdicts = _verdicts(tour, options.out, options.jobs)
        posed = [(each, _column(tour, each)) for each in verdicts if _has_pose(each)]
        counts = Counter(column for _, column in posed)
        total += counts
        closing = _loops([each for each, column in posed if column[0] == ACCEPTED])
        loops += closing
        counted = [counts[column] for column in COLUMNS]
        numbers = [len(tour.names), len(verdicts), *counted, *closing]
        rows.append([tour.name, *map(str, numbers)])
        print(tour.name, *numbers, flush=True)
        for each, column in posed if options.list else ():
            if column[1] == SAYINGS[False]:
                print("   ", *column, *_names(each), each.num_inliers)
    rows.append(["all", "", "", *(str(total[column]) for column in COLUMNS), *map(str, loops)])
    print(text_table(rows))


def _verdicts(tour: LinkedTour, out: Path, num_threads: int) -> tuple[PairVerdict, ...]:
    folder = out / "panoramas" / tour.name
    tour.write_panoramas(folder, WIDTH)
    run = match_images(
        find_images(folder),
        out / "match" / tour.name,
        MatchOptions(num_threads=num_threads),
        restart=True,
    )
    return run.verdicts


def _has_pose(verdict: PairVerdict) -> bool:
    """Whether matches determine a pose, accepted or refused for what surrounds them."""
    has_direction = np.isfinite(verdict.cam2_from_cam1.translation).all()
    return verdict.status in ("ok", "refused") and bool(has_direction)


def _column(tour: LinkedTour, verdict: PairVerdict) -> tuple[str, str]:
    agrees = tour.agrees(*_names(verdict), verdict.cam2_from_cam1)
    return (ACCEPTED if verdict.accepted else REFUSED, SAYINGS[agrees])


def _loops(verdicts: Sequence[PairVerdict]) -> tuple[int, int]:
    """How many pairs close a loop with those of more inliers, and how many of these loops close."""
    turns = {name: np.eye(3) for each in verdicts for name in _names(each)}  # from its group
    groups = {name: [name] for name in turns}
    num_loops = num_closing = 0
    for each in sorted(verdicts, key=lambda each: -each.num_inliers):
        first, second = _names(each)
        turn = turns[second].T @ each.cam2_from_cam1.rotation @ turns[first]
        if groups[first] is groups[second]:
            num_loops += 1
            num_closing += rotation_error_deg(turn, np.eye(3)) < CLOSES_DEG
            continue
        joined = [*groups[first], *groups[second]]
        turns |= {name: turns[name] @ turn for name in groups[second]}
        groups |= dict.fromkeys(joined, joined)
    return num_loops, num_closing


def _names(verdict: PairVerdict) -> tuple[str, str]:
    return Path(verdict.image1).name, Path(verdict.image2).name


if __name__ == "__main__":
    main()
