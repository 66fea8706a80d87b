# SPDX-License-Identifier: BSD-3-Clause
"""Whether another place of the map explains a new image as well: rooms that look alike.

The images of a map that look most like a new one may all be of one place, and then nothing speaks
against it. So the next ones of other places are asked as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.estimation import AbsolutePoseResult
from epi360.estimation.absolute_evidence import angles_between, directions_of, evidence_for
from epi360.jobs.localization.map_matches import MapMatches, joined
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.poses import Pose, rotation_error_deg

Array = NDArray[np.float64]
PoseOf = Callable[[MapMatches, Pose | None], AbsolutePoseResult]

_NUM_OTHERS = 4  # images of other places that are asked
_FEWEST_SHARED = 15  # points that images of one place both see; inliers of an image that agrees
# A pose of which another one explains this share of the regions is ambiguous, as in the estimator.
_RIVAL_SHARE = 0.5
_DOUBT_SHARE = 0.2  # from which there is a warning
_RIVAL_DEG, _RIVAL_DISTANCE = 3.0, 0.05  # beyond which two poses differ, in distances of points


@dataclass(frozen=True, eq=False)
class Found:
    """A pose, and the matches that it was estimated from."""

    result: AbsolutePoseResult
    matches: MapMatches


def other_places(world: LocalizationMap, found: Found, ranked: Sequence[int]) -> list[int]:
    """Images of a ranking that see other places than those that agree with a pose."""
    views = found.matches.views[found.result.inlier_mask]
    counts = np.bincount(views, minlength=len(world.model.images))
    here = {int(k) for k in np.flatnonzero(counts >= _FEWEST_SHARED)} | {int(counts.argmax())}
    for number in tuple(here):
        here.update(world.covisible(number, _FEWEST_SHARED))
    return [number for number in ranked if number not in here][:_NUM_OTHERS]


def with_rival(
    found: Found, others: Sequence[MapMatches], bearings: Array, pose_of: PoseOf
) -> Found:
    """The pose that explains more of the image, "ambiguous" if the other explains half as much.

    ``others`` are the matches of images of other places, each alone, and ``pose_of`` estimates a
    pose, from a guess on where there is one.
    """
    rival = _rival(others, pose_of)
    if rival is None or not _differ(found, rival):
        return found
    everything = joined([found.matches, *others])
    regions = [_num_regions(each.result, everything, bearings) for each in (found, rival)]
    best, second = (found, rival) if regions[0] >= regions[1] else (rival, found)
    share = min(regions) / max(*regions, 1e-9)
    if share <= _RIVAL_SHARE:
        return best if share < _DOUBT_SHARE else _warned(best, share)
    doubted = replace(
        best.result,
        status="ambiguous",
        probability=best.result.probability * max(regions) / sum(regions),
        alternatives=(second.result.cam_from_world,),
    )
    return Found(doubted, best.matches)


def _warned(found: Found, share: float) -> Found:
    warning = (
        f"another place of the map explains {share:.0%} as much of the image: there may be rooms "
        "that look alike"
    )
    warnings = (*found.result.warnings, warning)
    return Found(replace(found.result, warnings=warnings), found.matches)


def _rival(others: Sequence[MapMatches], pose_of: PoseOf) -> Found | None:
    """Pose in another place: that of one of its images, refined with all of them."""
    alone = [pose_of(matches, None) for matches in others]
    with_pose = [each for each in alone if each.success]
    if not with_pose:
        return None
    best = max(with_pose, key=lambda each: each.num_inliers)
    together = joined(others)
    refined = pose_of(together, best.cam_from_world)
    if refined.success:
        return Found(refined, together)
    return Found(best, others[next(k for k, each in enumerate(alone) if each is best)])


def _differ(found: Found, rival: Found) -> bool:
    poses = [each.result.cam_from_world for each in (found, rival)]
    centers = [pose.inverse().translation for pose in poses]
    points = found.matches.points[found.result.inlier_mask]
    distance = float(np.median(np.linalg.norm(points - centers[0], axis=1)))
    apart = float(np.linalg.norm(centers[0] - centers[1]))
    return rotation_error_deg(*poses) > _RIVAL_DEG or apart > _RIVAL_DISTANCE * distance


def _num_regions(result: AbsolutePoseResult, matches: MapMatches, bearings: Array) -> float:
    """Regions of the image that agree with a pose, of the matches with both places."""
    seen = bearings[matches.rows]
    directions = directions_of(result.cam_from_world, matches.points)
    gate = float(np.radians(result.inlier_threshold_deg))
    inliers = angles_between(seen, directions) < gate
    return evidence_for(seen, directions, inliers, gate).num_regions
