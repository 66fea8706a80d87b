# SPDX-License-Identifier: BSD-3-Clause
"""Pairs whose own pose is not accepted, and whose matches agree with what two others imply.

Through a door most matches may be of a copy of what is behind it, or all lie in the door. Where
other pairs say how both cameras stand, the matches that fit are enough.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.graph.graph_check import awaits_confirmation
from epi360.jobs.graph.implied_poses import ImpliedPoses, Way, near_matches
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.matching.place_job import MOST_PAIRS, posed_pair
from epi360.jobs.matching.verified_folder import VerifiedFolder
from epi360.jobs.matching.verified_matches import Matched
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict, VerifiedPair
from epi360.poses import Pose, rotation_error_deg, translation_error_deg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Of matches this near to its epipolar planes more may belong to the pose, if it is not exact. What
# they say must agree with it.
_NEAR_DEG, _AGREES_DEG = 3.0, 2.0
_FEWEST_MATCHES = 8
_PAIRS_AT_ONCE = 256  # whose matches are in memory
PRIOR = "implied"
IMPLIED = "two other pairs imply this pose, and its own matches agree"


@dataclass(frozen=True, eq=False)
class ImpliedPair:
    """A pair with its pose, and the keys of both pairs that imply it."""

    verified: VerifiedPair
    by: tuple[Keys, Keys]


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A pair with its matches, where they look, and the pose that others imply."""

    verified: VerifiedPair
    bearings: tuple[Array, Array]
    way: Way

    def agreeing(self) -> Mask:
        """Matches that agree with the implied pose."""
        return self.way.agreeing(*self.bearings)

    def near(self) -> Mask:
        """Matches that may belong to it even if it is a degree off."""
        return near_matches(self.way.cam2_from_cam1, *self.bearings, _NEAR_DEG)

    def matched(self, some: Mask) -> Matched:
        """Some of the matches."""
        first, second = self.bearings
        return Matched(self.verified.matches[some], first[some], second[some])


def find_implied(
    folder: VerifiedFolder,
    panoramas: Mapping[Keys, Pair],
    settled: Mapping[Keys, Verdict],
    level: Level | None,
    accepted: Set[Keys],
) -> dict[Keys, ImpliedPair]:
    """Pairs that are not accepted, and whose matches agree with the pose that two others imply.

    ``panoramas`` has two readable ones for each pair of keys, ``settled`` the verdicts that count;
    ``accepted`` are those whose own pose is accepted. A pair whose own pose is the implied one is
    left out: it has been refused for something else.
    """
    if not 2 <= len(accepted) <= MOST_PAIRS:
        return {}
    posed = {
        each.keys: posed_pair(folder, panoramas[each.keys], each)
        for each in folder.settled_pairs(accepted, settled, level)
    }
    sure = sorted(posed, key=lambda keys: panoramas[keys])
    known = ImpliedPoses([posed[keys] for keys in sure])
    others = {keys for keys in panoramas if keys not in accepted and keys[0] != keys[1]}
    candidates = _candidates(folder, panoramas, folder.settled_pairs(others, settled, level), known)
    found: dict[Keys, ImpliedPair] = {}
    while some := dict(islice(candidates, _PAIRS_AT_ONCE)):
        for which in (_Candidate.agreeing, _Candidate.near):
            left = {p: each for p, each in some.items() if each.verified.keys not in found}
            for pair, verified in _verified(folder, left, which).items():
                row1, row2 = left[pair].way.rows
                found[verified.keys] = ImpliedPair(verified, (sure[row1], sure[row2]))
    return found


def _candidates(
    folder: VerifiedFolder,
    panoramas: Mapping[Keys, Pair],
    others: Iterable[VerifiedPair],
    known: ImpliedPoses,
) -> Iterator[tuple[Pair, _Candidate]]:
    """Pairs with another pose than those that are implied, each with that of most matches."""
    for verified in others:
        pair = panoramas[verified.keys]
        ways = known.ways(*pair)
        if not ways or any(_agree(verified.verdict.cam2_from_cam1, way) for way in ways):
            continue
        rows1, rows2 = verified.matches.T
        bearings = folder.bearings_of(pair[0])[rows1], folder.bearings_of(pair[1])[rows2]
        way = max(ways, key=lambda each: each.num_agreeing(*bearings))
        yield pair, _Candidate(verified, bearings, way)


def _verified(
    folder: VerifiedFolder,
    candidates: Mapping[Pair, _Candidate],
    which: Callable[[_Candidate], Mask],
) -> dict[Pair, VerifiedPair]:
    """Pairs of which some matches, chosen by the implied pose, say that it is right."""
    chosen = {pair: which(each) for pair, each in candidates.items()}
    asked = {pair: some for pair, some in chosen.items() if some.sum() >= _FEWEST_MATCHES}
    matched = [(pair, candidates[pair].matched(some)) for pair, some in asked.items()]
    results = folder.estimated(matched, PRIOR) if matched else {}
    told = {pair: _if_agrees(results[pair], candidates[pair], asked[pair]) for pair in asked}
    return {pair: verified for pair, verified in told.items() if verified is not None}


def _if_agrees(result: VerifiedPair, candidate: _Candidate, chosen: Mask) -> VerifiedPair | None:
    """The pair with the pose of the chosen matches, if that is about the implied one.

    Through a door they may be few, or lie close together; then more of all matches must agree with
    the implied pose than chance explains.
    """
    verdict = result.verdict
    if verdict.accepted:
        pose = verdict.cam2_from_cam1
    elif awaits_confirmation(verdict) and not candidate.way.is_chance(*candidate.bearings):
        pose = verdict.doubted
    else:
        return None
    if not _agree(pose, candidate.way):
        return None
    verified, mask = candidate.verified, np.zeros(len(chosen), dtype=bool)
    mask[chosen] = result.inlier_mask
    told = replace(
        verdict,
        status="ok",
        num_matches=len(verified.matches),
        cam2_from_cam1=pose,
        warnings=(*verdict.warnings, IMPLIED),
    )
    return VerifiedPair(verified.keys, told, verified.matches, mask)


def _agree(pose: Pose, way: Way) -> bool:
    """Whether a pose is about the implied one; NaN is not."""
    errors = (
        rotation_error_deg(pose, way.cam2_from_cam1),
        translation_error_deg(pose, way.cam2_from_cam1),
    )
    return all(error < _AGREES_DEG for error in errors)
