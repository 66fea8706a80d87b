# SPDX-License-Identifier: BSD-3-Clause
"""Which place of a map a new image shows, if several look alike: rooms and their copies.

The images of a map that look most like a new one may all be of one place, and then nothing speaks
against it. So the next ones of other places are asked as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.absolute_evidence import directions_of, evidence_for
from epi360.jobs.localization.map_matches import MapMatches, joined
from epi360.jobs.localization.map_search import Found, MapSearch
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.jobs.localization.surroundings import Surroundings
from epi360.poses import angles_of_units, rotation_error_deg

Array = NDArray[np.float64]

_NUM_OTHERS = 4  # images of other places that are asked, even if a place is confirmed
_MOST_RIVALS = 3  # poses in other places, those with most inliers
_FEWEST_SHARED = 15  # points that images of one place both see; inliers of an image that agrees
# A pose of which another one explains this share of the regions is ambiguous, as in the estimator.
_RIVAL_SHARE = 0.5
_DOUBT_SHARE = 0.2  # from which there is a warning
_SILENT = 0.9  # probability of a place, below which there is one
_RIVAL_DEG, _RIVAL_DISTANCE = 3.0, 0.05  # beyond which two poses differ, in distances of points


def find_place(search: MapSearch) -> Found:
    """The pose that the image and the map speak most for; "ambiguous" where they leave a doubt."""
    first = search.first_look()
    places = [each for each in first if each.result.success]
    if not places:
        return first[0]
    others = other_places(search.world, places, search.ranked)
    places += _rivals(search, others[:_NUM_OTHERS], places)
    if not any(each.is_confirmed for each in places):
        places += _rivals(search, others[_NUM_OTHERS:], places)
    best = _weighed(places, search.new.bearings)
    return _with_remarks(best, search.options.known_place)


def other_places(
    world: LocalizationMap, places: Sequence[Found], ranked: Sequence[int]
) -> list[int]:
    """Images of a ranking that see other places than those that agree with poses."""
    here: set[int] = set()
    for found in places:
        views = found.matches.views[found.result.inlier_mask]
        counts = np.bincount(views, minlength=len(world.model.images))
        here |= {int(k) for k in np.flatnonzero(counts >= _FEWEST_SHARED)} | {int(counts.argmax())}
    for number in tuple(here):
        here.update(world.covisible(number, _FEWEST_SHARED))
    return [number for number in ranked if number not in here]


def _rivals(search: MapSearch, others: Sequence[int], known: Sequence[Found]) -> list[Found]:
    """Poses in other places: those of single images, refined with all of them."""
    parts = search.matched(others)
    together = joined(parts)
    alone = [Found(search.pose_of(part), part) for part in parts]
    alone = [each for each in alone if each.result.success]
    alone.sort(key=lambda each: -each.result.num_inliers)
    found: list[Found] = []
    for each in alone[:_MOST_RIVALS]:
        refined = Found(search.pose_of(together, each.result.cam_from_world), together)
        if refined.result.success and not _differ(each, refined):
            each = refined
        if all(_differ(one, each) for one in (*known, *found)):
            found.append(search.with_surroundings(each.result, each.matches))
    return found


def _weighed(places: Sequence[Found], bearings: Array) -> Found:
    """The pose with most regions of the image, each place with its probability of being no copy."""
    everything = joined([each.matches for each in places])
    regions = np.array([_num_regions(each, everything, bearings) for each in places])
    weights = regions * [max(each.around.probability, 1e-6) for each in places]
    first, *others = np.argsort(-weights, kind="stable")
    best = places[first]
    if not others:
        return best if best.is_confirmed else _ambiguous(best, None, 0.0)
    rival, share = places[others[0]], float(weights[others[0]] / weights[first])
    if share > _RIVAL_SHARE or not best.is_confirmed:
        return _ambiguous(best, rival, share)
    return _warned(best, float(regions[others].max() / max(regions[first], 1e-9)))


def _ambiguous(best: Found, rival: Found | None, share: float) -> Found:
    """A pose that may be that of another place; the rival has a share of what speaks for it."""
    result = replace(
        best.result,
        status="ambiguous",
        probability=best.result.probability / (1.0 + share),
        alternatives=() if rival is None else (rival.result.cam_from_world,),
    )
    return replace(best, result=result)


def _with_remarks(found: Found, known_place: bool) -> Found:
    """A pose with the probability that its surroundings leave, and what there is to say of them."""
    result, around = found.result, found.around
    probability = result.probability * (1.0 if known_place else around.probability)
    sure = around.probability >= _SILENT
    warnings = result.warnings if sure else (*result.warnings, _missing(around))
    return replace(found, result=replace(result, probability=probability, warnings=warnings))


def _missing(around: Surroundings) -> str:
    if not around.num_parts:
        return "no image of the map can say whether this is the place or one that looks alike"
    alike = round(around.share * around.num_parts)
    return (
        f"only about {alike} of {around.num_parts} parts of the view look as in {around.witness} "
        "of the map: this may be another place that looks alike, or much has changed"
    )


def _warned(found: Found, share: float) -> Found:
    if share < _DOUBT_SHARE:
        return found
    warning = (
        f"another place of the map explains {share:.0%} as much of the image: there may be rooms "
        "that look alike"
    )
    result = replace(found.result, warnings=(*found.result.warnings, warning))
    return replace(found, result=result)


def _differ(found: Found, rival: Found) -> bool:
    poses = [each.result.cam_from_world for each in (found, rival)]
    centers = [pose.inverse().translation for pose in poses]
    points = found.matches.points[found.result.inlier_mask]
    distance = float(np.median(np.linalg.norm(points - centers[0], axis=1)))
    apart = float(np.linalg.norm(centers[0] - centers[1]))
    return rotation_error_deg(*poses) > _RIVAL_DEG or apart > _RIVAL_DISTANCE * distance


def _num_regions(found: Found, matches: MapMatches, bearings: Array) -> float:
    """Regions of the image that agree with a pose, of the matches with all places."""
    seen = bearings[matches.rows]
    directions = directions_of(found.result.cam_from_world, matches.points)
    gate = float(np.radians(found.result.inlier_threshold_deg))
    inliers = angles_of_units(seen, directions) < gate
    return evidence_for(seen, directions, inliers, gate).num_regions
