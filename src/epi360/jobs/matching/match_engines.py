# SPDX-License-Identifier: BSD-3-Clause
"""Where the work of `match_images` is done: on this machine, or by others that write the files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Protocol

from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.pair_work import PairWork
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict
from epi360.jobs.threads import on_threads

Found = Iterable[tuple[Keys, Verdict]]


class MatchEngine(Protocol):
    """Does work that is missing and notes in the `PairWork` which images cannot be read."""

    def find_features(self, indices: Sequence[int]) -> Iterator[object]:
        """Find the key points of images; yields something after each."""

    def verify(self, parts: Sequence[Sequence[Pair]]) -> Iterator[tuple[int, Found]]:
        """Verify parts of the pairs; yields how many pairs were tried, and what came out."""

    def verify_again(
        self, parts: Mapping[str, Mapping[Keys, Pair]], level: Level
    ) -> Iterator[Found]:
        """Verify pairs of parts, by the name of the part, with the prior of a level folder."""


class LocalEngine:
    """The threads of this machine."""

    def __init__(self, work: PairWork) -> None:
        self._work = work

    def find_features(self, indices: Sequence[int]) -> Iterator[object]:
        """Find the key points of images on all threads."""
        return on_threads(self._work.find_features, indices, self._work.num_threads)

    def verify(self, parts: Sequence[Sequence[Pair]]) -> Iterator[tuple[int, Found]]:
        """Verify so many parts at once that no thread waits for long: half a part for each."""
        at_once = -(-self._work.num_threads // 2)
        for start in range(0, len(parts), at_once):
            chosen = parts[start : start + at_once]
            yield sum(map(len, chosen)), self._work.verify_parts(chosen).verdicts

    def verify_again(
        self, parts: Mapping[str, Mapping[Keys, Pair]], level: Level
    ) -> Iterator[Found]:
        """Verify the pairs of one part after the other."""
        for name, wanted in parts.items():
            yield self._work.verify_part_again(name, wanted, level).verdicts
