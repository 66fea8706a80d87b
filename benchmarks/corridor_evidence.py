# SPDX-License-Identifier: BSD-3-Clause
"""Fits what a pair shows by itself to corridors with equal doors.

``python benchmarks/corridor_evidence.py --out DIR`` renders corridors with a plain floor, matches
all pairs of each, and takes those poses that their matches alone accept. It prints how well the
numbers that `epi360.places.own_evidence.shown_by` gives tell right ones, in corridors that they
were not fitted to. With ``--write`` the odds that are fitted to all become those of the package.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from functools import partial
from pathlib import Path

import _one_thread  # noqa: F401 - before NumPy
import numpy as np
from _panorama_pairs import PanoramaView, posed, rounded, write_fit
from _summary import text_table
from corridors import RIGHT_DEG, Walk, rendered_walk
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from epi360.jobs.threads import num_cores, on_threads
from epi360.places import corridor
from epi360.places.own_evidence import SHOWN, OwnEvidence, grow_both, shown_by
from epi360.poses import poses_agree

Array = NDArray[np.float64]

PENALTY = 0.5  # of the squares of the odds for a standard deviation of each number
LIMITS = 0.5, 99.5  # percentiles of the numbers, beyond which nothing is known
NUM_PARTS = 5  # of the corridors, each of which is told by what is fitted to the others
ACCEPTED = 0.85
DOWN = (0.0, 1.0, 0.0)


def main() -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=100, help="of the first corridor (100)")
    parser.add_argument("--rendered", type=int, default=30, help="corridors as rendered (30)")
    parser.add_argument("--photographed", type=int, default=20, help="as cameras take them (20)")
    parser.add_argument("--out", type=Path, required=True, help="keeps pictures and numbers")
    parser.add_argument("--write", action="store_true", help="become those of the package")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.rendered + options.photographed)
    kept = [
        _kept(options.out, seed, photos=number >= options.rendered)
        for number, seed in enumerate(seeds)
    ]
    rows = np.concatenate(kept)
    sources = np.repeat(np.arange(len(kept)), [len(each) for each in kept])
    right, numbers = rows[:, 0] > 0, rows[:, 1:]
    print(text_table(_told(sources, right, numbers)))
    if options.write:
        record = {
            "made_by": f"python benchmarks/corridor_evidence.py --seed {options.seed} --rendered "
            f"{options.rendered} --photographed {options.photographed} --write",
            "shown": list(SHOWN),
            "num_right": int(right.sum()),
            "num_wrong": int((~right).sum()),
            **{name: rounded(values) for name, values in fitted(right, numbers).items()},
        }
        path = Path(corridor.__file__).with_name(corridor.ODDS)
        write_fit(path, record)
    return 0


def fitted(right: NDArray[np.bool_], numbers: Array) -> dict[str, Array]:
    """Limits, centre and spread of the numbers (N, 7), and the odds (8,) of `corridor.Odds`."""
    least, most = np.percentile(numbers, LIMITS, axis=0)
    limited = np.clip(numbers, least, most)
    centre, spread = limited.mean(axis=0), limited.std(axis=0)
    scaled = (limited - centre) / spread
    sign = np.where(right, 1.0, -1.0)

    def cost(odds: Array) -> float:
        told = odds[0] + scaled @ odds[1:]
        return float(np.logaddexp(0.0, -sign * told).sum() + PENALTY * (odds[1:] ** 2).sum())

    odds = minimize(cost, np.zeros(numbers.shape[1] + 1), method="BFGS").x
    return {"least": least, "most": most, "centre": centre, "spread": spread, "odds": odds}


def _told(sources: Array, right: NDArray[np.bool_], numbers: Array) -> list[tuple[str, ...]]:
    """Rows of a table: what is accepted of corridors by odds that are fitted to the others."""
    told = np.zeros(len(right))
    for part in range(NUM_PARTS):
        own = sources % NUM_PARTS == part
        by_others = corridor.Odds(**fitted(right[~own], numbers[~own]))
        told[own] = [by_others.of(each) for each in numbers[own]]
    rows = [("stated", "poses", "right", "wrong")]
    edges = (0.0, 0.1, 0.5, 0.7, ACCEPTED, 0.95, 1.0)
    stated = expit(told)
    for low, high in itertools.pairwise(edges):
        some = (stated >= low) & (stated < high)
        counts = some.sum(), (some & right).sum(), (some & ~right).sum()
        rows.append((f"{low:g} to {high:g}", *map(str, counts)))
    return rows


def _kept(out: Path, seed: int, *, photos: bool) -> Array:
    """What the pairs of one corridor show, as it was found before."""
    path = out / f"corridor_{seed}.npy"
    if not path.is_file():
        walk = rendered_walk(out / "pictures", "plain floor", seed, photos=photos)
        np.save(path, _shown(walk))
        print(f"{walk.name}: {len(np.load(path))} poses", flush=True)
    shown: Array = np.load(path)
    return shown


def _shown(walk: Walk) -> Array:
    """Rows (P, 8) of accepted poses where the place repeats: whether it is right, its numbers."""
    view_of = dict(on_threads(partial(PanoramaView.of, walk.folder), list(walk.poses), num_cores()))

    def row_of(names: tuple[str, str]) -> list[float]:
        both = [view_of[name] for name in names]
        pair = posed(both, gravity1=DOWN, gravity2=DOWN)
        if pair is None:
            return []
        panoramas = [view.panorama for view in both]
        views = grow_both(pair, panoramas)
        has_floor = corridor.show_a_floor(views)
        if not OwnEvidence.of(pair, views).is_known or has_floor:
            return []
        if not corridor.repeats_itself(views, panoramas):
            return []
        first, second = (walk.poses[name] for name in names)
        is_right = poses_agree(pair.cam2_from_cam1, second.inverse() @ first, RIGHT_DEG, RIGHT_DEG)
        return [float(is_right), *shown_by(pair, views)]

    pairs = list(itertools.combinations(walk.poses, 2))
    row_of_pair = dict(on_threads(row_of, pairs, num_cores()))
    rows = [row_of_pair[pair] for pair in pairs if row_of_pair[pair]]
    return np.array(rows).reshape(-1, 1 + len(SHOWN))


if __name__ == "__main__":
    sys.exit(main())
