# SPDX-License-Identifier: BSD-3-Clause
"""What is known about each pair of a folder: by the pairs that are believed, and by itself.

Points that other pairs know (`place_evidence`) and surfaces (`surface_evidence`) are asked for, and
what the pair shows by itself (`places.own_evidence`). Three explanations of a pose are compared: it
is right; it is that of a copy of the place, which shares most of its surfaces; it is that of
another place with a similar thing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.estimation.result import SamePlace
from epi360.jobs.graph.place_evidence import Evidence, Sightings
from epi360.jobs.graph.place_groups import Groups, Testimony, put_together
from epi360.jobs.graph.surface_evidence import FEWEST_PARTS, OWN, surfaces_ratio
from epi360.places.own_evidence import OwnEvidence
from epi360.places.same_place import limited, limited_in_folder, same_place
from epi360.places.shared_points import PosedPair

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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
# Of a few pairs, copies are thought to be more common than where only two panoramas are compared:
# there, no other pair speaks for a right one.
_COPIES_AMONG_FEW = 0.05
# So many of the wrong poses are between copies: 0.4 of those that matches determine in homes with
# twin rooms, and 0.5 where these are photographed. The others are of another place.
_OF_A_COPY = 0.5
# Of poses whose inliers all lie on the floor or on one wall 3 in 100 are right in homes with twin
# rooms, of others about every second one: as a ratio.
_RARE_ON_ONE_PLANE = 3.5


@dataclass(frozen=True, eq=False)
class Heard:
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

    def favoured_by(self, ratio: float) -> Heard:
        """Add evidence for the right pose, as a log-likelihood ratio, against all others."""
        return replace(self, logs=self.logs - np.where(np.arange(len(self.logs)) > 0, ratio, 0.0))


@dataclass(frozen=True)
class Folder:
    """What kind of folder it is: whether most pairs are in the open, and copies among the rooms."""

    in_the_open: bool = False
    has_copies: bool = False


class Court:
    """What is known about some pairs, by other pairs and by themselves.

    ``rates`` (3,) are the shares of the visible points of right pairs that look the same, by class
    of the view change; those that were measured, if None.
    """

    def __init__(
        self, evidence: Sequence[Evidence], folder: Folder, rates: Array | None = None
    ) -> None:
        rates = _RATES if rates is None else rates
        self._rates, self._folder = rates, folder
        self.evidence = [self._weighed(each) for each in evidence]
        self._own = [limited_in_folder(each.own, folder.in_the_open) for each in self.evidence]
        self._logs = [tuple(_logs(s, rates) for s in each.sides) for each in evidence]

    def _weighed(self, evidence: Evidence) -> Evidence:
        if not self._folder.has_copies:
            return evidence
        return replace(evidence, own=evidence.own.weighed_as_in_homes())

    def on(self, evidence: Sequence[Evidence]) -> Court:
        """The same court on other pairs."""
        return Court(evidence, self._folder, self._rates)

    def with_copies(self) -> Court:
        """The court if copies are among the rooms."""
        return Court(self.evidence, replace(self._folder, has_copies=True), self._rates)

    def with_rates(self, rates: Array) -> Court:
        """The court if such shares of what right pairs must show are found."""
        return Court(self.evidence, self._folder, rates)

    def groups(self, pairs: Sequence[PosedPair], least_ratio: float) -> Groups:
        """Panoramas that pairs put together, if so much speaks for them."""
        testimonies = [
            Testimony(each.siblings, _asked(each) - {row}) for row, each in enumerate(self.evidence)
        ]
        return put_together(pairs, testimonies, self.ratio, least_ratio)

    def ratio(self, row: int, trusted: Mask) -> float:
        """Log-likelihood ratio of a pair being right, by what trusted pairs know and by itself."""
        return _over_wrong(self.heard(row, trusted), self._own[row])

    def place(self, row: int, trusted: Mask) -> SamePlace:
        """What is thought of one of a few pairs, by itself and by what trusted pairs know."""
        heard, own = self.heard(row, trusted), limited(self.evidence[row].own)
        ratios = np.array([heard.ratio, heard.ratio_over_copies])
        if own.repeats:  # pairs that are shifted by a door agree
            ratios = np.minimum(ratios, 0.0)
        over_others, over_copies = ratios + (own.over_others, own.over_copies)
        return same_place(
            replace(own, over_others=float(over_others), over_copies=float(over_copies)),
            copies_indoors=_COPIES_AMONG_FEW,
        )

    def heard(self, row: int, trusted: Mask) -> Heard:
        """What trusted pairs say about one, by points and by surfaces."""
        heard = self.points_heard(row, trusted)
        return heard.favoured_by(surfaces_ratio(self.evidence[row].surfaces, trusted))

    def points_heard(self, row: int, trusted: Mask) -> Heard:
        """What trusted pairs say about one by the points that they know."""
        sides = self.evidence[row].sides
        heeded = [_must_be_seen(s, trusted) for s in sides]
        cells = np.concatenate([s.cells[kept] for s, kept in zip(sides, heeded, strict=True)])
        found = np.concatenate([s.found[kept] for s, kept in zip(sides, heeded, strict=True)])
        logs = np.concatenate(
            [all_logs[kept] for all_logs, kept in zip(self._logs[row], heeded, strict=True)]
        )
        means = _cell_means(cells, np.column_stack([logs, found]))
        logs = _POINTS_COUNT * means[:, :-1].sum(axis=0)
        heard = Heard(logs, len(means), float(means[:, -1].sum()))
        num_places = [len(np.unique(s.cells[kept])) for s, kept in zip(sides, heeded, strict=True)]
        # A door that one camera knows well matches all doors of its kind.
        one_sided = heard.ratio > 0.0 and min(num_places) < FEWEST_PARTS
        return replace(heard, logs=np.zeros(len(_SHARES))) if one_sided else heard

    def held_back(self, row: int, joined: Mask) -> float:
        """What speaks against a pair by itself, and does not count for whether it is accepted."""
        shown, counted = self.evidence[row].own, self._own[row]
        if shown.inliers_on_floor or shown.on_one_wall:
            return _RARE_ON_ONE_PLANE
        heard = self.heard(row, joined)
        over_others = min(limited(shown).over_others, counted.over_others)
        return _over_wrong(heard, counted) - _over_wrong(
            heard, replace(counted, over_others=over_others)
        )

    def points_against(self, row: int, trusted: Mask) -> Array:
        """What the points of each pair (N,) say against one, as a log-likelihood ratio."""
        logs = np.zeros((len(trusted), len(_SHARES)))
        for sightings, of_each in zip(self.evidence[row].sides, self._logs[row], strict=True):
            kept = _must_be_seen(sightings, trusted)
            np.add.at(logs, sightings.witnesses[kept], of_each[kept])
        against: Array = logs[:, 1:].max(axis=1) - logs[:, 0]
        return against

    def rates(self, trusted: Mask) -> Array:
        """Share of the visible points that trusted pairs find, by class of the view change."""
        counts, found = np.full(len(_RATES), _RATE_WEIGHT), _RATES * _RATE_WEIGHT
        for row in np.flatnonzero(trusted).tolist():
            for s in self.evidence[row].sides:
                kept = _must_be_seen(s, trusted)
                counts += np.bincount(s.changes[kept], minlength=len(_RATES))
                found += np.bincount(s.changes[kept], s.found[kept], minlength=len(_RATES))
        rates: Array = np.clip(found / counts, _RATES - _LOWER, _RATES + _HIGHER)
        return rates


def _over_wrong(heard: Heard, own: OwnEvidence) -> float:
    """Log-likelihood ratio of the right pose over a wrong one, of either kind."""
    over_others = heard.ratio + own.over_others
    over_copies = heard.ratio_over_copies + own.over_copies
    of_others, of_copies = np.log(1 - _OF_A_COPY) - over_others, np.log(_OF_A_COPY) - over_copies
    return -float(np.logaddexp(of_others, of_copies))


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
