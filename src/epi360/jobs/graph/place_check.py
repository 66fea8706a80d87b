# SPDX-License-Identifier: BSD-3-Clause
"""Rooms that are copies of each other: whether two panoramas stand where their pose says.

Doors, floors and furniture repeat from room to room, and two views of different rooms may agree on
a pose by all that they share. But what only one of the rooms has is missing in the other. Zach,
Irschara and Bischof (CVPR 2008, "What can missing correspondences tell us about 3D structure and
motion?") count points that a third view must see; here `place_evidence` also knows which of them
nothing hides, and compares pictures, so that a point counts which no detector finds again.

Whole surfaces are asked for too (`surface_evidence`), and what speaks against a pair counts
against those that say the same.

Three explanations of each accepted pair are compared: the pose is right; it is that of a copy of
the place, which shares most of its surfaces; it is that of another place with a similar thing. How
common each of them is, the folder says itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.graph.place_evidence import Evidence, Sightings
from epi360.jobs.graph.surface_evidence import OWN, surfaces_ratio

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
_TEMPER = 0.8  # cells are not quite independent
_MISTRUSTED = -1.0  # a pair with less than this is not asked about others
# Pairs are right, at copies, elsewhere: what is thought before the folder is seen.
_PRIOR = np.array([400.0, 0.1, 0.1])
# Least probability; in ten homes 8 wrong pairs pass 0.975, and 3 this, which costs 2 % of recall.
_ACCEPTED = 0.9875
_DOUBTED = 0.3  # least probability of a pose that is accepted if triangles with it close
# Pairs are heard first with all that are not mistrusted, then with those that are this probable.
_BELIEVED, _NUM_HEARINGS = 0.97, 4
# Pairs that say the same see much the same things, so only a share of it counts again; and only
# against them, because triangles confirm pairs already (`loop_check`).
_SIBLING_SHARE, _SIBLING_LIMITS = 0.5, (-4.0, 0.0)
_FEWEST_PLACES = 4  # of either view that must look the same before anything speaks for a pair
_MANY_ALIKE = 0.8  # share of the parts; a refusal does not rest on points then
_MOST_STEPS = 200

PLACE_CONFIRMED = "what must look the same leaves a doubt; triangles with other pairs close"
ANOTHER_PLACE, COPY = "shows another place", "may show a copy of the place"


@dataclass(frozen=True)
class PlaceVerdict:
    """What the surroundings say about a pair.

    ``probability`` is that of the pose, given that its matches agree. ``share`` is the share of
    ``num_places`` parts of the views that look the same, of those that both cameras must see.
    """

    probability: float = 1.0
    share: float = np.nan
    num_places: int = 0
    refused: str = ""

    @property
    def if_accepted(self) -> float:
        """Probability of a pose that is accepted: triangles confirm what leaves a doubt."""
        return max(self.probability, _ACCEPTED)

    @property
    def leaves_a_doubt(self) -> bool:
        """Whether other pairs may confirm a pose that is refused."""
        return bool(self.refused) and self.probability >= _DOUBTED


def judge_places(
    images: Sequence[tuple[int, int]], evidence: Sequence[Evidence]
) -> tuple[PlaceVerdict, ...]:
    """Which accepted pairs the surroundings speak against.

    Pairs witness against each other, so those whose evidence is worst lose their say one by one.
    What the others say is weighed; and then again, with only those pairs as witnesses that it has
    found right. What is said last counts: at a panorama all of whose pairs are wrong, they speak
    for each other until nobody believes them. A pair is refused if its pose is less probable than
    0.9875. In a folder whose pairs all look right that takes clear evidence against it; in one with
    many copies, a pair needs some for it.
    """
    if len(images) == 0:
        return ()
    rates = _RATES
    for _ in range(2):
        court = _Court(images, evidence, rates)
        trusted = court.trusted()
        rates = court.rates(trusted)
    own_ratios = [each.own_ratio for each in evidence]
    believed = trusted
    for _ in range(_NUM_HEARINGS):
        heard = [court.all_heard(row, believed) for row in range(len(images))]
        heard = _with_siblings(heard, evidence, believed)
        probabilities = _probabilities(heard, own_ratios)
        believed = probabilities >= _BELIEVED
    return tuple(
        _verdict(each, float(probability))
        for each, probability in zip(heard, probabilities, strict=True)
    )


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

    def favoured_by(self, ratio: float) -> _Heard:
        """Add evidence for the right pose, as a log-likelihood ratio, against all others."""
        return replace(self, logs=self.logs - np.where(np.arange(len(self.logs)) > 0, ratio, 0.0))


class _Court:
    """Evidence on all pairs, and who is believed."""

    def __init__(
        self, images: Sequence[tuple[int, int]], evidence: Sequence[Evidence], rates: Array
    ) -> None:
        self.images = images
        self.sides = [each.sides for each in evidence]
        self.surfaces = [each.surfaces for each in evidence]
        self.logs = [tuple(_logs(s, rates, _SHARES) for s in sides) for sides in self.sides]
        self.at: dict[int, set[int]] = {}
        for row, pair in enumerate(images):
            for image in pair:
                self.at.setdefault(image, set()).add(row)

    def heard(self, row: int, trusted: Mask) -> _Heard:
        """What trusted pairs say about one by the points that they know."""
        sides = self.sides[row]
        heeded = [_must_be_seen(s, trusted) for s in sides]
        cells = np.concatenate([s.cells[kept] for s, kept in zip(sides, heeded, strict=True)])
        found = np.concatenate([s.found[kept] for s, kept in zip(sides, heeded, strict=True)])
        logs = np.concatenate(
            [all_logs[kept] for all_logs, kept in zip(self.logs[row], heeded, strict=True)]
        )
        means = _cell_means(cells, np.column_stack([logs, found]))
        heard = _Heard(means[:, :-1].sum(axis=0), len(means), float(means[:, -1].sum()))
        num_places = [len(np.unique(s.cells[kept])) for s, kept in zip(sides, heeded, strict=True)]
        # A door that one camera knows well matches all doors of its kind.
        one_sided = heard.ratio > 0.0 and min(num_places) < _FEWEST_PLACES
        return replace(heard, logs=np.zeros(len(_SHARES))) if one_sided else heard

    def all_heard(self, row: int, trusted: Mask) -> _Heard:
        """What trusted pairs say about one, by points and by surfaces."""
        heard = self.heard(row, trusted)
        return heard.favoured_by(surfaces_ratio(self.surfaces[row], trusted))

    def trusted(self) -> Mask:
        """Pairs that are believed: the worst is left out until none is mistrusted."""
        trusted = np.ones(len(self.images), dtype=bool)
        ratios = np.array([self.heard(row, trusted).ratio for row in range(len(trusted))])
        while True:
            worst = int(np.argmin(np.where(trusted, ratios, np.inf)))
            if not trusted[worst] or ratios[worst] >= _MISTRUSTED:
                return trusted
            trusted[worst] = False
            for row in set().union(*(self.at[image] for image in self.images[worst])):
                if trusted[row]:
                    ratios[row] = self.heard(row, trusted).ratio

    def rates(self, trusted: Mask) -> Array:
        """Share of the visible points that trusted pairs find, by class of the view change."""
        counts, found = np.full(len(_RATES), _RATE_WEIGHT), _RATES * _RATE_WEIGHT
        for row in np.flatnonzero(trusted):
            for s in self.sides[row]:
                kept = _must_be_seen(s, trusted)
                counts += np.bincount(s.changes[kept], minlength=len(_RATES))
                found += np.bincount(s.changes[kept], s.found[kept], minlength=len(_RATES))
        rates: Array = np.clip(found / counts, _RATES - _LOWER, _RATES + _HIGHER)
        return rates


def _with_siblings(
    heard: Sequence[_Heard], evidence: Sequence[Evidence], believed: Mask
) -> list[_Heard]:
    """What is said against pairs that say the same counts against each of them."""
    ratios = np.array([h.ratio + e.own_ratio for h, e in zip(heard, evidence, strict=True)])
    told = []
    for each, of in zip(heard, evidence, strict=True):
        rows = sorted({sibling.pair for sibling in of.siblings if believed[sibling.via]})
        ratio = float(np.clip(_SIBLING_SHARE * ratios[rows].sum(), *_SIBLING_LIMITS))
        told.append(each.favoured_by(ratio))
    return told


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


def _logs(sightings: Sightings, rates: Array, shares: Array) -> Array:
    """Log-likelihood (N, K) of each sighting if such shares of the surfaces are the same."""
    right = rates[sightings.changes][:, None]
    found = shares * right + (1 - shares) * _CHANCE
    logs: Array = np.log(np.where(sightings.found[:, None], found, 1 - found))
    return logs


def _cell_means(cells: NDArray[np.int64], values: Array) -> Array:
    """Mean of the values (N, K) in each cell that has any."""
    _, group = np.unique(cells, return_inverse=True)
    counts = np.bincount(group)
    means = [np.bincount(group, column) / counts for column in values.T]
    return np.stack(means, axis=1) if len(counts) else np.zeros((0, values.shape[1]))


def _probabilities(heard: Sequence[_Heard], own_ratios: Sequence[float]) -> Array:
    """Probability of each pose; how common copies are is estimated along (EM)."""
    copies = np.array([each.logs[_OF_COPIES].max() - each.logs[0] for each in heard])
    elsewhere = np.array([-each.ratio for each in heard]) - np.array(own_ratios)
    logs = _TEMPER * np.stack([np.zeros(len(heard)), copies, elsewhere], axis=1)
    common = _PRIOR / _PRIOR.sum()
    for _ in range(_MOST_STEPS):
        weighted = logs + np.log(common)
        odds = np.exp(weighted - weighted.max(axis=1, keepdims=True))
        posterior = odds / odds.sum(axis=1, keepdims=True)
        updated = (posterior.sum(axis=0) + _PRIOR) / (len(heard) + _PRIOR.sum())
        if np.abs(updated - common).max() < 1e-6:
            break
        common = updated
    probabilities: Array = posterior[:, 0]
    return probabilities


def _verdict(heard: _Heard, probability: float) -> PlaceVerdict:
    share = heard.num_alike / heard.num_places if heard.num_places else np.nan
    refused = ""
    if probability < _ACCEPTED:
        refused = _refusal(heard)
    return PlaceVerdict(probability, share, heard.num_places, refused)


def _refusal(heard: _Heard) -> str:
    """Why a pair is not accepted; what stands before the comma is what summaries count."""
    if heard.ratio >= 0.0:
        return (
            f"{COPY}, as other pairs of this folder do, and too little of what both cameras must "
            "see says otherwise"
        )
    if heard.num_alike >= _MANY_ALIKE * heard.num_places:
        return f"{ANOTHER_PLACE}, for surfaces differ that both cameras must see"
    return (
        f"{ANOTHER_PLACE}, for only {int(heard.num_alike)} of {heard.num_places} parts of the "
        "views that both cameras must see look the same"
    )
