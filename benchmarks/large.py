# SPDX-License-Identifier: BSD-3-Clause
"""Folders of a thousand panoramas: which pairs retrieval finds, and what a large result takes.

``python benchmarks/large.py --help``; README.md beside this file says what is measured.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from _large_folder import load_peak_mb, write_large_folder
from _machine import fact_lines, machine_facts
from _summary import text_table

from epi360.features import Features
from epi360.features.visual_words import NUM_DESCRIPTORS
from epi360.jobs.folder.feature_cache import ExtractionOptions, FeatureCache
from epi360.jobs.folder.image_set import ImageSet, find_images
from epi360.jobs.matching.match_folder import MatchOptions, PairVerdict, match_images
from epi360.jobs.pairs.retrieval import alike_pairs
from epi360.poses import rotation_error_deg, translation_error_deg
from epi360.runs.file_digests import FileDigests
from epi360.runs.whole_files import write_file
from epi360_scenes.tours import render_tour

PACKAGES = ("epi360", "numpy", "opencv-python-headless")
PER_HOME = 24  # panoramas
NEIGHBORS = (5, 10, 20, 40)
OVERLAPS = (0.2, 0.3)  # least shares of the views that count
RIGHT_DEG = 5.0  # largest errors of a right pose
SHARE = 0.05  # of all pairs
Pair = tuple[int, int]


@dataclass(frozen=True)
class Chosen:
    """Pairs that retrieval chose, and what it took."""

    neighbors: int
    num_pairs: int
    share: float  # of all pairs
    recall: tuple[float, ...]  # of the pairs that overlap by OVERLAPS
    wall_s: float
    cpu_s: float


def main() -> None:
    """Measure, print and write what is asked for."""
    options = _options()
    facts = machine_facts(PACKAGES)
    print("\n".join(fact_lines(facts)), flush=True)
    results: dict[str, Any] = {"machine": facts}
    if options.images:
        results |= _retrieval(options)
    if options.pairs:
        results["load"] = _load(options)
    write_file(options.out / "large.json", json.dumps(results, indent=1).encode())
    print(f"wrote {options.out / 'large.json'}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="keeps pictures and key points")
    parser.add_argument("--images", type=int, default=1000, help="panoramas (1000); 0: none")
    parser.add_argument("--width", type=int, default=512, help="of the panoramas (512)")
    parser.add_argument("--pairs", type=int, default=100_000, help="to load (100000); 0: none")
    parser.add_argument("--verify", action="store_true", help="also match the pairs of retrieval")
    parser.add_argument("--jobs", type=int, default=multiprocessing.cpu_count(), help="processes")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    return options


def _retrieval(options: argparse.Namespace) -> dict[str, Any]:
    images, overlaps, render_s = _panoramas(options)
    start = time.perf_counter()
    keys = _find_features(images, options)
    features_s = time.perf_counter() - start
    print(f"{len(keys)} panoramas: rendered in {render_s:.0f} s, features in {features_s:.0f} s")
    cache = _cache(options.out)
    rows = [_chosen(cache, keys, overlaps, count, options.jobs) for count in NEIGHBORS]
    header = ["neighbors", "pairs", "of all"]
    header += [f"recall at {overlap:g}" for overlap in OVERLAPS] + ["wall s", "CPU s"]
    print(text_table([header, *(_cells(row) for row in rows)]))
    best = max((row for row in rows if row.share <= SHARE), key=lambda row: row.share, default=None)
    if best is not None:
        print(
            f"at {100 * best.share:.1f} % of all pairs, with {best.neighbors} partners each: "
            f"{100 * best.recall[-1]:.1f} % of the pairs that share {OVERLAPS[-1]:g} of their views"
        )
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"peak memory of retrieval {peak_mb:.0f} MB", flush=True)
    found: dict[str, Any] = {
        "rendering_s": render_s,
        "features_s": features_s,
        "retrieval": [vars(row) for row in rows],
        "peak_mb": peak_mb,
    }
    if options.verify:
        found["verified"] = _verified(images, overlaps, options)
    return found


def _panoramas(
    options: argparse.Namespace,
) -> tuple[ImageSet, dict[Pair, float], float]:
    """Images in sub-folders, one a home, and which share of its view each pair shares."""
    homes = range(-(-options.images // PER_HOME))
    start = time.perf_counter()
    folder = options.out / f"tour{options.width}"
    render = partial(_render_home, folder, options.width)
    with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        shared = dict(pair for found in pool.map(render, homes) for pair in found)
    render_s = time.perf_counter() - start
    found = find_images(folder)
    kept = tuple(
        image for image in found.images if int(image.name.partition("/")[0][4:]) < len(homes)
    )
    index = {image.name: place for place, image in enumerate(kept)}
    overlaps = {
        (min(index[a], index[b]), max(index[a], index[b])): share
        for (a, b), share in shared.items()
    }
    return ImageSet(folder, found.cameras, kept), overlaps, render_s


def _render_home(folder: Path, width: int, home: int) -> list[tuple[tuple[str, str], float]]:
    """Pictures of a home, tilted and with any heading."""
    name = f"home{home:03d}"
    tour = render_tour(folder / name, home, is_level=False, width=width)
    return [((f"{name}/{a}", f"{name}/{b}"), share) for (a, b), share in tour.overlaps.items()]


def _cache(out: Path) -> FeatureCache:
    return FeatureCache(
        out / "features", ExtractionOptions(2048, 10000, 0.0), FileDigests(out / "digests.json")
    )


def _find_features(images: ImageSet, options: argparse.Namespace) -> list[str]:
    """Keys of the key points of all images, which are found where they are missing."""
    (options.out / "features").mkdir(exist_ok=True)
    places = range(len(images.images))
    with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(partial(_find, options.out, images), places, chunksize=16))


def _find(out: Path, images: ImageSet, place: int) -> str:
    cache, image = _cache(out), images.images[place]
    key = cache.key(image, images.cameras[image.camera])
    if not cache.has(key):
        cache.extract(key, image, images.cameras[image.camera])
    return key


def _chosen(
    cache: FeatureCache,
    keys: Sequence[str],
    overlaps: dict[Pair, float],
    count: int,
    jobs: int,
) -> Chosen:
    def descriptors(index: int) -> np.ndarray:
        keypoints = cache.load(keys[index])
        assert keypoints is not None
        few: Features = keypoints.chosen(
            np.arange(len(keypoints.pixels)) < 2 * NUM_DESCRIPTORS
        ).features()
        return few.descriptors

    wall_s, cpu_s = time.perf_counter(), time.process_time()
    pairs = set(alike_pairs(descriptors, len(keys), count, num_threads=jobs))
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    recall = []
    for least in OVERLAPS:
        wanted = {pair for pair, overlap in overlaps.items() if overlap >= least}
        recall.append(len(wanted & pairs) / len(wanted))
    share = len(pairs) / (len(keys) * (len(keys) - 1) / 2)
    return Chosen(count, len(pairs), share, tuple(recall), wall_s, cpu_s)


def _cells(row: Chosen) -> list[str]:
    return [
        str(row.neighbors),
        str(row.num_pairs),
        f"{100 * row.share:.2f} %",
        *(f"{100 * each:.1f} %" for each in row.recall),
        f"{row.wall_s:.1f}",
        f"{row.cpu_s:.1f}",
    ]


def _verified(
    images: ImageSet, overlaps: dict[Pair, float], options: argparse.Namespace
) -> dict[str, float]:
    """Match the pairs of retrieval; what is accepted, and how much of it is right."""
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    chosen = MatchOptions(pairs="retrieval", num_threads=options.jobs)
    run = match_images(images, options.out / "matches", chosen)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    accepted = [each for each in run.verdicts if each.accepted]
    error_deg = _errors_of_pairs(images, options.width)
    num_right = sum(error_deg(each) < RIGHT_DEG for each in accepted)
    index = {name: place for place, name in enumerate(run.images)}
    shares = [overlaps.get((index[e.image1], index[e.image2]), 0.0) for e in accepted]
    num_shared = int(np.sum(np.array(shares) >= OVERLAPS[0]))
    print(
        f"{len(run.verdicts)} pairs matched in {wall_s:.0f} s ({cpu_s:.0f} s of processor time; "
        f"{run.num_found} were there): {len(accepted)} accepted, {num_right} of them within "
        f"{RIGHT_DEG:g} degrees; {num_shared} share {OVERLAPS[0]:g} of their views"
    )
    counts = {"pairs": len(run.verdicts), "found": run.num_found, "accepted": len(accepted)}
    return counts | {"wall_s": wall_s, "cpu_s": cpu_s, "right": num_right, "shared": num_shared}


def _errors_of_pairs(images: ImageSet, width: int) -> Callable[[PairVerdict], float]:
    """What gives the larger error of a pair's rotation and direction; infinite between homes."""
    tours = {}
    for home in {image.name.partition("/")[0] for image in images.images}:
        tours[home] = render_tour(images.folder / home, int(home[4:]), is_level=False, width=width)

    def error_deg(pair: PairVerdict) -> float:
        (home1, _, name1), (home2, _, name2) = (
            name.partition("/") for name in (pair.image1, pair.image2)
        )
        if home1 != home2:
            return float("inf")
        truth, found = tours[home1].cam2_from_cam1(name1, name2), pair.cam2_from_cam1
        return max(rotation_error_deg(found, truth), translation_error_deg(found, truth))

    return error_deg


def _load(options: argparse.Namespace) -> dict[str, float]:
    """Memory and time of `load_matches` on a folder with so many pairs, in its own process."""
    folder = options.out / f"folder{options.pairs}"
    write_large_folder(folder, options.pairs)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context) as pool:
        before_mb, peak_mb, seconds = pool.submit(load_peak_mb, folder).result()
    print(
        f"load_matches of {options.pairs} pairs: {seconds:.0f} s, peak memory {peak_mb:.0f} MB, "
        f"{before_mb:.0f} MB before"
    )
    return {"pairs": options.pairs, "seconds": seconds, "peak_mb": peak_mb, "before_mb": before_mb}


if __name__ == "__main__":
    sys.exit(main())
