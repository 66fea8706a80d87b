# SPDX-License-Identifier: BSD-3-Clause
"""Pairs whose own pose is not accepted, and whose matches agree with what two others imply.

Through a door most matches may be of a copy of what is behind it, or all lie in the door. Where
other pairs say how both cameras stand, the matches that fit are enough.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.copies import repeat_no_earlier
from epi360.jobs.graph.graph_check import awaits_confirmation
from epi360.jobs.graph.implied_poses import ImpliedPoses, Way, near_matches
from epi360.jobs.matching.place_job import MOST_PAIRS
from epi360.jobs.matching.verified_folder import SettledPairs, VerifiedFolder
from epi360.jobs.matching.verified_matches import Matched, with_pose_of_some
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, VerifiedPair
from epi360.poses import Pose, poses_agree

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
    """A pair with its matches, and the pose that others imply.

    ``distinct`` (N,) are those that repeat no other one: a key point at a pole is often found with
    several directions.
    """

    verified: VerifiedPair
    matched: Matched
    distinct: Mask
    way: Way

    def agreeing(self) -> Mask:
        """Matches that agree with the implied pose."""
        return self.distinct & self.way.agreeing(*self.matched.bearings)

    def near(self) -> Mask:
        """Matches that may belong to it even if it is a degree off."""
        near = near_matches(self.way.cam2_from_cam1, *self.matched.bearings, _NEAR_DEG)
        return self.distinct & near

    @property
    def is_chance(self) -> bool:
        """Whether as many matches might agree with the implied pose by chance."""
        return self.way.is_chance(*self.matched.some(self.distinct).bearings)


def find_implied(
    settled: SettledPairs, accepted: Set[Keys], second: Set[Keys]
) -> dict[Keys, ImpliedPair]:
    """Pairs that are not accepted, and whose matches agree with the pose that two others imply.

    Those of the ``accepted`` ones that have a ``second`` pose imply none, for a wrong one would
    pull whole rooms along. A pair whose own pose is the implied one is left out: it has been
    refused for something else.
    """
    if not 2 <= len(accepted) <= MOST_PAIRS:
        return {}
    folder, images = settled.folder, settled.images
    posed = {each.keys: settled.posed(each) for each in settled.with_matches(accepted - second)}
    sure = sorted(posed, key=lambda keys: images[keys])
    known = ImpliedPoses([posed[keys] for keys in sure])
    others = {keys for keys in images if keys not in accepted and keys[0] != keys[1]}
    candidates = _candidates(settled, others, known)
    found: dict[Keys, ImpliedPair] = {}
    while some := dict(islice(candidates, _PAIRS_AT_ONCE)):
        for which in (_Candidate.agreeing, _Candidate.near):
            left = {p: each for p, each in some.items() if each.verified.keys not in found}
            for pair, verified in _verified(folder, left, which).items():
                row1, row2 = left[pair].way.rows
                found[verified.keys] = ImpliedPair(verified, (sure[row1], sure[row2]))
    return found


def _candidates(
    settled: SettledPairs, others: Set[Keys], known: ImpliedPoses
) -> Iterator[tuple[Pair, _Candidate]]:
    """Pairs with another pose than those that are implied, each with that of most matches."""
    for verified in settled.with_matches(others):
        pair = settled.images[verified.keys]
        ways = known.ways(*pair)
        if not ways or any(_agree(verified.verdict.cam2_from_cam1, way) for way in ways):
            continue
        matched = settled.matched(verified)
        distinct = repeat_no_earlier(*matched.bearings)
        bearings = matched.some(distinct).bearings
        way = max(ways, key=lambda each: each.num_agreeing(*bearings))
        yield pair, _Candidate(verified, matched, distinct, way)


def _verified(
    folder: VerifiedFolder,
    candidates: Mapping[Pair, _Candidate],
    which: Callable[[_Candidate], Mask],
) -> dict[Pair, VerifiedPair]:
    """Pairs of which some matches, chosen by the implied pose, say that it is right."""
    chosen = {pair: which(each) for pair, each in candidates.items()}
    asked = {pair: some for pair, some in chosen.items() if some.sum() >= _FEWEST_MATCHES}
    matched = [(pair, candidates[pair].matched.some(some)) for pair, some in asked.items()]
    results = folder.estimated(matched, PRIOR, None) if matched else {}
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
    elif awaits_confirmation(verdict) and not candidate.is_chance:
        pose = verdict.doubted
    else:
        return None
    if not _agree(pose, candidate.way):
        return None
    return with_pose_of_some(candidate.verified, chosen, result, pose, IMPLIED)


def _agree(pose: Pose, way: Way) -> bool:
    """Whether a pose is about the implied one; NaN is not."""
    return poses_agree(pose, way.cam2_from_cam1, _AGREES_DEG, _AGREES_DEG)
