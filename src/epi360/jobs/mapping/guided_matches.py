# SPDX-License-Identifier: BSD-3-Clause
"""More matches of the pairs of a map, along the epipolar curves of their poses.

Once its pose is known, a key point need not be told from all others of the other image, but only
from those near its epipolar curve. Where pairs have few inliers, the places of a map rest on few
points that three images see; with these there are more.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from epi360.epipolar.essential import cheirality_mask, essential_from_pose
from epi360.interop.match_graph import MatchedPair, MatchGraph, TwoViewGeometry
from epi360.jobs.records.stored_graph import OnDemand
from epi360.jobs.threads import on_threads
from epi360.poses import Pose
from epi360.progress import Progress, no_progress

Array = NDArray[np.float64]
Descriptors = NDArray[np.float32]
Indices = NDArray[np.int64]

MOST_PAIRS = 1000  # of a map: more have enough points, and would take long
_ENOUGH = 200  # inliers of a pair that needs no more
_NUM_SIGMAS = 3.0  # of the noise, from the epipolar curve
# A match is nearer than this share of the distance to the second nearest one near the curve, and
# nearer than nine inliers of ten. With looser ones more matches are wrong, whose points lie
# anywhere: on a real tour without the second rule panoramas were up to 0.2 m off, at 0.8 0.9 m.
_RATIO, _AS_ALIKE_AS = 0.7, 0.9
_ROWS_AT_ONCE = 128  # whose angles to all key points stay in the cache
_IMAGES_IN_MEMORY = 32  # with descriptors of 5 MB
_STAGE = "more matches"


class View(NamedTuple):
    """Where the key points of an image look (N, 3), and their unit descriptors (N, D)."""

    bearings: Array
    descriptors: Descriptors


@dataclass(frozen=True, eq=False)
class _Nearest:
    """Key points of view 1 with the nearest near their curves, the runner-up, if it is mutual."""

    first: Indices
    second: Indices
    distance: Descriptors
    runner_up: Descriptors  # infinity where there is none
    is_mutual: NDArray[np.bool_]


def with_guided(
    graph: MatchGraph,
    noise_deg: Mapping[tuple[str, str], float],
    descriptors: Callable[[str], Descriptors],
    num_threads: int,
    progress: Progress = no_progress,
) -> MatchGraph:
    """Return the graph with more inliers of its "ok" pairs that have fewer than 200.

    ``noise_deg`` is that of the pairs, by the names of both images; a pair without keeps what it
    has. With more than ``MOST_PAIRS`` of these pairs all do. ``progress`` is told of the stage
    "more matches".
    """
    lacking = (row for row, pair in enumerate(graph.pairs) if _lacks_inliers(pair, noise_deg))
    asked = list(islice(lacking, MOST_PAIRS + 1))
    if not 0 < len(asked) <= MOST_PAIRS:
        return graph
    view_of = lru_cache(_IMAGES_IN_MEMORY)(partial(_view, graph, descriptors))

    def more(row: int) -> MatchedPair:
        pair = graph.pairs[row]
        gate = _NUM_SIGMAS * np.radians(noise_deg[pair.image1, pair.image2])
        return _with_more(pair, (view_of(pair.image1), view_of(pair.image2)), gate)

    found: dict[int, MatchedPair] = {}
    progress(_STAGE, 0, len(asked))
    with threadpool_limits(1, user_api="blas"):
        for row, pair in on_threads(more, asked, num_threads):
            found[row] = pair
            progress(_STAGE, len(found), len(asked))

    def pair_of(row: int) -> MatchedPair:
        return found[row] if row in found else graph.pairs[row]

    # The others stay as small as they are stored.
    return dataclasses.replace(graph, pairs=OnDemand(pair_of, range(len(graph.pairs))))


def guided_matches(view1: View, view2: View, geometry: TwoViewGeometry, gate: float) -> Indices:
    """Further matches (M, 2) of key points that no inlier has, in front of both cameras.

    ``gate`` is the largest Sampson distance on the sphere, in radians. A match is mutual, passes
    the ratio test among the key points near its curve, and is as alike as most inliers are.
    """
    pose, inliers = geometry.cam2_from_cam1, geometry.inliers
    products = np.einsum(
        "nd,nd->n", view1.descriptors[inliers[:, 0]], view2.descriptors[inliers[:, 1]]
    )
    farthest = float(np.quantile(1.0 - products, _AS_ALIKE_AS))
    free1, free2 = (
        np.setdiff1d(np.flatnonzero(np.isfinite(view.bearings).all(axis=1)), inliers[:, side])
        for side, view in enumerate((view1, view2))
    )
    if len(free1) < 2 or len(free2) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    left = [
        View(view.bearings[rows], view.descriptors[rows])
        for view, rows in ((view1, free1), (view2, free2))
    ]
    nearest = _nearest(left[0], left[1], pose, gate)
    kept = nearest.is_mutual & (nearest.distance < farthest)
    kept &= nearest.distance < _RATIO**2 * nearest.runner_up
    first, second = nearest.first[kept], nearest.second[kept]
    ahead = cheirality_mask(left[0].bearings[first], left[1].bearings[second], pose)
    return np.stack([free1[first[ahead]], free2[second[ahead]]], axis=1)


def _lacks_inliers(pair: MatchedPair, noise_deg: Mapping[tuple[str, str], float]) -> bool:
    """Whether more are looked for: its pose is known, and how near the curve they must be."""
    geometry = pair.geometry
    if geometry is None or geometry.status != "ok":
        return False
    is_known = bool(np.isfinite(noise_deg.get((pair.image1, pair.image2), np.nan)))
    return is_known and 0 < len(geometry.inliers) < _ENOUGH


def _view(graph: MatchGraph, descriptors: Callable[[str], Descriptors], name: str) -> View:
    image = graph.images[name]
    assert image.camera is not None  # its pairs have been verified
    bearings = graph.cameras[image.camera].bearings_from_pixels(image.keypoints)
    return View(np.asarray(bearings), descriptors(name))


def _with_more(pair: MatchedPair, views: tuple[View, View], gate: float) -> MatchedPair:
    geometry = pair.geometry
    assert geometry is not None
    more = guided_matches(*views, geometry, gate)
    inliers = np.concatenate([geometry.inliers, more])
    told = dataclasses.replace(geometry, inliers=inliers)
    return dataclasses.replace(pair, matches=np.concatenate([pair.matches, more]), geometry=told)


def _nearest(view1: View, view2: View, pose: Pose, gate: float) -> _Nearest:
    E = essential_from_pose(pose)
    planes1, planes2 = view1.bearings @ E.T, view2.bearings @ E  # normals of epipolar planes
    # sines^2 < gate^2 (|planes1|^2 + |planes2|^2 - 2 sines^2), scaled so that little is left to do
    # for each pair of key points; single precision knows the sines to a ten thousandth of the gate.
    limits1, limits2 = (
        (gate**2 / (1.0 + 2.0 * gate**2) * np.sum(planes**2, axis=1)).astype(np.float32)
        for planes in (planes1, planes2)
    )
    normals, bearings = planes1.astype(np.float32), view2.bearings.T.astype(np.float32)
    firsts, seconds, distances = [], [], []
    for start in range(0, len(normals), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        squared = normals[rows] @ bearings
        squared *= squared
        squared -= limits2
        flat = np.flatnonzero(squared < limits1[rows, None])  # ten times as fast as two indices
        first, second = np.divmod(flat, len(limits2))
        first += start
        firsts.append(first)
        seconds.append(second)
        distances.append(
            1.0 - np.einsum("nd,nd->n", view1.descriptors[first], view2.descriptors[second])
        )
    first, second, distance = map(np.concatenate, (firsts, seconds, distances))
    return _of_each(first, second, distance)


def _of_each(first: Indices, second: Indices, distance: Descriptors) -> _Nearest:
    """What each of the ``first`` has among pairs of key points at a distance."""
    order = np.lexsort((second, distance, first))
    starts = np.flatnonzero(np.diff(first[order], prepend=-1))
    best = order[starts]
    after = np.append(starts[1:], len(order)) > starts + 1  # there is a runner-up
    runner_up = np.full(len(best), np.inf, dtype=np.float32)
    runner_up[after] = distance[order[starts[after] + 1]]
    back = np.lexsort((first, distance, second))
    is_best_of_other = np.zeros(len(order), dtype=bool)
    is_best_of_other[back[np.flatnonzero(np.diff(second[back], prepend=-1))]] = True
    return _Nearest(first[best], second[best], distance[best], runner_up, is_best_of_other[best])
