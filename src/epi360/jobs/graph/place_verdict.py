# SPDX-License-Identifier: BSD-3-Clause
"""What is said about a pair for its surroundings: whether its pose is accepted, and why not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.result import LEAST_PROBABILITY, SamePlace
from epi360.jobs.graph.place_court import Court, Heard
from epi360.jobs.graph.place_groups import Groups
from epi360.jobs.graph.surface_evidence import surfaces_against, surfaces_ratio
from epi360.places.own_evidence import OwnEvidence
from epi360.places.same_place import doubts

ACCEPTED = 0.95  # least probability
_DOUBTED = 0.3  # least probability of a pose that is accepted if triangles with it close

PLACE_CONFIRMED = "what must look the same leaves a doubt; triangles with other pairs close"
PLACE_AGREES = "the inliers alone leave a doubt; the pose is accepted for its surroundings"
ANOTHER_PLACE, COPY = "shows another place", "may show a copy of the place"
_LOOKS_DIFFERENT = "for what surrounds the matches looks different"
REPEATS = (
    "shows a place that repeats itself, and little of what there is only once tells which part of "
    "it this is"
)


@dataclass(frozen=True)
class PlaceVerdict:
    """What the surroundings say about a pair.

    ``probability`` is that of the pose, given that its matches agree. ``share`` is the share of
    ``num_places`` parts of the views that look the same, of those that both cameras must see. Of a
    pair that is refused for what it shows ``by_itself``, other pairs say nothing: copies close
    triangles. What speaks against a pair and is not counted, because it would refuse right ones,
    is ``held_back``, as a log-likelihood ratio. ``warnings`` are about an accepted pose, and
    ``against`` are the rows of the pairs that speak against one that is refused, which their folder
    knows by the names of both images: ``contradicted_by``.
    """

    probability: float = 1.0
    share: float = np.nan
    num_places: int = 0
    refused: str = ""
    by_itself: bool = False
    held_back: float = 0.0
    warnings: tuple[str, ...] = ()
    against: tuple[int, ...] = ()
    contradicted_by: tuple[tuple[str, str], ...] = ()

    @property
    def if_accepted(self) -> float:
        """Probability of a pose that is accepted: triangles confirm one that is refused."""
        return max(self.probability, ACCEPTED) if self.refused else self.probability

    @property
    def if_refused(self) -> float:
        """Probability of a pose that is refused: all that speaks against it counts."""
        wrong = (1 - self.probability) * np.exp(self.held_back)
        return float(self.probability / (self.probability + wrong))

    @property
    def leaves_a_doubt(self) -> bool:
        """Whether other pairs may confirm a pose that is refused."""
        return bool(self.refused) and not self.by_itself and self.probability >= _DOUBTED


def verdict_on(
    court: Court, row: int, groups: Groups, probability: float, *, by_itself: bool
) -> PlaceVerdict:
    """The verdict on a pair that is right with a probability, by all that the folder knows.

    Where it must be probable ``by_itself``, too, it is judged once more as if its two images were
    compared alone, unless they show too little for that.
    """
    own, joined = court.evidence[row].own, groups.joined
    points = court.points_heard(row, joined)
    is_refused = probability < ACCEPTED
    refused, against = _refusal(court, row, groups, points) if is_refused else ("", ())
    verdict = PlaceVerdict(
        probability,
        points.num_alike / points.num_places if points.num_places else np.nan,
        points.num_places,
        refused,
        held_back=court.held_back(row, joined),
        against=against,
    )
    if not (by_itself and own.is_known):
        return verdict
    return _by_itself(verdict, own, court.place(row, joined))


def _refusal(court: Court, row: int, groups: Groups, points: Heard) -> tuple[str, tuple[int, ...]]:
    """Why a pair is not accepted, and by which pairs.

    What stands before the comma is what summaries count.
    """
    joined, told = groups.joined, groups.ratios[row]
    if np.isneginf(told):
        return (
            f"{ANOTHER_PLACE}, for pairs that more speaks for turn its panoramas otherwise",
            tuple(groups.ways[row]),
        )
    if told < (alone := court.ratio(row, joined)) and alone >= 0.0:
        return f"{COPY}, for too little speaks for pairs that say the same", ()
    if points.ratio < 0.0:
        return (
            f"{ANOTHER_PLACE}, for only {int(points.num_alike)} of {points.num_places} parts "
            "of the views that both cameras must see look the same",
            _surest(court.points_against(row, joined)),
        )
    surfaces = court.evidence[row].surfaces
    if surfaces_ratio(surfaces, joined) < 0.0:
        return (
            f"{ANOTHER_PLACE}, for surfaces differ that both cameras must see",
            _surest(surfaces_against(surfaces, joined)),
        )
    return f"{COPY}, and too little of what both cameras must see says otherwise", ()


def _surest(against: NDArray[np.float64]) -> tuple[int, ...]:
    """Rows of the pairs that speak against a pose, those that say most first."""
    rows = np.argsort(-against, kind="stable")
    return tuple(rows[against[rows] > 0.0].tolist())


def _by_itself(verdict: PlaceVerdict, own: OwnEvidence, place: SamePlace) -> PlaceVerdict:
    """The verdict on one of few pairs, which must be probable by what it shows itself, too.

    Where the others refuse it as well, it is said which of them contradict.
    """
    probability = min(verdict.probability, place.here)
    if place.here >= LEAST_PROBABILITY:
        return replace(verdict, probability=probability, warnings=doubts(own, place))
    why = f"{ANOTHER_PLACE if place.elsewhere > place.copy else COPY}, {_LOOKS_DIFFERENT}"
    return replace(
        verdict,
        probability=probability,
        held_back=0.0,
        refused=verdict.refused or (REPEATS if own.repeats else why),
        by_itself=True,
    )
