# SPDX-License-Identifier: BSD-3-Clause
"""Rooms that are copies of each other: whether two cameras stand where their pose says.

Doors, floors and furniture repeat from room to room, and two views of different rooms may agree on
a pose by all that they share. But what only one of the rooms has is missing in the other. Zach,
Irschara and Bischof (CVPR 2008, "What can missing correspondences tell us about 3D structure and
motion?") count points that a third view must see; here `place_evidence` also knows which of them
nothing hides, and compares pictures, so that a point counts which no detector finds again.

Whole surfaces are asked for too (`surface_evidence`), and what a pair shows by itself
(`own_evidence`). Three explanations of each accepted pair are compared: the pose is right; it is
that of a copy of the place, which shares most of its surfaces; it is that of another place with a
similar thing.

Panoramas are put together by this, surest first (`place_groups`), so that a pair is judged by what
is known before it is believed. How many pairs are wrong the folder says itself: where many are,
they contradict what is surer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.result import SamePlace
from epi360.jobs.graph.place_evidence import Evidence, Sightings
from epi360.jobs.graph.place_groups import Groups, Testimony, put_together
from epi360.jobs.graph.surface_evidence import (
    FEWEST_PARTS,
    OWN,
    surfaces_against,
    surfaces_ratio,
)
from epi360.places.own_evidence import OwnEvidence
from epi360.places.same_place import (
    LEAST_PROBABILITY,
    doubts,
    limited,
    limited_in_folder,
    same_place,
)
from epi360.places.shared_points import PosedPair

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
_Limits = tuple[float, float]

# Share of the visible points of right pairs that look the same, by class of the view change;
# measured on rendered homes and on a real tour, which differ by 0.03. The folder's own sure pairs
# correct it, by as much as this allows.
_RATES = np.array([0.95, 0.90, 0.85])
_LOWER, _HIGHER, _RATE_WEIGHT = 0.10, 0.03, 100.0
_CHANCE = 0.12  # of another thing to look the same
# Shares of the surfaces that are the same: all if the pose is right, 0.5 to 0.8 in a copy of the
# place, any of these elsewhere.
_SHARES = np.array([1.0, 0.8, 0.65, 0.5, 0.3, 0.1])
_OF_COPIES = slice(1, 4)
_HIDDEN = 0.2  # log of distances: a point so much behind what the camera sees may be hidden
# Parts of a view are not independent witnesses: points are known where matches were found, which
# copies share. Beside what pairs show by themselves, regression weighs them by 0.1 to 0.3.
_POINTS_COUNT = 0.25
# If more than this share of a folder's loops contradict, there are copies among its rooms: in homes
# with twin rooms 0.3 to 0.75 do, in real tours up to 0.02. Few loops say little: five are added.
_CONTRADICTING, _MORE_LOOPS = 0.2, 5.0
# Or the pictures are so clear that the surest tenth of the pairs has so much over a copy; of few
# pairs the surest one.
_SUREST, _CLEAR = 0.9, 6.0
# A ratio outside these says no more about the folder, first with all pairs joined, then with the
# sure ones. Without copies, a low ratio is the pictures' fault.
_WITH_COPIES = ((-3.0, 8.0), (-3.0, 8.0))
_WITHOUT_COPIES = ((-0.85, 8.0), (-1.5, 8.0))
# What is thought before the folder is seen: so many of so many pairs are wrong.
_PRIOR_WRONG, _PRIOR_PAIRS = 0.1, 30.0
_FEW = 10  # pairs, which do not say how common copies are
# So they are thought to be more common than where only two panoramas are compared: there, no other
# pair speaks for a right one.
_COPIES_AMONG_FEW = 0.05
_ACCEPTED = 0.95  # least probability
_DOUBTED_WRONG = 0.5  # share of the poses that their own inliers leave a doubt about
_DOUBTED = 0.3  # least probability of a pose that is accepted if triangles with it close
_SPEAKS_AGAINST = -0.25  # a ratio
# So many of the wrong poses are between copies: 0.4 of those that matches determine in homes with
# twin rooms, and 0.5 where these are photographed. The others are of another place.
_OF_A_COPY = 0.5
# Of poses whose inliers all lie on the floor or on one wall 3 in 100 are right in homes with twin
# rooms, of others about every second one: as a ratio.
_RARE_ON_ONE_PLANE = 3.5
_MOST_STEPS = 300

PLACE_CONFIRMED = "what must look the same leaves a doubt; triangles with other pairs close"
PLACE_AGREES = "the inliers alone leave a doubt; the pose is accepted for its surroundings"
ANOTHER_PLACE, COPY = "shows another place", "may show a copy of the place"


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
        return max(self.probability, _ACCEPTED) if self.refused else self.probability

    @property
    def if_refused(self) -> float:
        """Probability of a pose that is refused: all that speaks against it counts."""
        wrong = (1 - self.probability) * np.exp(self.held_back)
        return float(self.probability / (self.probability + wrong))

    @property
    def leaves_a_doubt(self) -> bool:
        """Whether other pairs may confirm a pose that is refused."""
        return bool(self.refused) and not self.by_itself and self.probability >= _DOUBTED


@dataclass(frozen=True, eq=False)
class Judged:
    """``verdicts`` on the accepted pairs of a folder; what they say of other poses, if asked."""

    verdicts: tuple[PlaceVerdict, ...]
    _court: _Court
    _groups: Groups
    _share_wrong: float

    def on_doubted(self, evidence: Sequence[Evidence]) -> tuple[PlaceVerdict, ...]:
        """Verdicts on poses that are not accepted yet; half of such poses are wrong.

        They say nothing about each other, nor about the accepted pairs.
        """
        court = self._court.on(evidence)
        joined = self._groups.joined
        ratios = np.array([court.ratio(row, joined) for row in range(len(evidence))])
        share_wrong = max(self._share_wrong, _DOUBTED_WRONG)
        groups = replace(self._groups, ratios=ratios, ways={})
        return court.verdicts(groups, share_wrong, few=len(self.verdicts) < _FEW)


def judge_places(pairs: Sequence[PosedPair], evidence: Sequence[Evidence]) -> Judged:
    """Which accepted pairs, at least one, the surroundings speak against.

    Panoramas are put together by what is right with a probability of 0.95. How many pairs are
    wrong, and so how much that takes, the folder says itself (`_court_of_folder`): if its pairs
    agree it takes clear evidence to refuse one; if many are copies, a pair needs some for it.
    Few pairs do not say how common copies are: each of them must also be probable by itself, and by
    what the others say of it, as two panoramas that are compared alone must be. So must a pair of
    which a view is a part of the sphere, for few others know the same surroundings.
    """
    court, share_wrong = _court_of_folder(pairs, evidence)
    groups = court.groups(pairs, _least_ratio(share_wrong))
    few = len(pairs) < _FEW
    verdicts = court.verdicts(groups, share_wrong, few=few)
    return Judged(verdicts, court, groups, share_wrong)


def _court_of_folder(
    pairs: Sequence[PosedPair], evidence: Sequence[Evidence]
) -> tuple[_Court, float]:
    """The court on accepted pairs, and the share of them that are wrong.

    All panoramas are put together first, as far as nothing contradicts. That tells how many pairs
    are wrong, too few of them: wrong ones may have been joined. So only those are put together that
    are right with a probability of 0.95, which tells too many: what is not joined cannot speak for
    others. The share is the geometric mean of both.

    Where copies are among the rooms, their pairs contradict the others, or the pictures are so
    clear that they show which pairs these are. There, what pairs show by themselves is weighed as
    in homes with copies; elsewhere, what pictures leave open is no sign of a copy.
    """
    court = _Court(evidence, _RATES, _Folder(_mostly_in_the_open(evidence)))
    groups = court.groups(pairs, -np.inf)
    has_copies = _contradict(groups) or _are_clear([each.own for each in evidence])
    if has_copies:
        court = court.with_copies()
        groups = court.groups(pairs, -np.inf)
    before, after = _WITH_COPIES if has_copies else _WITHOUT_COPIES
    share_wrong = _share_wrong(groups.ratios, before)
    if groups.ratios.min() < _least_ratio(share_wrong):
        groups = court.groups(pairs, _least_ratio(share_wrong))
        share_wrong = float(np.sqrt(share_wrong * _share_wrong(groups.ratios, after)))
    return court.with_rates(court.rates(groups.joined)), share_wrong


def _by_itself(verdict: PlaceVerdict, own: OwnEvidence, place: SamePlace) -> PlaceVerdict:
    """The verdict on one of few pairs, which must be probable by what it shows itself, too."""
    probability = min(verdict.probability, place.here)
    if place.here >= LEAST_PROBABILITY:
        return replace(verdict, probability=probability, warnings=doubts(own, place))
    why = ANOTHER_PLACE if place.elsewhere > place.copy else COPY
    return replace(
        verdict,
        probability=probability,
        held_back=0.0,
        refused=f"{why}, for what surrounds the matches looks different",
        by_itself=True,
        against=(),
    )


def leave_a_doubt(pairs: Sequence[PosedPair], points: Sequence[Evidence]) -> bool:
    """Whether points speak against any pair, so that more should be known about all of them.

    Before anything else is known, no pair is surer than others. So all are heard about each, those
    too that may be wrong.
    """
    court = _Court(points, _RATES, _Folder())
    everyone = np.ones(len(pairs), dtype=bool)
    return any(court.heard(row, everyone).ratio < _SPEAKS_AGAINST for row in range(len(pairs)))


@dataclass(frozen=True, eq=False)
class _Heard:
    """Log-likelihood of each of `_SHARES`, and how many places look the same."""

    logs: Array
    num_places: int
    num_alike: float

    @property
    def ratio(self) -> float:
        """Log-likelihood ratio of the right pose over any other."""
        return float(self.logs[0] - self.logs[1:].max())

    @property
    def ratio_over_copies(self) -> float:
        """Log-likelihood ratio of the right pose over that of a copy of the place."""
        return float(self.logs[0] - self.logs[_OF_COPIES].max())

    def favoured_by(self, ratio: float) -> _Heard:
        """Add evidence for the right pose, as a log-likelihood ratio, against all others."""
        return replace(self, logs=self.logs - np.where(np.arange(len(self.logs)) > 0, ratio, 0.0))


@dataclass(frozen=True)
class _Folder:
    """What kind of folder it is: whether most pairs are in the open, and copies among the rooms."""

    in_the_open: bool = False
    has_copies: bool = False


class _Court:
    """What is known about some pairs, by other pairs and by themselves."""

    def __init__(self, evidence: Sequence[Evidence], rates: Array, folder: _Folder) -> None:
        self._rates, self._folder = rates, folder
        self._evidence = [self._weighed(each) for each in evidence]
        self._own = [limited_in_folder(each.own, folder.in_the_open) for each in self._evidence]
        self._logs = [tuple(_logs(s, rates) for s in each.sides) for each in evidence]

    def _weighed(self, evidence: Evidence) -> Evidence:
        if not self._folder.has_copies:
            return evidence
        return replace(evidence, own=evidence.own.weighed_as_in_homes())

    def on(self, evidence: Sequence[Evidence]) -> _Court:
        """The same court on other pairs."""
        return _Court(evidence, self._rates, self._folder)

    def with_copies(self) -> _Court:
        """The court if copies are among the rooms."""
        return _Court(self._evidence, self._rates, replace(self._folder, has_copies=True))

    def with_rates(self, rates: Array) -> _Court:
        """The court if such shares of what right pairs must show are found."""
        return _Court(self._evidence, rates, self._folder)

    def groups(self, pairs: Sequence[PosedPair], least_ratio: float) -> Groups:
        """Panoramas that pairs put together, if so much speaks for them."""
        testimonies = [
            Testimony(each.siblings, _asked(each) - {row})
            for row, each in enumerate(self._evidence)
        ]
        return put_together(pairs, testimonies, self.ratio, least_ratio)

    def ratio(self, row: int, trusted: Mask) -> float:
        """Log-likelihood ratio of a pair being right, by what trusted pairs know and by itself."""
        return _over_wrong(self.heard(row, trusted), self._own[row])

    def place(self, row: int, trusted: Mask) -> SamePlace:
        """What is thought of one of a few pairs, by itself and by what trusted pairs know."""
        heard, own = self.heard(row, trusted), limited(self._evidence[row].own)
        return same_place(
            replace(
                own,
                over_others=own.over_others + heard.ratio,
                over_copies=own.over_copies + heard.ratio_over_copies,
            ),
            copies_indoors=_COPIES_AMONG_FEW,
        )

    def heard(self, row: int, trusted: Mask) -> _Heard:
        """What trusted pairs say about one, by points and by surfaces."""
        heard = self._points_heard(row, trusted)
        return heard.favoured_by(surfaces_ratio(self._evidence[row].surfaces, trusted))

    def _points_heard(self, row: int, trusted: Mask) -> _Heard:
        sides = self._evidence[row].sides
        heeded = [_must_be_seen(s, trusted) for s in sides]
        cells = np.concatenate([s.cells[kept] for s, kept in zip(sides, heeded, strict=True)])
        found = np.concatenate([s.found[kept] for s, kept in zip(sides, heeded, strict=True)])
        logs = np.concatenate(
            [all_logs[kept] for all_logs, kept in zip(self._logs[row], heeded, strict=True)]
        )
        means = _cell_means(cells, np.column_stack([logs, found]))
        logs = _POINTS_COUNT * means[:, :-1].sum(axis=0)
        heard = _Heard(logs, len(means), float(means[:, -1].sum()))
        num_places = [len(np.unique(s.cells[kept])) for s, kept in zip(sides, heeded, strict=True)]
        # A door that one camera knows well matches all doors of its kind.
        one_sided = heard.ratio > 0.0 and min(num_places) < FEWEST_PARTS
        return replace(heard, logs=np.zeros(len(_SHARES))) if one_sided else heard

    def verdicts(
        self, groups: Groups, share_wrong: float, *, few: bool
    ) -> tuple[PlaceVerdict, ...]:
        """What is said about all pairs in the end, by their ratios."""
        probabilities = _probabilities(groups.ratios, share_wrong).tolist()
        verdicts = tuple(self._verdict(row, groups, each) for row, each in enumerate(probabilities))
        return tuple(
            _by_itself(verdict, each.own, self.place(row, groups.joined))
            if (few or each.own.is_partial) and each.own.is_known
            else verdict
            for row, (verdict, each) in enumerate(zip(verdicts, self._evidence, strict=True))
        )

    def _verdict(self, row: int, groups: Groups, probability: float) -> PlaceVerdict:
        points = self._points_heard(row, groups.joined)
        share = points.num_alike / points.num_places if points.num_places else np.nan
        is_refused = probability < _ACCEPTED
        refused, against = self._refusal(row, groups, points) if is_refused else ("", ())
        held_back = self._held_back(row, groups.joined)
        return PlaceVerdict(
            probability, share, points.num_places, refused, held_back=held_back, against=against
        )

    def _held_back(self, row: int, joined: Mask) -> float:
        """What speaks against a pair by itself, and does not count for whether it is accepted."""
        shown, counted = self._evidence[row].own, self._own[row]
        if shown.on_floor or shown.on_one_wall:
            return _RARE_ON_ONE_PLANE
        heard = self.heard(row, joined)
        over_others = min(limited(shown).over_others, counted.over_others)
        return _over_wrong(heard, counted) - _over_wrong(
            heard, replace(counted, over_others=over_others)
        )

    def _refusal(self, row: int, groups: Groups, points: _Heard) -> tuple[str, tuple[int, ...]]:
        """Why a pair is not accepted, and by which pairs.

        What stands before the comma is what summaries count.
        """
        joined, told = groups.joined, groups.ratios[row]
        if np.isneginf(told):
            return (
                f"{ANOTHER_PLACE}, for pairs that more speaks for turn its panoramas otherwise",
                tuple(groups.ways[row]),
            )
        if told < (alone := self.ratio(row, joined)) and alone >= 0.0:
            return f"{COPY}, for too little speaks for pairs that say the same", ()
        if points.ratio < 0.0:
            return (
                f"{ANOTHER_PLACE}, for only {int(points.num_alike)} of {points.num_places} parts "
                "of the views that both cameras must see look the same",
                _surest(self._points_against(row, joined)),
            )
        surfaces = self._evidence[row].surfaces
        if surfaces_ratio(surfaces, joined) < 0.0:
            return (
                f"{ANOTHER_PLACE}, for surfaces differ that both cameras must see",
                _surest(surfaces_against(surfaces, joined)),
            )
        return f"{COPY}, and too little of what both cameras must see says otherwise", ()

    def _points_against(self, row: int, trusted: Mask) -> Array:
        """What the points of each pair (N,) say against one, as a log-likelihood ratio."""
        logs = np.zeros((len(trusted), len(_SHARES)))
        for sightings, of_each in zip(self._evidence[row].sides, self._logs[row], strict=True):
            kept = _must_be_seen(sightings, trusted)
            np.add.at(logs, sightings.witnesses[kept], of_each[kept])
        against: Array = logs[:, 1:].max(axis=1) - logs[:, 0]
        return against

    def rates(self, trusted: Mask) -> Array:
        """Share of the visible points that trusted pairs find, by class of the view change."""
        counts, found = np.full(len(_RATES), _RATE_WEIGHT), _RATES * _RATE_WEIGHT
        for row in np.flatnonzero(trusted).tolist():
            for s in self._evidence[row].sides:
                kept = _must_be_seen(s, trusted)
                counts += np.bincount(s.changes[kept], minlength=len(_RATES))
                found += np.bincount(s.changes[kept], s.found[kept], minlength=len(_RATES))
        rates: Array = np.clip(found / counts, _RATES - _LOWER, _RATES + _HIGHER)
        return rates


def _over_wrong(heard: _Heard, own: OwnEvidence) -> float:
    """Log-likelihood ratio of the right pose over a wrong one, of either kind."""
    over_others = heard.ratio + own.over_others
    over_copies = heard.ratio_over_copies + own.over_copies
    of_others, of_copies = np.log(1 - _OF_A_COPY) - over_others, np.log(_OF_A_COPY) - over_copies
    return -float(np.logaddexp(of_others, of_copies))


def _mostly_in_the_open(evidence: Sequence[Evidence]) -> bool:
    """Whether most pairs show things at distances that differ more than in rooms."""
    known = [each.own.in_the_open for each in evidence if each.own.is_known]
    return 2 * sum(known) > len(known)


def _must_be_seen(sightings: Sightings, trusted: Mask) -> Mask:
    """Points of trusted pairs that nothing hides, as far as trusted pairs know."""
    if len(sightings.witnesses) == 0:
        return np.zeros(0, dtype=bool)
    is_heeded = (sightings.sources == OWN) | trusted[sightings.sources]
    beyond = sightings.beyond[:, is_heeded]
    known = np.where(np.isnan(beyond), -np.inf, beyond)
    farthest = known.max(axis=1, initial=-np.inf)
    seen: Mask = np.isfinite(farthest) & (farthest < _HIDDEN) & trusted[sightings.witnesses]
    return seen


def _surest(against: Array) -> tuple[int, ...]:
    """Rows of the pairs that speak against a pose, those that say most first."""
    rows = np.argsort(-against, kind="stable")
    return tuple(rows[against[rows] > 0.0].tolist())


def _asked(evidence: Evidence) -> set[int]:
    """Pairs that know something that was looked for, or hides it."""
    asked = {OWN}
    for side in evidence.sides:
        asked.update(np.unique(side.witnesses).tolist(), side.sources.tolist())
    for view in evidence.surfaces:
        asked.update(np.unique(view.witnesses).tolist(), view.sources.tolist())
    return asked - {OWN}


def _logs(sightings: Sightings, rates: Array) -> Array:
    """Log-likelihood (N, K) of each sighting if such shares of the surfaces are the same."""
    right = rates[sightings.changes][:, None]
    found = _SHARES * right + (1 - _SHARES) * _CHANCE
    logs: Array = np.log(np.where(sightings.found[:, None], found, 1 - found))
    return logs


def _cell_means(cells: NDArray[np.int64], values: Array) -> Array:
    """Mean of the values (N, K) in each cell that has any."""
    _, group = np.unique(cells, return_inverse=True)
    counts = np.bincount(group)
    means = [np.bincount(group, column) / counts for column in values.T]
    return np.stack(means, axis=1) if len(counts) else np.zeros((0, values.shape[1]))


def _are_clear(shown: Sequence[OwnEvidence]) -> bool:
    """Whether pictures show so much as clear ones do, by the surest tenth of the pairs."""
    told = [each.as_in_homes[1] for each in shown if limited_in_folder(each) != OwnEvidence()]
    return len(told) > 0 and bool(np.quantile(told, _SUREST, method="higher") >= _CLEAR)


def _contradict(groups: Groups) -> bool:
    """Whether so many loops contradict that copies must be among the rooms."""
    return groups.num_contradicting / (groups.num_loops + _MORE_LOOPS) > _CONTRADICTING


def _share_wrong(ratios: Array, limits: _Limits) -> float:
    """Share of the pairs of a folder that are wrong, by the ratios of all (EM)."""
    share = _PRIOR_WRONG / _PRIOR_PAIRS
    for _ in range(_MOST_STEPS):
        wrong = float(np.sum(1 - _probabilities(ratios, share, limits)))
        updated = (wrong + _PRIOR_WRONG) / (len(ratios) + _PRIOR_PAIRS)
        if abs(updated - share) < 1e-6:
            break
        share = updated
    return share


def _least_ratio(share_wrong: float) -> float:
    """Ratio of a pair that is just accepted."""
    return _log_odds(_ACCEPTED) - _log_odds(1 - share_wrong)


def _probabilities(
    ratios: Array, share_wrong: float | Array, limits: _Limits = (-30.0, 30.0)
) -> Array:
    """Probability of each pose; 0 of those that contradict the groups."""
    odds = np.clip(ratios, *limits) + np.log(1 / np.asarray(share_wrong) - 1)
    return np.asarray(np.where(np.isneginf(ratios), 0.0, 1 / (1 + np.exp(-odds))))


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))
