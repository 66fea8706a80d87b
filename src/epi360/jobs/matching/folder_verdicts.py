# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on the pairs of a folder by all that is known of it.

First whether it is level, then what the surroundings of each pair look like, what triangles say,
second poses, and last the poses that accepted pairs imply for others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from epi360.cameras.upright import has_a_vertical
from epi360.jobs.graph.graph_check import CONFIRMED
from epi360.jobs.graph.level_folder import Level, find_level
from epi360.jobs.graph.rig_check import RigDoubt
from epi360.jobs.matching.implied_job import find_implied
from epi360.jobs.matching.pair_verdicts import (
    PairVerdict,
    checked,
    with_implied,
    with_refusals,
    with_second,
    without_copies,
)
from epi360.jobs.matching.place_job import MOST_PAIRS, check_places
from epi360.jobs.matching.rival_poses import find_look_alikes, find_repeated, find_rivals
from epi360.jobs.matching.second_poses import find_second
from epi360.jobs.matching.verified_folder import (
    SettledPairs,
    VerifiedFolder,
    are_usable,
    readable_pairs,
)
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import UNREADABLE, Keys, Verdict, VerifiedPair


@dataclass(frozen=True, eq=False, kw_only=True)
class JudgedPairs:
    """Verdicts on pairs of images, and what they say about all images."""

    images: tuple[str, ...]  # names of the images that were to be paired
    verdicts: tuple[PairVerdict, ...]  # in the order of the pairs
    how: str  # how the pairs were chosen, in words
    unreadable: Mapping[str, str] = field(default_factory=dict)  # image and why it was of no use
    # Images that could be read at first, and not when surroundings were compared, and why.
    gone: Mapping[str, str] = field(default_factory=dict)
    kept: tuple[tuple[str, str], ...] = ()  # images of the pairs that had a pose, and no verdict
    questioned: tuple[tuple[str, str], ...] = ()  # those whose pose others or its inliers refuse
    agreed: tuple[str, ...] = ()  # what is said of cameras that are other ones than were given
    # Whether pairs were matched or judged once more by these, all images were tracked and matched
    # by what the tracks of a sequence agree on, or it is only told.
    with_agreed: Literal["matched", "judged", "tracked", "told"] = "matched"
    level: Level | None = None  # what the poses of a level folder say about the others
    num_gained: int = 0  # pairs that are accepted because the folder is level
    num_lost: int = 0  # pairs that have no pose any more because the folder is level
    num_not_compared: int = 0  # accepted pairs whose surroundings are too many to compare them
    rig_doubts: tuple[RigDoubt, ...] = ()  # cameras of a rig that pairs see turned otherwise

    @property
    def num_by_others(self) -> int:
        """Pairs that are accepted for what other pairs know, or for what surrounds them."""
        return sum(verdict.by_others for verdict in self.verdicts)


@dataclass(frozen=True, eq=False)
class FolderVerdicts:
    """Verdicts on the pairs of a folder, in their order, each with its keys.

    The keys are None where an image cannot be read. ``settled`` are the verdicts of the pairs by
    themselves, and ``other_poses`` the pairs that are accepted with another pose than that.
    ``looked_around`` says whether the surroundings of pairs were compared.
    """

    keys: Sequence[Keys | None]
    verdicts: tuple[PairVerdict, ...]
    level: Level | None
    settled: Mapping[Keys, Verdict]
    other_poses: Mapping[Keys, VerifiedPair]
    looked_around: bool
    num_gained: int
    num_lost: int
    num_not_compared: int


def judge_folder(
    folder: VerifiedFolder,
    pairs: Sequence[Pair],
    finished: Mapping[Keys, Verdict],
    *,
    is_upright: bool = False,
    looks_around: bool = True,
    has_pictures: bool = True,
) -> FolderVerdicts:
    """Judge pairs that were verified by their own matches, with verdicts ``finished``.

    If ``is_upright``, it was given that all images stand upright; otherwise the poses say whether
    they do. If not ``looks_around``, the surroundings of the pairs are not compared, and no pair
    gets a second pose, or one that others imply. Of a folder that does not have pictures, pairs are
    refused whose other matches agree on another direction.
    """
    keys = [folder.keys_of(pair) if folder.is_readable(pair) else None for pair in pairs]
    level = None if is_upright else find_level(_of_panoramas(folder, pairs, finished))
    told = finished if level is None else _with_level(folder, pairs, finished, level)
    named = [_named(folder, *each, told) for each in zip(pairs, keys, strict=True)]
    settled = SettledPairs.of(folder, pairs if looks_around else (), told, level)
    places = check_places(settled)
    by_place = {} if places is None else dict(places.verdicts)
    if not has_pictures:
        by_place = find_repeated(folder, pairs, told, level)
    rivals: set[Keys] = set()
    if places is not None and places.can_judge_more:
        believed = {each for each, place in by_place.items() if not place.refused}
        by_rivals = find_look_alikes(settled, places, believed)
        own = {each for each in believed - by_rivals.keys() if told[each].accepted}
        by_rivals |= find_rivals(settled, places, own)
        by_place |= by_rivals
        rivals = {each for each, place in by_rivals.items() if place.refused}
    judged = [None if each is None else by_place.get(each) for each in keys]
    is_level = is_upright or level is not None
    verdicts = checked(named, judged, is_level=is_level)
    accepted = _accepted(keys, verdicts)
    second = {} if places is None else find_second(settled, places, accepted | rivals)
    verdicts = with_second(verdicts, keys, second, is_level=is_level)
    posed = {each: pair.verified for each, pair in second.items()}
    accepted = _accepted(keys, verdicts) & settled.images.keys()
    found = find_implied(settled, accepted, second.keys())
    implied = {
        each: pair
        for each, pair in found.items()
        if each not in rivals
        and not (places is not None and places.has_rival(settled.posed(pair.verified)))
    }
    verdicts = with_refusals(without_copies(with_implied(verdicts, keys, implied)))
    posed |= {each: pair.verified for each, pair in implied.items() if each not in accepted}
    num_comparable = sum(told[each].accepted for each in settled.images)
    return FolderVerdicts(
        keys,
        verdicts,
        level,
        told,
        {each: posed[each] for each in _accepted(keys, verdicts) & posed.keys()},
        looked_around=places is not None,
        num_gained=_num_accepted_more(told, finished)
        + sum(v.accepted and CONFIRMED in v.warnings for v in verdicts),
        num_lost=_num_accepted_more(finished, told),
        num_not_compared=num_comparable if num_comparable > MOST_PAIRS else 0,
    )


def _accepted(keys: Sequence[Keys | None], verdicts: Sequence[PairVerdict]) -> set[Keys]:
    return {each for each, told in zip(keys, verdicts, strict=True) if each and told.accepted}


def _of_panoramas(
    folder: VerifiedFolder, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict]
) -> list[Verdict]:
    return [
        finished[folder.keys_of(pair)]
        for pair in pairs
        if folder.is_readable(pair) and are_usable(folder, pair, has_a_vertical)
    ]


def _with_level(
    folder: VerifiedFolder, pairs: Sequence[Pair], finished: Mapping[Keys, Verdict], level: Level
) -> Mapping[Keys, Verdict]:
    """Verdicts of which some are replaced by those with the prior of the level folder."""
    usable = readable_pairs(folder, pairs, has_a_vertical)
    wanted = {keys: pair for keys, pair in usable.items() if level.asks_again(finished[keys])}
    again = folder.verify_again(wanted, level)
    return {**finished, **{keys: level.told(finished[keys], each) for keys, each in again.items()}}


def _num_accepted_more(verdicts: Mapping[Keys, Verdict], others: Mapping[Keys, Verdict]) -> int:
    """Pairs that are accepted by themselves here and not there."""
    return sum(verdict.accepted and not others[keys].accepted for keys, verdict in verdicts.items())


def _named(
    folder: VerifiedFolder, pair: Pair, keys: Keys | None, finished: Mapping[Keys, Verdict]
) -> PairVerdict:
    """Verdict on two images, by name; they have no keys where one is unreadable."""
    image1, image2 = (folder.name_of(index) for index in pair)
    verdict = Verdict(status=UNREADABLE) if keys is None else finished[keys]
    return PairVerdict.of((image1, image2), verdict)
