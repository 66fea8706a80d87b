# SPDX-License-Identifier: BSD-3-Clause
"""Fits what a pair shows by itself to homes and real tours, and says how well it tells copies.

``python benchmarks/own_evidence.py --seeds 0,30,40 --tours TOURS --out DIR`` renders four homes
from each seed on, level and tilted, and takes each home as it is and photographed. It matches all
pairs of each, and those of the real virtual tours in folders of TOURS (`_linked_tours`), of which
it takes the pairs that their links say are right. It prints how well weights that are fitted to
the homes of the other seeds and the tours of the other folders tell right pairs from copies and
from other rooms. With ``--write`` the weights that are fitted to all, and those that are fitted to
the homes alone, become those of the package.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import _one_thread  # noqa: F401 - before NumPy
import numpy as np
from _homes import rendered_homes
from _linked_tours import LinkedTour, linked_tours
from _panorama_pairs import PanoramaView, posed, rounded, write_fit
from _summary import text_table
from _trust_records import RIGHT_DEG, WRONG_DEG, errors_of
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import rankdata

from epi360.jobs.threads import num_cores, on_threads
from epi360.places import own_evidence
from epi360.places.one_surface import on_floor
from epi360.places.own_evidence import SHOWN, Weights, grow_both, terms
from epi360.poses import Pose
from epi360.runs.whole_files import write_file
from epi360_scenes.tours import Tour

Array = NDArray[np.float64]

LEAST_SHARE, MOST_SHARE = 0.01, 0.99  # of the pairs that are beyond the limits of the numbers
KINDS = RENDERED, PHOTOGRAPHED, REAL = "rendered", "photographed", "real"
CASES = ROOM, DOOR, LINKED, COPY, OTHER = (
    "one room",
    "through a door",
    "linked",
    "copy",
    "other room",
)
RIGHT = {ROOM: 0.325, DOOR: 0.175, LINKED: 0.5}  # and their shares
PENALTY, OF_HOMES = 1e-3, 4e-4  # of the squares of the weights, and of those for homes alone
TOUR_WIDTH = 2048  # of real panoramas, in pixels
FEWEST_PAIRS = 100  # of each case, for 36 weights
FALSE_SHARE = 0.01  # of the wrong pairs that a threshold lets pass


class Shown(NamedTuple):
    """What one pair shows: where it is from, its pictures, its case, its seven numbers.

    It is from the homes of a seed, or from the tours of a folder. A pair that lies on the floor
    alone has no numbers, for it has nothing to say. One on a wall has nothing to say in a folder,
    but is weighed where it is alone, so it belongs to the fit.
    """

    source: str
    kind: str
    case: str
    numbers: Array


def main() -> int:
    """Run what the command line asks for."""
    options = _parse_options()
    homes = f"{options.homes}_homes_{options.width}"
    measures = [(f"{homes}_{seed}", partial(_shown_in_homes, seed)) for seed in options.seeds]
    sources = sorted(each for each in options.tours.iterdir() if each.is_dir())
    measures += [(f"tours_{source.name}", partial(_shown_in_tours, source)) for source in sources]
    every = [each for name, measure in measures for each in _kept(name, measure, options)]
    shown = [each for each in every if len(each.numbers)]
    are_right = [each.case in RIGHT for each in every if not len(each.numbers)]
    print(f"On the floor alone lie {len(are_right)} pairs, {sum(are_right)} of them right.")
    counts = {case: sum(each.case == case for each in shown) for case in CASES}
    if min(counts.values()) < FEWEST_PAIRS:
        print(f"each case must have {FEWEST_PAIRS} pairs, there are {counts}: take more")
        return 1
    print(text_table(_rows(shown)))
    if options.write:
        path = Path(own_evidence.__file__).with_name(own_evidence.WEIGHTS)
        write_fit(path, _record(shown, options))
    return 0


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=_numbers, default=[0], help="first of each few homes")
    parser.add_argument("--homes", type=int, default=4, help="homes of each of the seeds")
    parser.add_argument("--width", type=int, default=1024, help="of the panoramas, in pixels")
    parser.add_argument(
        "--tours", type=Path, required=True, help="folders of real tours, as Marzipano exports them"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("own_evidence"),
        help="keeps pictures and what they show: take another one for other pictures or code",
    )
    parser.add_argument("--write", action="store_true", help="become those of the package")
    return parser.parse_args()


def _numbers(text: str) -> list[int]:
    return [int(each) for each in text.split(",")]


def _kept(
    name: str, measure: Callable[[argparse.Namespace], Iterator[Shown]], options: argparse.Namespace
) -> list[Shown]:
    """What was measured before, or is measured now and kept: all of it takes hours."""
    path = options.out / "shown" / f"{name}.json"
    if path.exists():
        kept = json.loads(path.read_text("utf-8"))
        return [Shown(source, kind, case, np.array(told)) for source, kind, case, told in kept]
    shown = list(measure(options))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, json.dumps([[*each[:-1], each.numbers.tolist()] for each in shown]).encode())
    return shown


def _shown_in_homes(seed: int, options: argparse.Namespace) -> Iterator[Shown]:
    folder = options.out / str(seed) / "tours"
    for kind in (RENDERED, PHOTOGRAPHED):
        homes = rendered_homes(
            folder, seed, options.homes, options.width, photographed=kind == PHOTOGRAPHED
        )
        for one in homes:
            shown = _shown_in(one.tour.folder, _names(one.tour), partial(_case, one.tour), seed)
            found = [Shown(str(seed), kind, *each) for each in shown]
            print(f"seed {seed}, {one.name}: {len(found)} pairs", flush=True)
            yield from found


def _shown_in_tours(source: Path, options: argparse.Namespace) -> Iterator[Shown]:
    for tour in linked_tours(source):
        folder = options.out / "tours" / f"{source.name}_{tour.name}"
        tour.write_panoramas(folder, TOUR_WIDTH)
        shown = _shown_in(folder, tour.names, partial(_linked_case, tour), 0)
        found = [Shown(source.name, REAL, *each) for each in shown]
        print(f"{source.name}, {tour.name}: {len(found)} pairs", flush=True)
        yield from found


def _shown_in(
    folder: Path,
    names_of_panoramas: Sequence[str],
    case_of: Callable[[tuple[str, str], Pose], str | None],
    seed: int,
) -> list[tuple[str, Array]]:
    """Cases and numbers of the pairs whose matches determine a right or wrong pose."""
    views = dict(on_threads(partial(PanoramaView.of, folder), names_of_panoramas, num_cores()))

    def look(names: tuple[str, str]) -> tuple[str, Array] | None:
        both = [views[name] for name in names]
        pair = posed(both, seed=seed)
        case = None if pair is None else case_of(names, pair.cam2_from_cam1)
        if pair is None or case is None:
            return None
        if on_floor(pair):
            return case, np.empty(0)
        grown = grow_both(pair, [view.panorama for view in both])
        return case, own_evidence.shown_by(pair, grown)

    pairs = list(itertools.combinations(names_of_panoramas, 2))
    found = dict(on_threads(look, pairs, num_cores()))
    return [each for pair in pairs if (each := found[pair]) is not None]


def _names(tour: Tour) -> list[str]:
    return [one.name for one in tour.panoramas]


def _case(tour: Tour, names: tuple[str, str], pose: Pose) -> str | None:
    """Which case a pair is; None between right and wrong."""
    error = max(errors_of(pose, tour.cam2_from_cam1(*names)))
    relation = tour.relation(*names)
    if error < RIGHT_DEG:
        return ROOM if relation == "one room" else DOOR
    if error < WRONG_DEG:
        return None
    return COPY if relation in ("twins", "mirrored") else OTHER


def _linked_case(tour: LinkedTour, names: tuple[str, str], pose: Pose) -> str | None:
    """Pairs whose links say the same are right; of others nothing is known."""
    agrees = tour.agrees(*names, pose)
    return LINKED if (tour.turn_agrees(*names, pose) if agrees is None else agrees) else None


def _rows(shown: Sequence[Shown]) -> list[list[str]]:
    """How well weights of the other seeds' homes and folders' tours tell right from wrong ones.

    No copies are known among real pairs, so these are told from photographed ones.
    """
    kept_at = f"kept at {FALSE_SHARE:.0%} of the wrong"
    rows = [["pictures", "right", "wrong", "pairs", "area under ROC", kept_at]]
    ratios, cases = _held_out(shown), np.array([each.case for each in shown])
    kinds = np.array([each.kind for each in shown])
    for kind, (column, wrong) in itertools.product(KINDS, enumerate((OTHER, COPY))):
        copied = PHOTOGRAPHED if kind == REAL else kind
        against = ratios[(kinds == copied) & (cases == wrong), column]
        for right in (LINKED,) if kind == REAL else (ROOM, DOOR):
            speaks = ratios[(kinds == kind) & (cases == right), column]
            counts = f"{len(speaks)}, {len(against)}"
            kept = np.mean(speaks > np.quantile(against, 1 - FALSE_SHARE))
            area = f"{_area(speaks, against):.3f}"
            rows.append([kind, right, wrong, counts, area, f"{kept:.0%}"])
    return rows


def _held_out(shown: Sequence[Shown]) -> Array:
    """Log-likelihood ratios (N, 2) over other rooms and over copies, by the other sources."""
    sources = sorted({each.source for each in shown})
    fitted = {one: _weights([each for each in shown if each.source != one]) for one in sources}
    return np.array([fitted[each.source].ratios(each.numbers) for each in shown])


def _weights(shown: Sequence[Shown], penalty: float = PENALTY) -> Weights:
    """Logistic regression of right pairs against those of other rooms, and against copies."""
    cases = np.array([each.case for each in shown])
    numbers = np.array([each.numbers for each in shown])
    least, most = np.quantile(numbers, (LEAST_SHARE, MOST_SHARE), axis=0)
    limited = np.clip(numbers, least, most)
    no = np.zeros(len(terms(least)))
    scaling = Weights(least, most, limited.mean(axis=0), limited.std(axis=0), no, no)
    told = terms(scaling.scaled(numbers))
    return replace(
        scaling,
        over_others=_regressed(told, cases, _counts_of(shown), OTHER, penalty),
        over_copies=_regressed(told, cases, _counts_of(shown), COPY, penalty),
    )


def _counts_of(shown: Sequence[Shown]) -> Array:
    """How much each pair counts beside others of its case: a large tour is one kind of pictures."""
    real = Counter(each.source for each in shown if each.kind == REAL)
    return np.array([real[each.source] ** -0.5 if each.kind == REAL else 1.0 for each in shown])


def _regressed(
    told: Array, cases: NDArray[np.str_], counts: Array, wrong: str, penalty: float
) -> Array:
    """Weights that make a log-likelihood ratio, so that right and wrong pairs count as much."""
    right = {case: share for case, share in RIGHT.items() if np.any(cases == case)}
    shares = {case: share / sum(right.values()) for case, share in right.items()} | {wrong: 1.0}
    counted = np.isin(cases, list(shares))
    told, cases, counts = told[counted], cases[counted], counts[counted]
    signs = np.where(cases == wrong, -1.0, 1.0)
    sums = {case: counts[cases == case].sum() for case in shares}
    importance = counts * np.array([shares[case] / sums[case] for case in cases]) / 2
    penalties = np.where(np.arange(told.shape[1]) > 0, penalty, 0.0)

    def loss(weights: Array) -> tuple[float, Array]:
        margins = signs * (told @ weights)
        slopes = told.T @ (-importance * signs * expit(-margins)) + penalties * weights
        value = importance @ np.logaddexp(0.0, -margins) + penalties @ weights**2 / 2
        return float(value), slopes

    found = minimize(loss, np.zeros(told.shape[1]), jac=True, options={"maxiter": 10_000})
    if not found.success:
        raise RuntimeError(f"the fit of pairs against {wrong} has not converged: {found.message}")
    weights: Array = found.x
    return weights


def _area(right: Array, wrong: Array) -> float:
    """Chance that a right pair gets more than a wrong one."""
    ranks = rankdata(np.concatenate([right, wrong]))[: len(right)]
    below = ranks.sum() - len(right) * (len(right) + 1) / 2
    return float(below / (len(right) * len(wrong)))


def _record(shown: Sequence[Shown], options: argparse.Namespace) -> dict[str, Any]:
    """What the package reads."""
    seeds = ",".join(map(str, options.seeds))
    of_homes = [each for each in shown if each.kind != REAL]
    return {
        "made_by": f"python benchmarks/own_evidence.py --homes {options.homes} --seeds {seeds} "
        f"--width {options.width} --tours TOURS --write",
        "tours": sorted({each.source for each in shown if each.kind == REAL}),
        "num_pairs": {case: sum(each.case == case for each in shown) for case in CASES},
        "shown": list(SHOWN),
        own_evidence.EVERY: _values(_weights(shown)),
        own_evidence.HOMES: _values(_weights(of_homes, OF_HOMES)),
    }


def _values(weights: Weights) -> dict[str, list[float]]:
    return {name: rounded(values) for name, values in vars(weights).items()}


if __name__ == "__main__":
    sys.exit(main())
