# SPDX-License-Identifier: BSD-3-Clause
"""`judge_places` on the pairs of a folder, from its pictures and matches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, TypeVar

from epi360.features.warped_patches import Panorama, remembered
from epi360.jobs.graph.graph_check import awaits_confirmation
from epi360.jobs.graph.place_check import Judged, judge_places, leave_a_doubt
from epi360.jobs.graph.place_evidence import Evidence, Surroundings
from epi360.jobs.graph.place_verdict import PlaceVerdict
from epi360.jobs.graph.surface_evidence import KnownView, SurfaceWitnesses
from epi360.jobs.matching.verified_folder import SettledPairs, VerifiedFolder
from epi360.jobs.records.match_store import Keys
from epi360.jobs.threads import on_threads
from epi360.places.look_alikes import rival_direction
from epi360.places.shared_points import PosedPair
from epi360.progress import Progress, no_progress

# What more pairs know does not fit into a gigabyte.
MOST_PAIRS = 10_000
# So few are asked for surfaces in any case: by points, pairs with one copy of a room agree.
_FEW_PAIRS = 500

Found = TypeVar("Found")
Views = dict[tuple[int, int], KnownView]  # by row and side of a pair


class PictureGoneError(Exception):
    """A picture could be read when its key points were found, and cannot now."""


@dataclass(frozen=True, eq=False)
class Places:
    """Verdicts on accepted pairs and doubted ones, and what it takes to judge more poses.

    ``views`` are what these pairs know of their views, by surfaces; none if these were not asked
    for.
    """

    verdicts: Mapping[Keys, PlaceVerdict]
    num_threads: int
    known: Surroundings
    views: Views
    judged: Judged

    @property
    def can_judge_more(self) -> bool:
        """Whether surfaces were asked for: nothing else speaks for a pose that is not accepted."""
        return bool(self.views)

    def panoramas_of(self, pair: PosedPair) -> list[Panorama] | None:
        """Both pictures of a pair; None if one is gone."""
        try:
            return [self.known.panorama_of(image) for image in pair.images]
        except PictureGoneError:
            return None

    def has_rival(self, pair: PosedPair) -> bool:
        """Whether what looks alike in both pictures agrees as well on another direction.

        Nothing is known of a picture that is gone.
        """
        panoramas = self.panoramas_of(pair)
        return panoramas is not None and rival_direction(pair, panoramas) is not None

    def on_more(self, posed: Sequence[PosedPair]) -> Sequence[PlaceVerdict | None]:
        """Verdicts on poses that are not accepted, which say nothing about each other.

        None on a pose of a picture that is gone.
        """
        if not posed:
            return []
        pairs = (*self.known.pairs, *posed)
        known = replace(self.known, pairs=pairs)
        rows = range(len(self.known.pairs), len(pairs))
        quietly = _Work(self.num_threads, no_progress)
        points = _of_each(quietly, known.of_points, rows)
        told = _with_surfaces(quietly, known, points, self.views)
        if told is None:
            return [None] * len(posed)
        verdicts = dict(zip(points, self.judged.on_doubted(told[0]), strict=True))
        return [verdicts.get(row) for row in rows]


def check_places(settled: SettledPairs) -> Places | None:
    """What the surroundings say about pairs, accepted ones and doubted ones.

    Nothing is said of pairs whose pictures cannot be read any more. None where no pairs are
    accepted, or too many.
    """
    usable = [keys for keys in settled.images if keys[0] != keys[1]]
    accepted = {keys for keys in usable if settled.verdicts[keys].accepted}
    if not 1 <= len(accepted) <= MOST_PAIRS:
        return None
    doubted = {keys for keys in usable if awaits_confirmation(settled.verdicts[keys])}
    asked = accepted | doubted if len(accepted | doubted) <= MOST_PAIRS else accepted
    posed = {each.keys: settled.posed(each) for each in settled.with_matches(asked)}
    folder = settled.folder
    panorama_of = remembered(partial(_read, folder))
    work = _Work(folder.num_threads, folder.progress)

    def around(keys: Sequence[Keys]) -> Surroundings:
        num_heard = sum(each in accepted for each in keys)
        return Surroundings.of([posed[each] for each in keys], panorama_of, num_heard)

    keys = sorted(posed, key=lambda each: (each in doubted, posed[each].images))
    known = around(keys)
    points = _of_each(work, known.of_points, range(len(keys)))
    if len(points) < len(keys):  # a picture is gone
        keys = [keys[row] for row in points]
        known = around(keys)
        points = _of_each(work, known.of_points, range(len(keys)))
    if len(points) < len(keys) or known.num_heard == 0:
        return None
    places = _judged(work, keys, known, points)
    named = {
        each: _naming_others(folder, known.pairs, place) for each, place in places.verdicts.items()
    }
    return replace(places, verdicts=named)


def _judged(
    work: _Work,
    keys: Sequence[Keys],
    known: Surroundings,
    points: Mapping[int, Evidence],
) -> Places:
    """Verdicts by points, and by surfaces, which cost much more: of many pairs only in doubt."""
    num_heard, evidence = known.num_heard, list(points.values())
    heard, views = known.pairs[:num_heard], Views()
    if num_heard <= _FEW_PAIRS or leave_a_doubt(heard, evidence[:num_heard]):
        told = _with_surfaces(work, known, points, views)
        evidence, views = (evidence, views) if told is None else told
    judged = judge_places(heard, evidence[:num_heard])
    verdicts = (*judged.verdicts, *judged.on_doubted(evidence[num_heard:]))
    told_of = dict(zip(keys, verdicts, strict=True))
    return Places(told_of, work.num_threads, known, views, judged)


def _naming_others(
    folder: VerifiedFolder, pairs: Sequence[PosedPair], place: PlaceVerdict
) -> PlaceVerdict:
    """The verdict with the names of the images of the pairs that speak against it."""
    against = (pairs[row].images for row in place.against)
    names = tuple((folder.name_of(first), folder.name_of(second)) for first, second in against)
    return replace(place, contradicted_by=names)


def _with_surfaces(
    work: _Work,
    known: Surroundings,
    points: Mapping[int, Evidence],
    views: Views,
) -> tuple[list[Evidence], Views] | None:
    """What surfaces say besides points, and what all pairs know of their views by them.

    ``views`` are known before. None if a picture is gone.
    """
    grown = _of_each(work, known.grown, list(points))
    if len(grown) < len(points):
        return None
    views = views | {(row, side): told[0][side] for row, told in grown.items() for side in (0, 1)}
    witnesses = SurfaceWitnesses.of(known.pairs, views, known.num_heard)

    def look(row: int) -> Evidence:
        return known.with_surfaces(row, points[row], witnesses, grown[row][1])

    found = _of_each(work, look, list(points))
    return None if len(found) < len(points) else (list(found.values()), views)


def _read(folder: VerifiedFolder, image: int) -> Panorama:
    try:
        return folder.panorama_of(image)
    except (OSError, ValueError) as error:
        raise PictureGoneError from error


class _Work(NamedTuple):
    """Who looks, and who is told."""

    num_threads: int
    progress: Progress


def _of_each(work: _Work, look: Callable[[int], Found], rows: Sequence[int]) -> dict[int, Found]:
    """What is found about each pair, on all threads, in order; nothing where a picture is gone."""
    work.progress("places", 0, len(rows))
    found = {}

    def tried(row: int) -> Found | None:
        try:
            return look(row)
        except PictureGoneError:
            return None

    for count, (row, each) in enumerate(on_threads(tried, rows, work.num_threads), start=1):
        work.progress("places", count, len(rows))
        if each is not None:
            found[row] = each
    return {row: found[row] for row in rows if row in found}
