# SPDX-License-Identifier: BSD-3-Clause
"""Verdicts on the pairs of a folder: their own, what the surroundings say, what other pairs say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np

from epi360.interop.match_graph import REFUSED
from epi360.jobs.graph.graph_check import (
    CONFIRMED,
    believed,
    check_graph,
    closing,
    does_not_fit,
    fitting,
    groups_by,
)
from epi360.jobs.graph.place_verdict import (
    ANOTHER_PLACE,
    COPY,
    PLACE_AGREES,
    PLACE_CONFIRMED,
    PlaceVerdict,
)
from epi360.jobs.matching.implied_job import IMPLIED, ImpliedPair
from epi360.jobs.matching.implied_job import PRIOR as IMPLIED_PRIOR
from epi360.jobs.matching.second_poses import PRIOR as SECOND_PRIOR
from epi360.jobs.matching.second_poses import SECOND, SecondPair
from epi360.jobs.records.match_store import Keys, Verdict
from epi360.poses import Pose

CONTRADICTED = "contradicted by other pairs"
_UNDECIDED = ("pure_rotation", "planar_ambiguous")  # whose inliers are right matches all the same
_AS_STATED = 2.0  # so many doubted poses are thought to be as probable as their matches say
_OF_TWO_PLACES = f"{ANOTHER_PLACE}, as other pairs say that look from one to the other"


@dataclass(frozen=True, eq=False, kw_only=True)
class PairVerdict(Verdict):
    """What became of a pair of images.

    The last six attributes are those of `GraphVerdict`; ``refused`` may also be that of
    `PlaceVerdict`, and ``contradicted_by`` then names the pairs that speak against it.
    """

    image1: str
    image2: str
    num_triangles: int = 0
    num_contradicted: int = 0
    contradicted: bool = False
    contradicted_by: tuple[tuple[str, str], ...] = ()
    refused: str = ""
    confirmed: bool = False

    @classmethod
    def of(cls, names: tuple[str, str], verdict: Verdict) -> PairVerdict:
        """Verdict on two images, by name, before other pairs are heard."""
        return cls(**vars(verdict), image1=names[0], image2=names[1])

    @property
    def accepted(self) -> bool:
        """Whether the pose may be used."""
        return super().accepted and not self.contradicted and not self.refused

    @property
    def rejection(self) -> str:
        """Why it is not accepted, in the words that a summary counts."""
        return CONTRADICTED if self.contradicted else self.refused.partition(",")[0] or self.status

    @property
    def by_others(self) -> bool:
        """Whether it is accepted for what other pairs know of the place, or what surrounds it."""
        return self.accepted and (self.has_other_pose or PLACE_AGREES in self.warnings)

    @property
    def has_other_pose(self) -> bool:
        """Whether it has another pose than the one that its matches said first."""
        return self.prior in (IMPLIED_PRIOR, SECOND_PRIOR)

    @property
    def accepted_for(self) -> str:
        """What it is accepted for, if its own matches alone leave a doubt; else empty."""
        told = (why for why in (IMPLIED, SECOND, PLACE_AGREES, CONFIRMED) if why in self.warnings)
        return next(told, "") if self.accepted else ""


def checked(
    verdicts: Sequence[PairVerdict], places: Sequence[PlaceVerdict | None], *, is_level: bool
) -> tuple[PairVerdict, ...]:
    """Verdicts with what the surroundings and the other pairs say.

    ``places`` has None for pairs whose surroundings were not looked at.
    """
    judged = _judged(verdicts, places, is_level)
    told = list(map(_told, verdicts, judged, places))
    share = _share_of_doubted(verdicts, places)
    for row, (verdict, place) in enumerate(zip(told, places, strict=True)):
        if place is None and verdict.status not in ("ok", "pure_rotation"):
            told[row] = replace(verdict, probability=verdict.probability * share)
    return tuple(told)


def with_second(
    verdicts: Sequence[PairVerdict],
    keys: Sequence[Keys | None],
    second: Mapping[Keys, SecondPair],
    *,
    is_level: bool,
) -> tuple[PairVerdict, ...]:
    """Verdicts of which some have a second pose, if no triangle with accepted pairs is open.

    The surest is tried first. ``keys`` are those of each pair, None where an image cannot be read.
    """
    names = _names(verdicts)
    accepted = [row for row, verdict in enumerate(verdicts) if verdict.accepted]
    found = {
        row: second[each]
        for row, each in enumerate(keys)
        if each is not None and each in second and not verdicts[row].accepted
    }
    chances = {
        row: each.verified.verdict.probability * each.place.probability
        for row, each in found.items()
    }
    surest = sorted(found, key=lambda row: (-chances[row], row))
    tried = {row: found[row].verified.verdict for row in surest}
    fits = fitting(names, verdicts, accepted, tried, is_level=is_level)
    told = list(verdicts)
    for row, loop in fits.items():
        own = replace(found[row].verified.verdict, probability=chances[row])
        each = PairVerdict.of(names[row], own)
        told[row] = replace(each, num_triangles=loop.num_triangles)
    return tuple(told)


def with_implied(
    verdicts: Sequence[PairVerdict],
    keys: Sequence[Keys | None],
    implied: Mapping[Keys, ImpliedPair],
) -> tuple[PairVerdict, ...]:
    """Verdicts of which some have the pose that others imply, if no other triangle is open.

    Such a pose is right if both pairs are that imply it. ``keys`` are those of each pair, None
    where an image cannot be read.
    """
    names = _names(verdicts)
    accepted = [row for row, verdict in enumerate(verdicts) if verdict.accepted]
    chances = {keys[row]: verdicts[row].probability for row in accepted}
    told = {}
    for row, each in enumerate(keys):
        if each is not None and each in implied and not verdicts[row].accepted:
            own = implied[each].verified.verdict
            chance = own.probability * float(np.prod([chances[by] for by in implied[each].by]))
            told[row] = PairVerdict.of(names[row], replace(own, probability=chance))
    closed = closing(names, verdicts, accepted, told)
    return tuple(
        replace(told[row], num_triangles=closed[row].num_triangles) if row in closed else verdict
        for row, verdict in enumerate(verdicts)
    )


def without_copies(verdicts: Sequence[PairVerdict]) -> tuple[PairVerdict, ...]:
    """Verdicts without turned cameras and lone planes between places that are told apart.

    Panoramas at the same place of two copies of a room differ by a rotation, to all appearance. Two
    groups that accepted pairs make are of two places if the surroundings refused a pair of them.
    """
    group_of = groups_by((v.image1, v.image2) for v in verdicts if v.accepted)

    def ends(verdict: PairVerdict) -> frozenset[str]:
        return frozenset(group_of.get(name, name) for name in (verdict.image1, verdict.image2))

    apart: dict[frozenset[str], list[tuple[str, str]]] = {}
    for v in verdicts:
        if v.refused.startswith((ANOTHER_PLACE, COPY)):
            apart.setdefault(ends(v), []).append((v.image1, v.image2))
    return tuple(
        _refused(v, _OF_TWO_PLACES, apart[ends(v)])
        if v.status in _UNDECIDED and len(ends(v)) == 2 and ends(v) in apart
        else v
        for v in verdicts
    )


def with_refusals(verdicts: Sequence[PairVerdict]) -> tuple[PairVerdict, ...]:
    """Verdicts whose status says so where others refuse a pose or two that the matches agree with.

    So nobody who asks for the status alone takes such a pose for a good one.
    """
    return tuple(
        replace(verdict, status=REFUSED)
        if verdict.status in ("ok", *_UNDECIDED) and (verdict.contradicted or verdict.refused)
        else verdict
        for verdict in verdicts
    )


def _names(verdicts: Sequence[PairVerdict]) -> list[tuple[str, str]]:
    return [(verdict.image1, verdict.image2) for verdict in verdicts]


def _judged(
    verdicts: Sequence[PairVerdict], places: Sequence[PlaceVerdict | None], is_level: bool
) -> tuple[PairVerdict, ...]:
    heard = list(map(_with_place, verdicts, places))
    # A doubted pose that looks right may not join two groups for that alone.
    seen = {row for row, own in enumerate(verdicts) if own.accepted and places[row] is not None}
    judged = _with_graph(heard, is_level, seen)
    accepted = [row for row, verdict in enumerate(judged) if verdict.accepted]
    doubted = {
        row: verdicts[row]
        for row, place in enumerate(places)
        if place is not None and place.leaves_a_doubt and verdicts[row].accepted
    }
    confirmed = closing(_names(verdicts), judged, accepted, doubted)
    for row in confirmed:
        warnings = (*verdicts[row].warnings, PLACE_CONFIRMED)
        heard[row] = replace(verdicts[row], warnings=warnings)
    return _with_graph(heard, is_level, seen) if confirmed else judged


def _with_place(verdict: PairVerdict, place: PlaceVerdict | None) -> PairVerdict:
    """The verdict with what the surroundings say: they refuse a pose, or clear a doubted one."""
    if place is None:
        return verdict
    if verdict.accepted:
        return _refused(verdict, place.refused, place.contradicted_by)
    if not place.refused:
        return replace(believed(verdict), warnings=(*verdict.warnings, PLACE_AGREES))
    return verdict if place.leaves_a_doubt else replace(verdict, doubted=Pose.nan())


def _refused(verdict: PairVerdict, refused: str, against: Sequence[tuple[str, str]]) -> PairVerdict:
    """The verdict with why it is refused, and the pairs that speak against it."""
    warnings = (*verdict.warnings, *does_not_fit(against))
    return replace(verdict, refused=refused, contradicted_by=tuple(against), warnings=warnings)


def _with_graph(
    verdicts: Sequence[PairVerdict], is_level: bool, seen: Set[int]
) -> tuple[PairVerdict, ...]:
    """Verdicts with what the other pairs say; the surroundings of the rows ``seen`` were."""
    judged = []
    checks = check_graph(_names(verdicts), verdicts, is_level=is_level, seen=seen)
    for verdict, found in zip(verdicts, checks, strict=True):
        warnings = (*verdict.warnings, *found.doubts(verdict))
        heard = {
            "refused": verdict.refused or found.refused,
            "contradicted_by": verdict.contradicted_by or found.contradicted_by,
        }
        each = replace(verdict, **{**vars(found), **heard}, warnings=warnings)
        if found.confirmed:
            each = replace(each, status="ok", cam2_from_cam1=verdict.doubted)
        judged.append(each)
    return tuple(judged)


def _share_of_doubted(
    verdicts: Sequence[PairVerdict], places: Sequence[PlaceVerdict | None]
) -> float:
    """How many of the doubted poses whose surroundings were compared are right.

    As many as their matches say, before any is.
    """
    chances = [
        place.if_refused
        for verdict, place in zip(verdicts, places, strict=True)
        if place is not None and not verdict.accepted
    ]
    return (_AS_STATED + sum(chances)) / (_AS_STATED + len(chances))


def _told(own: PairVerdict, judged: PairVerdict, place: PlaceVerdict | None) -> PairVerdict:
    """The verdict with its probability, and without what was only assumed of a doubted pose."""
    if place is None:
        return judged
    if PLACE_AGREES in judged.warnings:
        judged = replace(judged, confirmed=True) if judged.accepted else own
    chance = place.if_accepted if judged.accepted else place.if_refused
    warnings = place.warnings if judged.accepted else ()
    return replace(
        judged,
        warnings=(*judged.warnings, *warnings),
        probability=own.probability * chance,
        doubted=own.doubted,
        rotation_sigma_deg=own.rotation_sigma_deg,
        translation_sigma_deg=own.translation_sigma_deg,
    )
