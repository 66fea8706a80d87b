# SPDX-License-Identifier: BSD-3-Clause
"""Which of the matched pairs go into a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph
from epi360.jobs.matching import MatchRun


def without_doubtful(graph: MatchGraph, matched: MatchRun) -> MatchGraph:
    """Leave out pairs that others contradict, and ambiguous ones that join two groups of images."""
    # One triangle is not enough: even if a pose is 10 degrees off, most of its inliers can be
    # right matches, and where pairs are few, a map falls apart without them.
    dropped = {
        (pair.image1, pair.image2)
        for pair in matched.verdicts
        if (pair.contradicted and pair.num_contradicted > 1) or pair.refused
    }
    kept = tuple(pair for pair in graph.pairs if (pair.image1, pair.image2) not in dropped)
    return replace(graph, pairs=tuple(_without_ambiguous_bridges(kept, graph.images)))


def _without_ambiguous_bridges(
    pairs: Sequence[MatchedPair], images: Mapping[str, MatchedImage]
) -> list[MatchedPair]:
    """Drop planar_ambiguous pairs between groups that other pairs do not join.

    The same carpet or poster hangs or lies in two rooms: its matches are all on one plane.
    """
    status = [None if pair.geometry is None else pair.geometry.status for pair in pairs]
    number = {name: index for index, name in enumerate(images)}
    ends = np.array([(number[pair.image1], number[pair.image2]) for pair in pairs]).reshape(-1, 2)
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
        pair
        for pair, is_ambiguous, (first, second) in zip(pairs, ambiguous, ends.tolist(), strict=True)
        if not (is_ambiguous and joins(first, second))
    ]
