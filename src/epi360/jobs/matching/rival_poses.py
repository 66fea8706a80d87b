# SPDX-License-Identifier: BSD-3-Clause
"""Accepted pairs whose other matches, or look-alikes, agree as well on another pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from functools import partial

from epi360.cameras.upright import is_full_panorama
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.graph.place_verdict import PlaceVerdict
from epi360.jobs.matching.place_job import Places
from epi360.jobs.matching.second_poses import asked_anew
from epi360.jobs.matching.verified_folder import SettledPairs, VerifiedFolder, readable_pairs
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict, VerifiedPair
from epi360.jobs.threads import on_threads
from epi360.places.own_evidence import OwnEvidence, grow_both
from epi360.places.repeated_matches import DirectionVotes, is_in_the_open, which_repeat
from epi360.places.repeated_place import (
    MANY_OTHERS,
    are_many,
    competes,
    is_another,
    looks_right,
)
from epi360.places.shared_points import PosedPair

_PRIOR = "rival"
_REPEATED = (
    "shows a place that repeats itself, for other matches agree on another pose, around which the "
    "pictures look as right"
)
_ALIKE = (
    "shows things that look alike, such as equal desks, and as many of their key points agree on "
    "another direction"
)
_BY_MATCHES = (
    "shows a place that repeats itself, for many of its other matches agree on another direction; "
    "pictures may tell"
)
_MOST_PROBABLE = 0.5  # which of two poses it is nothing tells


def find_rivals(
    settled: SettledPairs, places: Places, accepted: Set[Keys]
) -> dict[Keys, PlaceVerdict]:
    """Verdicts on accepted pairs that another pose refuses, or warns of; see `with_rival_pose`."""
    found: dict[Keys, PlaceVerdict] = {}
    for results in asked_anew(settled, accepted & settled.images.keys(), _PRIOR):
        rivals, many = {}, set()
        for pair, other in results:
            verdict, keys = pair.verified.verdict, pair.verified.keys
            if not other.verdict.accepted:
                continue
            if not is_another(verdict.cam2_from_cam1, other.verdict.cam2_from_cam1):
                continue
            counts = other.verdict.num_inliers, verdict.num_inliers
            rivals[keys] = settled.posed(other), counts
            if are_many(*counts):
                many.add(keys)
        look = partial(_looks_right, places, rivals)
        for keys, is_right in on_threads(look, list(rivals), settled.folder.num_threads):
            place = places.verdicts[keys]
            if is_right:
                found[keys] = _refused(place, _REPEATED)
            elif keys in many:
                found[keys] = replace(place, warnings=(*place.warnings, MANY_OTHERS))
    return found


def find_look_alikes(
    settled: SettledPairs, places: Places, believed: Set[Keys]
) -> dict[Keys, PlaceVerdict]:
    """Verdicts on those of the believed pairs that equal things refuse; see `rival_direction`."""
    posed = {pair.images: pair for pair in places.known.pairs}

    def has_rival(keys: Keys) -> bool:
        return places.has_rival(posed[settled.images[keys]])

    in_order = sorted(believed, key=lambda keys: settled.images[keys])
    told = on_threads(has_rival, in_order, settled.folder.num_threads)
    return {keys: _refused(places.verdicts[keys], _ALIKE) for keys, has_one in told if has_one}


def find_repeated(
    folder: VerifiedFolder,
    pairs: Sequence[Pair],
    told: Mapping[Keys, Verdict],
    level: Level | None,
) -> dict[Keys, PlaceVerdict]:
    """Verdicts on accepted pairs of panoramas that their other matches refuse; see `which_repeat`.

    For folders of which there are no pictures.
    """
    images = {
        keys: pair
        for keys, pair in readable_pairs(folder, pairs, is_full_panorama).items()
        if told[keys].accepted
    }
    settled = SettledPairs(folder, images, told, level)

    def votes(pair: VerifiedPair) -> DirectionVotes:
        bearings = settled.matched(pair).bearings
        found = DirectionVotes.of(pair.verdict.cam2_from_cam1, bearings, pair.inlier_mask)
        return found._replace(in_the_open=is_in_the_open(settled.posed(pair)))

    found, stage = {}, "other directions"
    folder.progress(stage, 0, len(images))
    accepted = list(settled.with_matches(images))
    for count, (pair, each) in enumerate(on_threads(votes, accepted, folder.num_threads), start=1):
        found[pair.keys] = each
        folder.progress(stage, count, len(images))
    repeat = zip(found, which_repeat(list(found.values())), strict=True)
    return {keys: _refused(PlaceVerdict(), _BY_MATCHES) for keys, repeats in repeat if repeats}


def _looks_right(
    places: Places, rivals: Mapping[Keys, tuple[PosedPair, tuple[int, int]]], keys: Keys
) -> bool:
    pair, counts = rivals[keys]
    panoramas = places.panoramas_of(pair)
    if panoramas is None:
        return False
    views = grow_both(pair, panoramas)
    return looks_right(OwnEvidence.of(pair, views)) and competes(*counts, views, panoramas)


def _refused(place: PlaceVerdict, why: str) -> PlaceVerdict:
    """The verdict on a pair of which nothing tells which of two poses is right."""
    probability = min(place.probability, _MOST_PROBABLE)
    return replace(place, probability=probability, refused=why, by_itself=True)
