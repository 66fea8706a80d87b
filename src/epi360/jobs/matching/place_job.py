# SPDX-License-Identifier: BSD-3-Clause
"""`judge_places` on the pairs of a folder, from its pictures and matches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from epi360.features.warped_patches import Panorama, remembered
from epi360.jobs.graph.graph_check import awaits_confirmation, believed
from epi360.jobs.graph.level_folder import Level
from epi360.jobs.graph.place_check import Judged, PlaceVerdict, judge_places, leave_a_doubt
from epi360.jobs.graph.place_evidence import Evidence, Surroundings
from epi360.jobs.graph.surface_evidence import KnownView, SurfaceWitnesses
from epi360.jobs.matching.verified_folder import VerifiedFolder
from epi360.jobs.pairs.pair_selection import Pair
from epi360.jobs.records.match_store import Keys, Verdict, VerifiedPair
from epi360.jobs.threads import on_threads
from epi360.places.shared_points import PosedPair

# What more pairs know does not fit into a gigabyte.
MOST_PAIRS = 10_000
# So few are asked for surfaces in any case: by points, pairs with one copy of a room agree.
_FEW_PAIRS = 500

Found = TypeVar("Found")
Views = dict[tuple[int, int], KnownView]  # by row and side of a pair


class _PictureGoneError(Exception):
    """A picture could be read when its key points were found, and cannot now."""


@dataclass(frozen=True, eq=False)
class Places:
    """Verdicts on accepted pairs and doubted ones, and what it takes to judge more poses.

    ``views`` are what these pairs know of their views, by surfaces; none if these were not asked
    for.
    """

    verdicts: Mapping[Keys, PlaceVerdict]
    folder: VerifiedFolder
    known: Surroundings
    views: Views
    judged: Judged

    def on_more(self, posed: Sequence[PosedPair]) -> Sequence[PlaceVerdict]:
        """Verdicts on poses that are not accepted, which say nothing about each other.

        There are none if surfaces were not asked for, for nothing speaks for such a pose but these;
        nor if a picture is gone.
        """
        if not self.views:
            return ()
        pairs = (*self.known.pairs, *posed)
        known = replace(self.known, pairs=pairs)
        rows = range(len(self.known.pairs), len(pairs))
        points = _of_each(self.folder, known.of_points, rows)
        told = _with_surfaces(self.folder, known, points, self.views)
        if told is None or len(points) < len(posed):
            return ()
        return self.judged.on_doubted(told[0])


def check_places(
    folder: VerifiedFolder,
    panoramas: Mapping[Keys, Pair],
    settled: Mapping[Keys, Verdict],
    level: Level | None,
) -> Places | None:
    """What the surroundings say about pairs of full panoramas: accepted ones, and doubted ones.

    ``panoramas`` has two readable ones for each pair of keys, ``settled`` the verdicts that count.
    Nothing is said of pairs whose pictures cannot be read any more. None where no pairs are
    accepted, or too many.
    """
    usable = {keys: pair for keys, pair in panoramas.items() if keys[0] != keys[1]}
    accepted = {keys for keys in usable if settled[keys].accepted}
    if not 1 <= len(accepted) <= MOST_PAIRS:
        return None
    doubted = {keys for keys in usable if awaits_confirmation(settled[keys])}
    asked = accepted | doubted if len(accepted | doubted) <= MOST_PAIRS else accepted
    posed = {
        each.keys: posed_pair(folder, usable[each.keys], each)
        for each in folder.settled_pairs(asked, settled, level)
    }
    panorama_of = remembered(partial(_read, folder))

    def around(keys: Sequence[Keys]) -> Surroundings:
        num_heard = sum(each in accepted for each in keys)
        return Surroundings.of([posed[each] for each in keys], panorama_of, num_heard)

    keys = sorted(posed, key=lambda each: (each in doubted, posed[each].images))
    known = around(keys)
    points = _of_each(folder, known.of_points, range(len(keys)))
    if len(points) < len(keys):  # a picture is gone
        keys = [keys[row] for row in points]
        known = around(keys)
        points = _of_each(folder, known.of_points, range(len(keys)))
    if len(points) < len(keys) or known.num_heard == 0:
        return None
    return _judged(folder, keys, known, points)


def _judged(
    folder: VerifiedFolder,
    keys: Sequence[Keys],
    known: Surroundings,
    points: Mapping[int, Evidence],
) -> Places:
    """Verdicts by points, and by surfaces, which cost much more: of many pairs only in doubt."""
    num_heard, evidence = known.num_heard, list(points.values())
    heard, views = known.pairs[:num_heard], Views()
    if num_heard <= _FEW_PAIRS or leave_a_doubt(heard, evidence[:num_heard]):
        told = _with_surfaces(folder, known, points, views)
        evidence, views = (evidence, views) if told is None else told
    judged = judge_places(heard, evidence[:num_heard])
    verdicts = (*judged.verdicts, *judged.on_doubted(evidence[num_heard:]))
    return Places(dict(zip(keys, verdicts, strict=True)), folder, known, views, judged)


def _with_surfaces(
    folder: VerifiedFolder,
    known: Surroundings,
    points: Mapping[int, Evidence],
    views: Views,
) -> tuple[list[Evidence], Views] | None:
    """What surfaces say besides points, and what all pairs know of their views by them.

    ``views`` are known before. None if a picture is gone.
    """
    grown = _of_each(folder, known.grown, list(points))
    if len(grown) < len(points):
        return None
    views = views | {(row, side): told[0][side] for row, told in grown.items() for side in (0, 1)}
    witnesses = SurfaceWitnesses.of(known.pairs, views, known.num_heard)

    def look(row: int) -> Evidence:
        return known.with_surfaces(row, points[row], witnesses, grown[row][1])

    found = _of_each(folder, look, list(points))
    return None if len(found) < len(points) else (list(found.values()), views)


def _read(folder: VerifiedFolder, image: int) -> Panorama:
    try:
        return folder.panorama_of(image)
    except (OSError, ValueError) as error:
        raise _PictureGoneError from error


def _of_each(
    folder: VerifiedFolder, look: Callable[[int], Found], rows: Sequence[int]
) -> dict[int, Found]:
    """What is found about each pair, on all threads, in order; nothing where a picture is gone."""
    folder.progress("places", 0, len(rows))
    found = {}

    def tried(row: int) -> Found | None:
        try:
            return look(row)
        except _PictureGoneError:
            return None

    for count, (row, each) in enumerate(on_threads(tried, rows, folder.num_threads), start=1):
        folder.progress("places", count, len(rows))
        if each is not None:
            found[row] = each
    return {row: found[row] for row in rows if row in found}


def posed_pair(folder: VerifiedFolder, pair: Pair, verified: VerifiedPair) -> PosedPair:
    """Pose and inliers of a pair that is accepted, or whose doubted pose is."""
    verdict = verified.verdict if verified.verdict.accepted else believed(verified.verdict)
    return PosedPair.of(
        pair,
        verdict.cam2_from_cam1,
        verified.matches[verified.inlier_mask],
        [folder.bearings_of(index) for index in pair],
        noise_deg=verdict.noise_deg,
        rotation_sigma_deg=verdict.rotation_sigma_deg,
        translation_sigma_deg=verdict.translation_sigma_deg,
    )
