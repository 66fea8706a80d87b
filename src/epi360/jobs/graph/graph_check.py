# SPDX-License-Identifier: BSD-3-Clause
"""What the accepted pairs of a folder say about each other: triangles, lone links, floors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from epi360.jobs.graph.loop_check import LoopVerdict, check_loops
from epi360.jobs.records.match_store import Verdict
from epi360.places.shared_points import FLOOR_SHARE

# A pose that nothing else confirms is accepted if it is right with this probability.
_LINK_PROBABILITY = 0.95
# Printed floors repeat from room to room; of the other pairs that are as probable, few are wrong.
_FLOOR_PROBABILITY = 0.999
# Sigmas of a pose that rests on too few places to state its own: triangles close to 3 degrees in
# rotation and 7 in direction.
DOUBTED_ROTATION_DEG, DOUBTED_DIRECTION_DEG = 0.5, 1.5
# A pose under this is not even confirmed by others; under _LINK_PROBABILITY two triangles must
# close with it.
_DOUBTED_PROBABILITY = 0.6
_MOST_NAMED = 4

OPEN_TRIANGLES = "most triangles with other pairs do not close: this pair or one of those is wrong"
FLOOR_ONLY = "all inliers lie on the floor, and printed floors repeat from room to room"
CONFIRMED = "the inliers alone leave a doubt; the pose is accepted because triangles close with it"
LONE_LINK, LONE_FLOOR = "joins two groups alone", "lies on the floor only"

SomeVerdict = TypeVar("SomeVerdict", bound=Verdict)


@dataclass(frozen=True)
class GraphVerdict(LoopVerdict):
    """What the other pairs say about one.

    ``refused`` is why it is not accepted for all that. If it is ``confirmed``, its doubted pose is
    accepted for all that.
    """

    refused: str = ""
    confirmed: bool = False

    def doubts(self, verdict: Verdict) -> list[str]:
        """Sentences for a person."""
        doubts = []
        if self.doubtful:
            doubts.append(OPEN_TRIANGLES)
        doubts += does_not_fit(self.contradicted_by)
        if self.refused.startswith(LONE_FLOOR):
            doubts.append(FLOOR_ONLY)
        if self.confirmed:
            doubts.append(CONFIRMED)
        return doubts


def does_not_fit(others: Sequence[tuple[str, str]]) -> list[str]:
    """A sentence that names the pairs that speak against one, if there are any."""
    if not others:
        return []
    named = [" - ".join(pair) for pair in others[:_MOST_NAMED]]
    more = len(others) - len(named)
    rest = f" and {more} more" if more else ""
    return [f"does not fit {', '.join(named)}{rest}"]


def check_graph(
    pairs: Sequence[tuple[str, str]],
    verdicts: Sequence[Verdict],
    *,
    is_level: bool,
    seen: Set[int] = frozenset(),
) -> tuple[GraphVerdict, ...]:
    """Look for accepted pairs that the other accepted pairs contradict, or fail to support.

    After `check_loops`, two kinds of pairs must be more probable than others: in a level folder a
    pair whose inliers all lie on the floor, unless a triangle with it closes; and a pair without
    which the graph of accepted pairs would fall apart, unless its row is among those ``seen``:
    their surroundings were looked at. A probability that is not known refuses nothing. In a level
    folder, a refused pose that is probable is accepted if triangles with it close and none is open.
    """
    loops = check_loops(pairs, verdicts)
    refused = [""] * len(pairs)
    accepted = [
        row
        for row, (verdict, loop) in enumerate(zip(verdicts, loops, strict=True))
        if verdict.accepted and not loop.contradicted
    ]
    for row in accepted:
        if is_level and _lies_on_floor(verdicts[row]) and not _is_confirmed(loops[row]):
            refused[row] = _refusal(LONE_FLOOR, verdicts[row], _FLOOR_PROBABILITY)
    accepted = [row for row in accepted if not refused[row]]
    for link in links([pairs[row] for row in accepted]):
        row = accepted[link]
        if row not in seen:
            refused[row] = _refusal(LONE_LINK, verdicts[row], _LINK_PROBABILITY)
    accepted = [row for row in accepted if not refused[row]]
    confirmed = _confirmed(pairs, verdicts, accepted) if is_level else {}
    return tuple(
        GraphVerdict(**vars(confirmed.get(row, loop)), refused=why, confirmed=row in confirmed)
        for row, (loop, why) in enumerate(zip(loops, refused, strict=True))
    )


def awaits_confirmation(verdict: Verdict) -> bool:
    """Whether a pose that is not believed is so probable that other pairs may confirm it."""
    is_known = bool(np.isfinite(verdict.doubted.translation).all())
    return is_known and verdict.status != "ok" and verdict.probability >= _DOUBTED_PROBABILITY


def believed(verdict: SomeVerdict) -> SomeVerdict:
    """The verdict if its doubted pose were accepted."""
    return _with_assumed_errors(replace(verdict, status="ok", cam2_from_cam1=verdict.doubted))


def with_sigmas(verdict: SomeVerdict) -> SomeVerdict:
    """The verdict, with the errors that are assumed of doubted poses if it states none."""
    if np.isfinite([verdict.rotation_sigma_deg, verdict.translation_sigma_deg]).all():
        return verdict
    return _with_assumed_errors(verdict)


def _with_assumed_errors(verdict: SomeVerdict) -> SomeVerdict:
    return replace(
        verdict,
        rotation_sigma_deg=DOUBTED_ROTATION_DEG,
        translation_sigma_deg=DOUBTED_DIRECTION_DEG,
    )


def _confirmed(
    pairs: Sequence[tuple[str, str]], verdicts: Sequence[Verdict], accepted: Sequence[int]
) -> dict[int, LoopVerdict]:
    """Rows of the pairs whose doubted poses close triangles of accepted pairs."""
    triangles = _Triangles(pairs, verdicts, accepted)
    found = {}
    for row, verdict in enumerate(verdicts):
        if not awaits_confirmation(verdict):
            continue
        loop = triangles.of(pairs[row], believed(verdict))
        needed = 1 if verdict.probability >= _LINK_PROBABILITY else 2
        if loop.num_triangles >= needed and not loop.num_contradicted:
            found[row] = loop
    return found


def closing(
    pairs: Sequence[tuple[str, str]],
    verdicts: Sequence[Verdict],
    accepted: Sequence[int],
    tried: Mapping[int, Verdict],
) -> dict[int, LoopVerdict]:
    """Rows of the pairs of which a triangle with accepted pairs closes, and none is open.

    ``tried`` are their verdicts, by row.
    """
    triangles = _Triangles(pairs, verdicts, accepted)
    loops = {row: triangles.of(pairs[row], verdict) for row, verdict in tried.items()}
    return {
        row: loop for row, loop in loops.items() if loop.num_triangles and not loop.num_contradicted
    }


def fitting(
    pairs: Sequence[tuple[str, str]],
    verdicts: Sequence[Verdict],
    accepted: Sequence[int],
    tried: Mapping[int, Verdict],
    *,
    is_level: bool,
) -> dict[int, LoopVerdict]:
    """Rows of the pairs of which no triangle with accepted pairs is open, tried one after another.

    ``tried`` are their verdicts, by row. What fits counts as accepted for those after it. If no
    triangle closes either, a pose must be as probable as that of a lone link, and in a level folder
    one on the floor alone as others of its kind.
    """
    triangles = _Triangles(pairs, verdicts, accepted)
    found = {}
    for row, verdict in tried.items():
        loop = triangles.of(pairs[row], verdict)
        on_floor = is_level and _lies_on_floor(verdict)
        needed = _FLOOR_PROBABILITY if on_floor else _LINK_PROBABILITY
        is_probable = loop.num_triangles > 0 or verdict.probability >= needed
        if is_probable and not loop.num_contradicted:
            found[row] = loop
            triangles.add(row, verdict)
    return found


class _Triangles:
    """Triangles that further pairs make with accepted ones.

    Poses that state no errors have those of doubted ones.
    """

    def __init__(
        self,
        pairs: Sequence[tuple[str, str]],
        verdicts: Sequence[Verdict],
        accepted: Sequence[int],
    ) -> None:
        self.pairs = pairs
        self.verdicts: dict[int, Verdict] = {}
        self.rows_of: dict[str, dict[str, int]] = {}
        for row in accepted:
            self.add(row, verdicts[row])

    def add(self, row: int, verdict: Verdict) -> None:
        """From now on this pair is an accepted one, too."""
        self.verdicts[row] = with_sigmas(verdict)
        for name, other in (self.pairs[row], self.pairs[row][::-1]):
            self.rows_of.setdefault(name, {})[other] = row

    def of(self, pair: tuple[str, str], verdict: Verdict) -> LoopVerdict:
        """What the triangles of one pair and two accepted ones say about it."""
        rows1, rows2 = (self.rows_of.get(name, {}) for name in pair)
        shared = sorted(rows1.keys() & rows2.keys())
        others = [rows[name] for name in shared for rows in (rows1, rows2)]
        return check_loops(
            [pair, *(self.pairs[each] for each in others)],
            [with_sigmas(verdict), *(self.verdicts[each] for each in others)],
        )[0]


class _Groups:
    """Nodes that edges connect, while edges are added."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}

    def join(self, end1: str, end2: str) -> bool:
        """Add an edge; whether it connects what no other one did."""
        root1, root2 = self._root(end1), self._root(end2)
        self._parent[root1] = root2
        return root1 != root2

    def by_node(self) -> dict[str, str]:
        """Name of the group of each node: one of its nodes."""
        return {node: self._root(node) for node in self._parent}

    def _root(self, node: str) -> str:
        parent = self._parent
        parent.setdefault(node, node)
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node


def groups_by(edges: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Name of the group of each node that has an edge: one of the nodes that edges connect."""
    groups = _Groups()
    for end1, end2 in edges:
        groups.join(end1, end2)
    return groups.by_node()


def joining(edges: Iterable[tuple[str, str]]) -> list[int]:
    """Rows of the edges that connect what those before them do not: none closes a loop."""
    groups = _Groups()
    return [row for row, (end1, end2) in enumerate(edges) if groups.join(end1, end2)]


def links(edges: Sequence[tuple[str, str]]) -> list[int]:
    """Rows of the edges that are in no cycle: without one of them its ends are not connected.

    Of a tree that reaches all nodes, every other edge closes a cycle with the path between its
    ends; what is left of the tree when the nodes of these cycles are merged are the links.
    """
    tree = _Tree(edges)
    merged = {node: node for node in tree.depth}

    def group(node: str) -> str:
        while merged[node] != node:
            merged[node] = merged[merged[node]]
            node = merged[node]
        return node

    for row in sorted(set(range(len(edges))) - {row for _, row in tree.above.values()}):
        end1, end2 = map(group, edges[row])
        while end1 != end2:
            if tree.depth[end1] < tree.depth[end2]:
                end1, end2 = end2, end1
            merged[end1] = tree.above[end1][0]
            end1 = group(end1)
    return sorted(row for node, (_, row) in tree.above.items() if merged[node] == node)


class _Tree:
    """A tree over each part of a graph: depth of every node, and node and edge above it."""

    def __init__(self, edges: Sequence[tuple[str, str]]) -> None:
        neighbours: dict[str, list[tuple[str, int]]] = {}
        for row, (end1, end2) in enumerate(edges):
            neighbours.setdefault(end1, []).append((end2, row))
            neighbours.setdefault(end2, []).append((end1, row))
        self.depth: dict[str, int] = {}
        self.above: dict[str, tuple[str, int]] = {}
        for root in neighbours:
            waiting = [] if root in self.depth else [root]
            self.depth.setdefault(root, 0)
            while waiting:
                node = waiting.pop()
                for other, row in neighbours[node]:
                    if other not in self.depth:
                        self.depth[other] = self.depth[node] + 1
                        self.above[other] = node, row
                        waiting.append(other)


def _lies_on_floor(verdict: Verdict) -> bool:
    return verdict.floor_share > FLOOR_SHARE


def _is_confirmed(loop: LoopVerdict) -> bool:
    """Whether a triangle closes."""
    return loop.num_triangles > loop.num_contradicted


def _refusal(why: str, verdict: Verdict, needed: float) -> str:
    """Why a pair is not accepted; empty if it is probable enough."""
    if not verdict.probability < needed:
        return ""
    by_itself = _rounded_down(verdict.probability)
    return f"{why}, with a probability of only {by_itself} by its own matches"


def _rounded_down(probability: float) -> str:
    """Three decimals at most, never more than the value."""
    return f"{int(probability * 1000) / 1000:g}"
