# SPDX-License-Identifier: BSD-3-Clause
"""Pairs whose first pose is not accepted, and whose other matches agree on a second one.

Most matches of two views through a door may be of a copy of what is behind it. Those that do not
agree with its pose may say how the cameras really stand. What surrounds them decides.
"""

from __future__ import annotations

from collections.abc import Iterator, Set
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.jobs.graph.graph_check import awaits_confirmation
from epi360.jobs.graph.place_verdict import PlaceVerdict
from epi360.jobs.matching.place_job import Places
from epi360.jobs.matching.verified_folder import SettledPairs
from epi360.jobs.matching.verified_matches import Matched, with_pose_of_some
from epi360.jobs.records.match_store import Keys, VerifiedPair
from epi360.poses import poses_agree

_SAME_DEG = 5.0  # a pose this near to the first one says nothing new
_PAIRS_AT_ONCE = 256  # whose matches are in memory
PRIOR = "second"
SECOND = "the matches that do not agree with the first pose say this one; its surroundings fit"


@dataclass(frozen=True, eq=False)
class SecondPair:
    """A pair with its second pose, and what the surroundings say about that."""

    verified: VerifiedPair
    place: PlaceVerdict


@dataclass(frozen=True, eq=False)
class AskedAnew:
    """A pair with the matches that do not agree with its first pose: ``left`` (M,) of all."""

    verified: VerifiedPair
    matched: Matched
    left: NDArray[np.bool_]

    def with_pose_of(self, result: VerifiedPair) -> VerifiedPair | None:
        """The pair with the pose that they say; None if there is none, or it is the first one."""
        first, verdict = self.verified.verdict, result.verdict
        if not verdict.accepted and not awaits_confirmation(verdict):
            return None
        pose = verdict.cam2_from_cam1 if verdict.accepted else verdict.doubted
        before = (first.cam2_from_cam1, first.doubted)
        if any(poses_agree(pose, each, _SAME_DEG, _SAME_DEG) for each in before):
            return None
        return with_pose_of_some(self.verified, self.left, result, pose, SECOND)


def find_second(
    settled: SettledPairs, places: Places, accepted: Set[Keys]
) -> dict[Keys, SecondPair]:
    """Pairs that are not accepted, and that have a second pose which the surroundings speak for.

    ``accepted`` are those whose own pose is accepted. A camera that has only turned has no second
    pose: what does not agree with the first has moved.
    """
    others = {
        keys
        for keys in settled.images
        if keys not in accepted
        and keys[0] != keys[1]
        and settled.verdicts[keys].status != "pure_rotation"
    }
    if not others or not places.can_judge_more:
        return {}
    found: dict[Keys, SecondPair] = {}
    for results in asked_anew(settled, others, PRIOR):
        told = (asked.with_pose_of(result) for asked, result in results)
        second = [verified for verified in told if verified is not None]
        verdicts = places.on_more([settled.posed(each) for each in second])
        for verified, place in zip(second, verdicts, strict=True):
            if place is None or place.refused:
                continue
            if not places.has_rival(settled.posed(verified)):
                found[verified.keys] = SecondPair(verified, place)
    return found


def asked_anew(
    settled: SettledPairs, wanted: Set[Keys], prior: str
) -> Iterator[list[tuple[AskedAnew, VerifiedPair]]]:
    """Wanted pairs, some at a time, and what their matches say that do not agree with the pose.

    ``prior`` says in words how these were chosen, and begins the name of the stage.
    """
    if not wanted:
        return
    stage, progress, num_done = f"{prior} poses", settled.folder.progress, 0
    progress(stage, num_done, len(wanted))
    candidates = _candidates(settled, wanted)
    while some := {
        settled.images[each.verified.keys]: each for each in islice(candidates, _PAIRS_AT_ONCE)
    }:
        matched = [(pair, each.matched.some(each.left)) for pair, each in some.items()]
        results = settled.folder.estimated(matched, prior, settled.level)
        yield [(some[pair], result) for pair, result in results.items()]
        num_done += len(some)
        progress(stage, num_done, len(wanted))
    progress(stage, len(wanted), len(wanted))  # of some no matches are left


def _candidates(settled: SettledPairs, wanted: Set[Keys]) -> Iterator[AskedAnew]:
    """Pairs of which enough matches are left."""
    for verified in settled.with_matches(wanted):
        left = ~verified.inlier_mask
        is_asked_anew = verified.inlier_mask.any()
        if is_asked_anew and np.count_nonzero(left) >= IMAGE_OPTIONS.min_num_inliers:
            yield AskedAnew(verified, settled.matched(verified), left)
