# SPDX-License-Identifier: BSD-3-Clause
"""Relative poses for the pairs of a match graph that nobody has verified."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from epi360.estimation import RelativePoseResult, estimate_relative_poses
from epi360.interop.match_graph import MatchedPair, MatchGraph, TwoViewGeometry
from epi360.progress import Progress, no_progress
from epi360.two_view import IMAGE_OPTIONS, MAX_NOISE_PX, smallest_pixel_deg

_STAGE = "verifying pairs"
_PAIRS_AT_ONCE = 256  # whose bearings are in memory


def unverified_pairs(graph: MatchGraph) -> list[MatchedPair]:
    """Pairs with matches and without a geometry."""
    return [pair for pair in graph.pairs if pair.geometry is None and len(pair.matches)]


def verify_pairs(
    graph: MatchGraph,
    *,
    seed: int = 0,
    num_threads: int | None = None,
    progress: Progress = no_progress,
) -> MatchGraph:
    """Graph whose pairs all have a geometry; those that had one keep it.

    Raises
    ------
    ValueError
        If an image of such a pair has no camera.
    """
    wanted = unverified_pairs(graph)
    found: dict[tuple[str, str], TwoViewGeometry] = {}
    for start in range(0, len(wanted), _PAIRS_AT_ONCE):
        progress(_STAGE, start, len(wanted))
        some = wanted[start : start + _PAIRS_AT_ONCE]
        for pair, result in _estimated(graph, some, seed, num_threads):
            inliers = pair.matches[result.inlier_mask]
            geometry = TwoViewGeometry(result.status, result.cam2_from_cam1, inliers)
            found[pair.image1, pair.image2] = geometry
    progress(_STAGE, len(wanted), len(wanted))
    pairs = tuple(
        dataclasses.replace(pair, geometry=found.get((pair.image1, pair.image2), pair.geometry))
        for pair in graph.pairs
    )
    return dataclasses.replace(graph, pairs=pairs)


def _estimated(
    graph: MatchGraph, pairs: Sequence[MatchedPair], seed: int, num_threads: int | None
) -> Iterator[tuple[MatchedPair, RelativePoseResult]]:
    bearings, limits = [], []
    for pair in pairs:
        cameras = []
        sides = []
        for column, name in enumerate((pair.image1, pair.image2)):
            image = graph.images[name]
            if image.camera is None:
                raise ValueError(f"image {name} has no camera, so its pairs cannot be verified")
            camera = graph.cameras[image.camera]
            cameras.append(camera)
            pixels = image.keypoints[pair.matches[:, column]]
            sides.append(np.asarray(camera.bearings_from_pixels(pixels)))
        bearings.append((sides[0], sides[1]))
        limits.append(MAX_NOISE_PX * smallest_pixel_deg((cameras[0], cameras[1])))
    results = estimate_relative_poses(
        bearings, max_noise_deg=limits, options=IMAGE_OPTIONS, num_threads=num_threads, seed=seed
    )
    return zip(pairs, results, strict=True)
