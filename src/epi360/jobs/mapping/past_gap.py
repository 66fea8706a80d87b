# SPDX-License-Identifier: BSD-3-Clause
"""Whether the images before and after missing frames may be joined to one map.

Where a place repeats itself, pairs across the gap may have right directions and wrong matches: of
doors that look alike, on the same epipolar curves. Their points put one part of a corridor upon
another.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from epi360.features.warped_patches import Panorama
from epi360.image_folders import natural_order
from epi360.interop.match_graph import MatchedPair, MatchGraph
from epi360.jobs.mapping.composed_poses import Names, PanoramaOf, num_inliers, posed_pairs
from epi360.jobs.matching.pair_verdicts import PairVerdict
from epi360.jobs.records.stored_graph import OnDemand
from epi360.jobs.threads import num_cores, on_threads
from epi360.places.corridor import repeats_itself
from epi360.places.own_evidence import grow_both
from epi360.places.shared_points import PosedPair

Parts = tuple[int, int]

_MOST_ASKED = 12  # pairs across the gap, those with most inliers
_MANY = 0.5  # of these


def cut_where_the_place_repeats(
    graph: MatchGraph,
    verdicts: Sequence[PairVerdict],
    gaps: Sequence[str],
    panorama_of: PanoramaOf,
) -> MatchGraph | None:
    """Return the graph without the pairs across gaps that show a place which repeats itself.

    ``gaps`` name the images before which frames are missing: they part the sequence. Where half of
    the strongest accepted pairs of two parts show such a place, these are not joined. None if there
    are no such parts.
    """
    starts = sorted(map(_order, gaps))
    part_of = {name: bisect_right(starts, _order(name)) for name in graph.images}
    told = {(each.image1, each.image2): each for each in verdicts if each.accepted}
    across: dict[Parts, list[MatchedPair]] = defaultdict(list)
    parts = []
    for pair in graph.pairs:
        first, second = sorted(part_of[name] for name in (pair.image1, pair.image2))
        parts.append((first, second))
        if first != second and (pair.image1, pair.image2) in told:
            across[first, second].append(pair)
    cut = {
        each
        for each, pairs in across.items()
        if _show_that_it_repeats(graph, told, pairs, panorama_of)
    }
    if not cut:
        return None
    kept = [row for row, each in enumerate(parts) if each not in cut]
    return replace(graph, pairs=OnDemand(graph.pairs.__getitem__, kept))


def _show_that_it_repeats(
    graph: MatchGraph,
    told: Mapping[Names, PairVerdict],
    pairs: Sequence[MatchedPair],
    panorama_of: PanoramaOf,
) -> bool:
    """Whether half of those pairs with most inliers show a place that repeats itself."""
    pairs = sorted(pairs, key=num_inliers, reverse=True)[:_MOST_ASKED]
    names = [(pair.image1, pair.image2) for pair in pairs]
    posed = posed_pairs(graph, pairs, [told[each] for each in names])

    def repeats(row: int) -> bool:
        return _repeats(posed[row], [panorama_of(name) for name in names[row]])

    num_repeating = sum(is_so for _, is_so in on_threads(repeats, range(len(posed)), num_cores()))
    return num_repeating >= _MANY * len(pairs)


def _order(name: str) -> tuple[list[tuple[bool, int, str]], str]:
    return natural_order(Path(name))


def _repeats(pair: PosedPair, panoramas: Sequence[Panorama | None]) -> bool:
    """Whether a pair shows a corridor with equal doors; not if it is not one of panoramas."""
    known = [each for each in panoramas if each is not None]
    return len(known) == 2 and repeats_itself(grow_both(pair, known), known)
