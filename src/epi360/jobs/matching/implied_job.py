# SPDX-License-Identifier: BSD-3-Clause
"""Pairs whose own pose is not accepted, and whose matches agree with what two others imply.

Through a door most matches may be of a copy of what is behind it, or all lie in the door. Where
other pairs say how both cameras stand, the matches that fit are enough.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
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

# Matches that may belong to the pose are those this near to its epipolar planes; what they say must
# agree with the implied pose.
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
    """A pair with its matches, those of them that may belong to an implied pose, and that pose."""

    verified: VerifiedPair
    near: NDArray[np.bool_]
    matched: Matched
    way: Way


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
    found = {}
    while some := list(islice(candidates, _PAIRS_AT_ONCE)):
        results = folder.estimated([(pair, each.matched) for pair, each in some], PRIOR)
        for pair, each in some:
            if (verified := _if_agrees(results[pair], each)) is not None:
                row1, row2 = each.way.rows
                found[verified.keys] = ImpliedPair(verified, (sure[row1], sure[row2]))
    return found


def _candidates(
    folder: VerifiedFolder,
    panoramas: Mapping[Keys, Pair],
    others: Iterable[VerifiedPair],
    known: ImpliedPoses,
) -> Iterator[tuple[Pair, _Candidate]]:
    """Pairs with enough matches that may belong to an implied pose."""
    for verified in others:
        pair = panoramas[verified.keys]
        ways = known.ways(*pair)
        if ways and not any(_agree(verified.verdict.cam2_from_cam1, way) for way in ways):
            candidate = _nearest(folder, pair, verified, ways)
            if len(candidate.matched.matches) >= _FEWEST_MATCHES:
                yield pair, candidate


def _nearest(
    folder: VerifiedFolder, pair: Pair, verified: VerifiedPair, ways: Sequence[Way]
) -> _Candidate:
    """Matches that may belong to the way with which most of them agree."""
    rows1, rows2 = verified.matches.T
    bearings1, bearings2 = folder.bearings_of(pair[0])[rows1], folder.bearings_of(pair[1])[rows2]
    way = max(ways, key=lambda each: each.num_agreeing(bearings1, bearings2))
    near = near_matches(way.cam2_from_cam1, bearings1, bearings2, _NEAR_DEG)
    matched = Matched(verified.matches[near], bearings1[near], bearings2[near])
    return _Candidate(verified, near, matched, way)


def _if_agrees(result: VerifiedPair, candidate: _Candidate) -> VerifiedPair | None:
    """The pair with the pose of its near matches, if that is about the implied one."""
    verdict = result.verdict
    if verdict.accepted:
        pose = verdict.cam2_from_cam1
    elif verdict.status == "concentrated_inliers" and awaits_confirmation(verdict):
        pose = verdict.doubted  # all matches through a door lie close together
    else:
        return None
    if not _agree(pose, candidate.way):
        return None
    verified, mask = candidate.verified, np.zeros(len(candidate.near), dtype=bool)
    mask[candidate.near] = result.inlier_mask
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
