# SPDX-License-Identifier: BSD-3-Clause
"""Rooms that are copies of each other: whether two cameras stand where their pose says.

Doors, floors and furniture repeat from room to room, and two views of different rooms may agree on
a pose by all that they share. But what only one of the rooms has is missing in the other. Zach,
Irschara and Bischof (CVPR 2008, "What can missing correspondences tell us about 3D structure and
motion?") count points that a third view must see; here `place_evidence` also knows which of them
nothing hides, and compares pictures, so that a point counts which no detector finds again.

Whole surfaces are asked for too (`surface_evidence`), and what a pair shows by itself
(`own_evidence`). `place_court` compares three explanations of each pair by this, and
`place_verdict` says what follows.

Panoramas are put together by this, surest first (`place_groups`), so that a pair is judged by what
is known before it is believed. How many pairs are wrong the folder says itself: where many are,
they contradict what is surer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.graph.place_court import Court, Folder
from epi360.jobs.graph.place_evidence import Evidence
from epi360.jobs.graph.place_groups import Groups
from epi360.jobs.graph.place_verdict import ACCEPTED, PlaceVerdict, verdict_on
from epi360.places.own_evidence import OwnEvidence
from epi360.places.same_place import limited_in_folder
from epi360.places.shared_points import PosedPair

Array = NDArray[np.float64]
_Limits = tuple[float, float]

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
_FEW = 60  # pairs, which do not say how common copies are
_DOUBTED_WRONG = 0.5  # share of the poses that their own inliers leave a doubt about
_SPEAKS_AGAINST = -0.25  # a ratio
_MOST_STEPS = 300


@dataclass(frozen=True, eq=False)
class Judged:
    """``verdicts`` on the accepted pairs of a folder; what they say of other poses, if asked."""

    verdicts: tuple[PlaceVerdict, ...]
    _court: Court
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
        return _verdicts(court, groups, share_wrong, few=len(self.verdicts) < _FEW)


def judge_places(pairs: Sequence[PosedPair], evidence: Sequence[Evidence]) -> Judged:
    """Which accepted pairs, at least one, the surroundings speak against.

    Panoramas are put together by what is right with a probability of 0.95. How many pairs are
    wrong, and so how much that takes, the folder says itself (`_court_of_folder`): if its pairs
    agree it takes clear evidence to refuse one; if many are copies, a pair needs some for it.
    Few pairs do not say how common copies are: each of them must also be probable by itself, and by
    what the others say of it, as two panoramas that are compared alone must be. So must a pair of
    which a view is a part of the sphere, for few others know the same surroundings, and one in a
    corridor with equal doors, where pairs that are shifted by as many doors agree.
    """
    court, share_wrong = _court_of_folder(pairs, evidence)
    groups = court.groups(pairs, _least_ratio(share_wrong))
    verdicts = _verdicts(court, groups, share_wrong, few=len(pairs) < _FEW)
    return Judged(verdicts, court, groups, share_wrong)


def _court_of_folder(
    pairs: Sequence[PosedPair], evidence: Sequence[Evidence]
) -> tuple[Court, float]:
    """The court on accepted pairs, and the share of them that are wrong.

    All panoramas are put together first, as far as nothing contradicts. That tells how many pairs
    are wrong, too few of them: wrong ones may have been joined. So only those are put together that
    are right with a probability of 0.95, which tells too many: what is not joined cannot speak for
    others. The share is the geometric mean of both.

    Where copies are among the rooms, their pairs contradict the others, or the pictures are so
    clear that they show which pairs these are. There, what pairs show by themselves is weighed as
    in homes with copies; elsewhere, what pictures leave open is no sign of a copy.
    """
    court = Court(evidence, Folder(_mostly_in_the_open(evidence)))
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


def leave_a_doubt(pairs: Sequence[PosedPair], points: Sequence[Evidence]) -> bool:
    """Whether points speak against any pair, so that more should be known about all of them.

    Before anything else is known, no pair is surer than others. So all are heard about each, those
    too that may be wrong.
    """
    court = Court(points, Folder())
    everyone = np.ones(len(pairs), dtype=bool)
    return any(court.heard(row, everyone).ratio < _SPEAKS_AGAINST for row in range(len(pairs)))


def _verdicts(
    court: Court, groups: Groups, share_wrong: float, *, few: bool
) -> tuple[PlaceVerdict, ...]:
    """What is said about all pairs in the end, by their ratios."""
    probabilities = _probabilities(groups.ratios, share_wrong).tolist()
    alone = [few or each.own.is_partial or each.own.repeats for each in court.evidence]
    return tuple(
        verdict_on(court, row, groups, probability, by_itself=by_itself)
        for row, (probability, by_itself) in enumerate(zip(probabilities, alone, strict=True))
    )


def _mostly_in_the_open(evidence: Sequence[Evidence]) -> bool:
    """Whether most pairs show things at distances that differ more than in rooms."""
    known = [each.own.in_the_open for each in evidence if each.own.is_known]
    return 2 * sum(known) > len(known)


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
    return _log_odds(ACCEPTED) - _log_odds(1 - share_wrong)


def _probabilities(
    ratios: Array, share_wrong: float | Array, limits: _Limits = (-30.0, 30.0)
) -> Array:
    """Probability of each pose; 0 of those that contradict the groups."""
    odds = np.clip(ratios, *limits) + np.log(1 / np.asarray(share_wrong) - 1)
    return np.asarray(np.where(np.isneginf(ratios), 0.0, 1 / (1 + np.exp(-odds))))


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))
