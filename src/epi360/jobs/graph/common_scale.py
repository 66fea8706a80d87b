# SPDX-License-Identifier: BSD-3-Clause
"""How long the translations of pairs are, in one unit for all of them.

Two views fix no scale, but two pairs of one panorama do: what both know of its surroundings, points
or surfaces, lies as far away in the units of one as in those of the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.linalg import lsqr

from epi360.jobs.graph.surface_evidence import KnownView, log_scale_to
from epi360.places.shared_points import (
    MOST_WITNESSES,
    PosedPair,
    cloud_of,
    scale_between,
)

Array = NDArray[np.float64]

_LEAST_PARALLAX_DEG = 1.0  # of points that tell a scale
# Of 95 scales that two pairs share on a real tour, a tenth is wrong by more than 6 (points) or 8 %.
_LEAST_SIGMA = 0.05
_CELLS_OF_POINTS, _CELLS_OF_FEW = 100, 40  # points that tell one well, or less so, are worth these
# A length is sure if pairs with sure ones agree with it by a factor of 1.2, by so many cells in
# all; one of them alone must share as many as _ALONE.
_AGREES, _ENOUGH, _ALONE = 0.18, 50, 100
_STEPS = 20


@dataclass(frozen=True, eq=False)
class CommonScale:
    """Logarithms (N,) of the lengths of the pairs' translations; which of them are sure (N,)."""

    log_lengths: Array
    is_sure: NDArray[np.bool_]


class _Told(NamedTuple):
    """How much longer the second pair's translation is, as a logarithm; how many cells say so."""

    pairs: tuple[int, int]
    log_ratio: float
    sigma: float
    num_cells: int


def common_scale(
    pairs: Sequence[PosedPair], views: Mapping[tuple[int, int], KnownView]
) -> CommonScale:
    """Lengths that agree with most of what pairs with a shared image know of its surroundings.

    ``views`` are the surfaces that are known by pair and side, where they are. Sure lengths are
    those of the largest set that holds together.
    """
    told = list(_all_told(pairs, views))
    if not told:
        return CommonScale(np.zeros(len(pairs)), np.zeros(len(pairs), bool))
    logs = _solved(len(pairs), told)
    return CommonScale(logs, _sure(len(pairs), told, logs))


def _all_told(
    pairs: Sequence[PosedPair], views: Mapping[tuple[int, int], KnownView]
) -> Iterator[_Told]:
    """What pairs of each image know of each other's units; those with most points are asked."""
    at: dict[int, list[tuple[int, int]]] = {}
    for row in sorted(range(len(pairs)), key=lambda row: -len(pairs[row].keypoints[0])):
        for side in (0, 1):
            at.setdefault(pairs[row].images[side], []).append((row, side))
    for ends in at.values():
        clouds = {end: cloud_of(pairs[end[0]], end[1], _LEAST_PARALLAX_DEG) for end in ends}
        for number, one in enumerate(ends):
            own = views[one].as_map() if one in views else None
            for other in ends[number + 1 : number + 1 + MOST_WITNESSES]:
                rows = one[0], other[0]
                if own is not None and other in views:
                    surfaces = log_scale_to(own, views[other])
                    if surfaces is not None:
                        yield _Told(rows, *surfaces)
                scale = scale_between(clouds[one], clouds[other])
                if scale is not None:
                    worth = _CELLS_OF_POINTS if scale[1] < _LEAST_SIGMA else _CELLS_OF_FEW
                    yield _Told(rows, float(np.log(scale[0])), scale[1], worth)


def _solved(count: int, told: Sequence[_Told]) -> Array:
    """Logarithms of lengths by least squares, in which what contradicts most others counts less."""
    sigmas = np.hypot([each.sigma for each in told], _LEAST_SIGMA)
    ratios = np.array([each.log_ratio for each in told])
    rows = np.repeat(np.arange(len(told)), 2)
    columns = np.array([each.pairs for each in told]).ravel()
    signs = np.tile([-1.0, 1.0], len(told))
    weights = np.ones(len(told))
    logs = np.zeros(count)
    for step in range(_STEPS):
        scaled = np.sqrt(weights) / sigmas
        system = csr_array((signs * np.repeat(scaled, 2), (rows, columns)), (len(told), count))
        logs = lsqr(system, scaled * ratios, atol=1e-10, btol=1e-10)[0]
        misses = np.abs(_misses(told, logs)) / sigmas
        # The sum of the misses first, which has one minimum; then Cauchy's loss.
        weights = 1 / np.maximum(misses, 1.0) if step < _STEPS // 2 else 1 / (1 + (misses / 2) ** 2)
    return np.asarray(logs)


def _misses(told: Sequence[_Told], logs: Array) -> Array:
    first, second = np.array([each.pairs for each in told]).T
    return np.asarray(logs[second] - logs[first] - [each.log_ratio for each in told])


def _sure(count: int, told: Sequence[_Told], logs: Array) -> NDArray[np.bool_]:
    """Which lengths hold together, step by step from the two that share most."""
    misses = np.abs(_misses(told, logs))
    agreeing = [each for each, miss in zip(told, misses, strict=True) if miss < _AGREES]
    around: list[dict[int, int]] = [{} for _ in range(count)]  # cells that pairs share with others
    for each in agreeing:
        for one, other in (each.pairs, each.pairs[::-1]):
            around[one][other] = max(around[one].get(other, 0), each.num_cells)
    best = np.zeros(count, dtype=bool)
    left = {row for row in range(count) if around[row]}
    while len(left) > np.count_nonzero(best):
        start = max(left, key=lambda row: (max(around[row].values()), -row))
        found = _grown(start, around)
        left -= found
        if len(found) > np.count_nonzero(best):
            best = np.isin(np.arange(count), list(found))
    return best


def _grown(start: int, around: Sequence[Mapping[int, int]]) -> set[int]:
    """Pairs whose lengths those before them make sure, beginning with one."""
    inside, waiting = {start}, set(around[start])
    while True:
        new = {row for row in waiting - inside if _is_told(around[row], inside)}
        if not new:
            return inside
        inside |= new
        waiting |= {other for row in new for other in around[row]}


def _is_told(shared: Mapping[int, int], inside: set[int]) -> bool:
    cells = [count for other, count in shared.items() if other in inside]
    return sum(cells) >= (_ENOUGH if len(cells) > 1 else _ALONE)
