# SPDX-License-Identifier: BSD-3-Clause
"""What some of the matches of a pair say, found once and kept in the output folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.verified_matches import Matched
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import (
    SOME_MATCHES,
    Keys,
    Verdict,
    VerifiedPair,
    read_parts,
    write_part,
)
from epi360.runs.made_from import fingerprint
from epi360.runs.remote_path import AnyPath

Asked = Sequence[tuple[Pair, Matched]]
Told = dict[Pair, VerifiedPair]


class _Estimate(NamedTuple):
    """A pair without the matches, which are known where it is asked for."""

    verdict: Verdict
    inlier_mask: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class KeptEstimates:
    """Estimates from some matches of pairs, known by the keys of both images and these matches.

    ``keys_of`` gives the keys of a pair. There is a sub-folder for each way to choose matches.
    """

    output: AnyPath
    keys_of: Callable[[Pair], Keys]
    _known: dict[str, dict[tuple[Keys, str], _Estimate]] = field(default_factory=dict)

    def estimated(
        self, asked: Asked, prior: str, level: Level | None, estimate: Callable[[Asked], Told]
    ) -> Told:
        """What matches of pairs say, by ``estimate`` where that is not known, in their order.

        ``prior`` says in words how they were chosen; ``level`` is known of all poses beforehand.
        """
        store = SOME_MATCHES + fingerprint((prior, level))
        known = self._known_in(store)
        name_of = {pair: self._name(pair, matched) for pair, matched in asked}
        missing = [each for each in asked if name_of[each[0]] not in known]
        if missing:
            found = estimate(missing)
            write_part(self.output, list(found.values()), store)
            for pair, each in found.items():
                known[name_of[pair]] = _Estimate(each.verdict, each.inlier_mask)
        return {
            pair: VerifiedPair(name_of[pair][0], told.verdict, matched.matches, told.inlier_mask)
            for pair, matched in asked
            for told in (known[name_of[pair]],)
        }

    def _known_in(self, store: str) -> dict[tuple[Keys, str], _Estimate]:
        if store not in self._known:
            self._known[store] = {
                (each.keys, fingerprint(each.matches)): _Estimate(each.verdict, each.inlier_mask)
                for each in read_parts(self.output, store)
            }
        return self._known[store]

    def _name(self, pair: Pair, matched: Matched) -> tuple[Keys, str]:
        return self.keys_of(pair), fingerprint(matched.matches)
