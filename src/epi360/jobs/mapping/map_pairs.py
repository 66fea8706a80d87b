# SPDX-License-Identifier: BSD-3-Clause
"""Which of the matched pairs go into a map."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from epi360.interop.match_graph import MatchGraph
from epi360.jobs.matching.match_folder import MatchRun
from epi360.jobs.records.stored_graph import OnDemand


def without_doubtful(graph: MatchGraph, matched: MatchRun) -> MatchGraph:
    """Leave out pairs that others contradict, and ambiguous ones that join two groups of images."""
    # One triangle is not enough: even if a pose is 10 degrees off, most of its inliers can be
    # right matches, and where pairs are few, a map falls apart without them.
    dropped = {
        (pair.image1, pair.image2)
        for pair in matched.verdicts
        if (pair.contradicted and pair.num_contradicted > 1) or pair.refused
    }
    rows, status, names = [], [], []
    for row, pair in enumerate(graph.pairs):
        if (pair.image1, pair.image2) not in dropped:
            rows.append(row)
            status.append(None if pair.geometry is None else pair.geometry.status)
            names.append((pair.image1, pair.image2))
    kept = _without_ambiguous_bridges(names, status, graph.images)
    pairs = OnDemand(graph.pairs.__getitem__, [rows[index] for index in kept])
    return replace(graph, pairs=pairs)


def _without_ambiguous_bridges(
    names: Sequence[tuple[str, str]], status: Sequence[str | None], images: Iterable[str]
) -> list[int]:
    """Rows without planar_ambiguous pairs between groups that other pairs do not join.

    The same carpet or poster hangs or lies in two rooms: its matches are all on one plane.
    """
    number = {name: index for index, name in enumerate(images)}
    ends = np.array([[number[name] for name in pair] for pair in names], dtype=int).reshape(-1, 2)
    sure = ends[[each in ("ok", "pure_rotation") for each in status]]
    links = coo_array((np.ones(len(sure)), (sure[:, 0], sure[:, 1])), shape=(len(number),) * 2)
    group = connected_components(links, directed=False)[1]
    alone = np.bincount(group)[group] == 1
    # Which groups the ambiguous pairs of an image without other pairs lead to.
    reached: dict[int, set[int]] = {}
    ambiguous = [each == "planar_ambiguous" for each in status]
    for first, second in ends[ambiguous]:
        for image, other in ((first, second), (second, first)):
            reached.setdefault(int(image), set()).add(int(group[other]))

    def joins(first: int, second: int) -> bool:
        apart = group[first] != group[second]
        settled = any(alone[each] and len(reached[each]) == 1 for each in (first, second))
        return bool(apart and not settled)

    return [
        row
        for row, (is_ambiguous, (first, second)) in enumerate(
            zip(ambiguous, ends.tolist(), strict=True)
        )
        if not (is_ambiguous and joins(first, second))
    ]
