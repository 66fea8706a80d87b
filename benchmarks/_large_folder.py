# SPDX-License-Identifier: BSD-3-Clause
"""A match folder of any size without pictures, and what loading it takes."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import numpy as np

from epi360.cameras import Equirectangular
from epi360.jobs.folder.image_set import ImageSet, SourceImage
from epi360.jobs.matching.match_result import load_matches, write_index
from epi360.jobs.records.match_store import (
    FEATURES,
    IMAGES,
    PAIRS,
    Verdict,
    VerifiedPair,
    write_part,
)
from epi360.poses import Pose
from epi360.runs.arrays import npz_bytes

PARTNERS, KEYPOINTS, MATCHES, INLIERS = 50, 4000, 500, 200
_PAIRS_PER_PART = 64
_CAMERA = Equirectangular(4096, 2048)


def write_large_folder(folder: Path, num_pairs: int) -> None:
    """Write what `epi360 match` leaves of random images, fifty partners each; once."""
    if (folder / IMAGES).is_file():
        return
    rng = np.random.default_rng(0)
    names = [f"room{number:06d}.jpg" for number in range(-(-num_pairs // PARTNERS) + PARTNERS)]
    keys = {name: f"{number:032x}" for number, name in enumerate(names)}
    for part in (FEATURES, PAIRS):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for key in keys.values():
        (folder / FEATURES / f"{key}.npz").write_bytes(npz_bytes(_keypoints(rng)))
    pairs = [
        (names[first], names[first + step])
        for first in range(len(names) - PARTNERS)
        for step in range(1, PARTNERS + 1)
    ][:num_pairs]
    for start in range(0, len(pairs), _PAIRS_PER_PART):
        chosen = pairs[start : start + _PAIRS_PER_PART]
        write_part(folder, [_pair(rng, keys[first], keys[second]) for first, second in chosen])
    images = tuple(SourceImage(name, Path(name), "panorama") for name in names)
    write_index(folder, ImageSet(folder, {"panorama": _CAMERA}, images), keys, pairs)


def _keypoints(rng: np.random.Generator) -> dict[str, np.ndarray]:
    pixels = rng.uniform(0.0, 2048.0, (KEYPOINTS, 2)).astype(np.float32)
    ones = np.ones(KEYPOINTS, np.float32)
    bytes_ = rng.integers(0, 255, (KEYPOINTS, 131), dtype=np.uint8)
    return {
        "pixels": pixels,
        "sizes": ones,
        "strengths": ones,
        "descriptors": bytes_[:, :128],
        "colors": bytes_[:, 128:],
    }


def _pair(rng: np.random.Generator, key1: str, key2: str) -> VerifiedPair:
    matches = rng.integers(0, KEYPOINTS, (MATCHES, 2))
    pose = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))
    verdict = Verdict(status="ok", num_matches=MATCHES, num_inliers=INLIERS, cam2_from_cam1=pose)
    return VerifiedPair((key1, key2), verdict, matches, np.arange(MATCHES) < INLIERS)


def load_peak_mb(folder: Path) -> tuple[float, float, float]:
    """Peak memory of this process before and after the matches are loaded, and the time."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    start = time.perf_counter()
    graph = load_matches(folder)
    seconds = time.perf_counter() - start
    assert sum(len(pair.matches) for pair in graph.pairs) == MATCHES * len(graph.pairs)
    return before, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, seconds
