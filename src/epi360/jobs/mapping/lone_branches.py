# SPDX-License-Identifier: BSD-3-Clause
"""Images of a map that one pair alone joins to the others.

Nothing checks such a pair: two images tell the direction between them, and how far they are apart
only the points that both see and a third one knows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from epi360.jobs.graph.graph_check import groups_by, links


@dataclass(frozen=True)
class Branch:
    """A pair, and the names of the images that it alone joins to the rest of a map."""

    pair: tuple[str, str]
    images: tuple[str, ...]


def lone_branches(
    pairs: Iterable[tuple[str, str]], frame_of: Mapping[str, str | int]
) -> tuple[Branch, ...]:
    """Branches of a map beside its largest part without any, the largest branch first.

    ``pairs`` are the names of the images of those that were mapped, and ``frame_of`` has the
    moment of each image in the map: the images of a rig that share one hang together.
    """
    moment_of = {name: str(frame) for name, frame in frame_of.items()}
    named = [
        (first, second)
        for first, second in pairs
        if first in moment_of and second in moment_of and moment_of[first] != moment_of[second]
    ]
    edges = [(moment_of[first], moment_of[second]) for first, second in named]
    lone = set(links(edges))
    if not lone:
        return ()
    part_of = {moment: moment for edge in edges for moment in edge}
    part_of |= groups_by(edge for row, edge in enumerate(edges) if row not in lone)
    images: dict[str, list[str]] = {}
    for name, moment in moment_of.items():
        if moment in part_of:
            images.setdefault(part_of[moment], []).append(name)
    beside: dict[str, list[tuple[str, int]]] = {}
    for row in sorted(lone):
        first, second = (part_of[moment] for moment in edges[row])
        beside.setdefault(first, []).append((second, row))
        beside.setdefault(second, []).append((first, row))
    root = max(images, key=lambda part: len(images[part]))
    found = [
        Branch(named[row], tuple(sorted(_beyond(part, root, beside, images))))
        for part, row in beside.get(root, ())
    ]
    return tuple(sorted(found, key=lambda branch: -len(branch.images)))


def _beyond(
    part: str,
    root: str,
    beside: Mapping[str, list[tuple[str, int]]],
    images: Mapping[str, list[str]],
) -> list[str]:
    """Images of a part next to the root, and of all that hangs on it."""
    seen, waiting, names = {root, part}, [part], []
    while waiting:
        at = waiting.pop()
        names += images[at]
        for other, _ in beside[at]:
            if other not in seen:
                seen.add(other)
                waiting.append(other)
    return names
