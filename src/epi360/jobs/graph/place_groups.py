# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas of one place, put together pair by pair, surest first.

A pair of two copies of a room has matched what both have, so what it knows is found in both again,
and it witnesses for all other pairs that take them for one room. What pairs within one copy know
is not. So panoramas are put together to groups, as in agglomerative clustering, and whether two
groups belong together is decided by what pairs within each of them know. All pairs that say the
same about two groups are right or wrong together, and are weighed together. What turns a panorama
otherwise than its group does contradicts it.

What all other pairs of the folder know, right and wrong ones, counts a little: it is hearsay, but
where no group knows anything yet it tells where to begin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.jobs.graph.surface_evidence import Sibling
from epi360.places.shared_points import PosedPair
from epi360.poses import rotation_error_deg

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
GroupPair = tuple[int, int]

# What pairs say that agree is not independent: their correlation.
_CORRELATION = 0.15
# A poor pose among good ones says no more against a claim than this, and is not heard about others.
_LEAST_OF_ONE = -4.0
# What all others say about a claim, right and wrong ones, counts too: this share of it, limited.
_HEARSAY_SHARE, _MOST_HEARSAY = 0.6, 6.0
# A pair contradicts its group if it turns a camera otherwise by more than so many degrees and
# sigmas of all rotations on the way.
_AGREES_DEG, _NUM_SIGMAS = 5.0, 3.0
_LEAST_SIGMA_DEG = 0.5  # of a rotation


@dataclass(frozen=True, eq=False)
class Testimony:
    """What is known about a pair besides its pose.

    ``siblings`` are pairs that say the same if a third one is right; ``witnesses`` are the pairs of
    which its ratio depends on whether they are believed.
    """

    siblings: Sequence[Sibling]
    witnesses: Set[int]


@dataclass(frozen=True, eq=False)
class Groups:
    """How pairs put panoramas together.

    ``joined`` (N,) are the pairs that the groups rest on. ``ratios`` (N,) are log-likelihood ratios
    of each pair being right, together with those that say the same; minus infinity for what
    contradicts the groups; ``ways`` has the pairs that lead from one of its panoramas to the other.
    ``num_loops`` are the pairs within groups beyond those that it takes to join their panoramas.
    """

    joined: Mask
    ratios: Array
    ways: Mapping[int, Sequence[int]]
    num_loops: int

    @property
    def num_contradicting(self) -> int:
        """How many pairs contradict the groups."""
        return int(np.count_nonzero(np.isneginf(self.ratios)))


@dataclass(frozen=True, eq=False)
class _Claim:
    """Pairs that say the same about two groups, and the surest of them."""

    rows: Sequence[int]
    ratio: float
    surest: int


def put_together(
    pairs: Sequence[PosedPair],
    testimonies: Sequence[Testimony],
    ratio_of: Callable[[int, Mask], float],
    least_ratio: float,
) -> Groups:
    """Join groups by the claim that most speaks for, until nothing speaks enough for any.

    ``ratio_of`` gives a pair's log-likelihood ratio by what the pairs of a mask know, those that
    have been joined so far.
    """
    assembly = _Assembly(pairs, testimonies, ratio_of, least_ratio)
    while assembly.join_surest():
        pass
    return assembly.result()


class _Assembly:
    """Groups while they grow; each is named by its first panorama."""

    def __init__(
        self,
        pairs: Sequence[PosedPair],
        testimonies: Sequence[Testimony],
        ratio_of: Callable[[int, Mask], float],
        least_ratio: float,
    ) -> None:
        self._pairs, self._testimonies = pairs, testimonies
        self._ratio_of, self._least = ratio_of, least_ratio
        self._joined = np.zeros(len(pairs), dtype=bool)
        self._said = np.full(len(pairs), np.nan)
        self._ratios = np.full(len(pairs), np.nan)  # NaN: a witness has been joined since
        self._hearsay: dict[tuple[int, ...], float] = {}  # of pairs that say the same
        self._asked_by: list[set[int]] = [set() for _ in pairs]
        for row, testimony in enumerate(testimonies):
            for witness in testimony.witnesses:
                self._asked_by[witness].add(row)
        images = sorted({image for pair in pairs for image in pair.images})
        self._group_of = {image: image for image in images}
        self._members = {image: [image] for image in images}
        self._turns: dict[int, Array] = {image: np.eye(3) for image in images}  # from the group
        self._tree: dict[int, list[tuple[int, int]]] = {image: [] for image in images}
        self._undecided: list[int] = []  # of pairs within groups
        self._ways: dict[int, list[int]] = {}  # of pairs that contradict theirs
        self._between: dict[GroupPair, list[int]] = {}
        for row in range(len(pairs)):
            self._between.setdefault(self._groups_of(row), []).append(row)
        self._claims = {groups: self._claims_of(groups) for groups in self._between}

    def join_surest(self) -> bool:
        """Join the two groups that most speaks for; False if that is too little."""
        claims = ((claim, groups) for groups, told in self._claims.items() for claim in told)
        surest = max(claims, key=lambda each: each[0].ratio, default=None)
        if surest is None or surest[0].ratio < self._least:
            return False
        self._join(*surest)
        return True

    def result(self) -> Groups:
        """What has been joined, and what is said about all pairs."""
        for claims in self._claims.values():
            for claim in claims:
                for row in claim.rows:
                    self._said[row] = min(claim.ratio, self._ratio(row))
        rows = range(len(self._pairs))
        joined = np.flatnonzero(self._joined).tolist()
        poor = {row for row in joined if self._ratio(row) < _LEAST_OF_ONE}
        # These are heard again, for more has been joined since; or joined pairs imply them.
        for row in (*self._undecided, *sorted(poor)):
            implied = [self._said[pair] for pair in self._implying(row) if pair not in poor]
            self._said[row] = max([self._ratio(row), *implied])
        num_within = sum(first == second for first, second in map(self._groups_of, rows))
        num_joints = len(self._group_of) - len(self._members)
        return Groups(self._joined, self._said, self._ways, num_within - num_joints)

    def _implying(self, row: int) -> list[int]:
        """Joined pairs that say the same as one within a group."""
        siblings = self._testimonies[row].siblings
        return [
            each.pair for each in siblings if self._joined[each.pair] and self._joined[each.via]
        ]

    def _join(self, claim: _Claim, groups: GroupPair) -> None:
        first, second = groups
        turn = self._turn(claim.surest)
        for image in self._members[second]:
            self._group_of[image] = first
            self._turns[image] = self._turns[image] @ turn
        self._members[first] += self._members.pop(second)
        image1, image2 = self._pairs[claim.surest].images
        self._tree[image1].append((image2, claim.surest))
        self._tree[image2].append((image1, claim.surest))
        self._said[list(claim.rows)] = claim.ratio
        sound = [row for row in claim.rows if self._ratio(row) >= _LEAST_OF_ONE]
        del self._claims[groups]
        for row in sorted(set(self._between.pop(groups)).difference(claim.rows)):
            way = self._way(*self._pairs[row].images)
            if self._contradicts(row, way):
                self._said[row], self._ways[row] = -np.inf, way
            else:
                self._undecided.append(row)
        stale = self._believe(sound) | self._renamed(second) | self._settle_within()
        for each in stale & self._between.keys():
            self._claims[each] = self._claims_of(each)

    def _renamed(self, second: int) -> set[GroupPair]:
        """Move what stands between a group that is gone and others; return where to."""
        moved = [groups for groups in self._between if second in groups]
        rows = [row for groups in moved for row in self._between.pop(groups)]
        for groups in moved:
            del self._claims[groups]
        for row in rows:
            self._between.setdefault(self._groups_of(row), []).append(row)
        return {self._groups_of(row) for row in rows}

    def _settle_within(self) -> set[GroupPair]:
        """Believe what is sure enough of what agrees with its group; return where that is heard."""
        changed: set[GroupPair] = set()
        while sure := [row for row in self._undecided if self._ratio(row) >= self._least]:
            self._said[sure] = self._ratios[sure]
            self._undecided = [row for row in self._undecided if self._ratio(row) < self._least]
            changed |= self._believe(sure)
        return changed

    def _believe(self, rows: Sequence[int]) -> set[GroupPair]:
        """From now on these pairs are heard; return between which groups that changes something."""
        self._joined[rows] = True
        asking = {row for witness in rows for row in self._asked_by[witness]}
        self._ratios[list(asking)] = np.nan
        return {self._groups_of(row) for row in asking}

    def _groups_of(self, row: int) -> GroupPair:
        """Both groups of a pair, in order."""
        first, second = (self._group_of[image] for image in self._pairs[row].images)
        return min(first, second), max(first, second)

    def _ratio(self, row: int) -> float:
        if np.isnan(self._ratios[row]):
            self._ratios[row] = self._ratio_of(row, self._joined)
        return float(self._ratios[row])

    def _turn(self, row: int) -> Array:
        """Rotation from the first group of a pair to the second, as the pair says."""
        first, second = self._pairs[row].images
        turn = self._turns[second].T @ self._pairs[row].cam2_from_cam1.rotation @ self._turns[first]
        return turn if self._group_of[first] <= self._group_of[second] else turn.T

    def _contradicts(self, row: int, way: Sequence[int]) -> bool:
        """Whether a pair turns its panoramas otherwise than those on the way between them do."""
        variance = sum(self._sigma_deg(each) ** 2 for each in (row, *way))
        limit = _AGREES_DEG + _NUM_SIGMAS * variance**0.5
        return bool(rotation_error_deg(self._turn(row), np.eye(3)) > limit)

    def _sigma_deg(self, row: int) -> float:
        return max(self._pairs[row].rotation_sigma_deg, _LEAST_SIGMA_DEG)

    def _way(self, start: int, end: int) -> list[int]:
        """Pairs that lead from one panorama of a group to another."""
        came_by: dict[int, tuple[int, int]] = {start: (start, -1)}
        waiting = [start]
        while end not in came_by:
            image = waiting.pop(0)
            for other, row in self._tree[image]:
                if other not in came_by:
                    came_by[other] = image, row
                    waiting.append(other)
        way = []
        while end != start:
            end, row = came_by[end]
            way.append(row)
        return way

    def _claims_of(self, groups: GroupPair) -> list[_Claim]:
        """What pairs say about two groups; those that say the same are one claim."""
        rows = self._between[groups]
        claims = []
        for same in _linked(rows, self._links_among(rows)):
            ratios = [self._ratio(row) for row in same]
            hearsay = min(self._hearsay_of(tuple(same)), _MOST_HEARSAY)
            ratio = _together(ratios) + _HEARSAY_SHARE * hearsay
            claims.append(_Claim(same, ratio, same[int(np.argmax(ratios))]))
        return claims

    def _hearsay_of(self, same: tuple[int, ...]) -> float:
        """What all others say about pairs that say the same, which cannot vouch for each other."""
        if same not in self._hearsay:
            others = np.ones(len(self._pairs), dtype=bool)
            others[list(same)] = False
            self._hearsay[same] = _together([self._ratio_of(row, others) for row in same])
        return self._hearsay[same]

    def _links_among(self, rows: Sequence[int]) -> Iterable[tuple[int, int]]:
        """Pairs of rows that say the same, as joined pairs tell."""
        among = set(rows)
        for row in rows:
            for sibling in self._testimonies[row].siblings:
                if sibling.pair in among and self._joined[sibling.via]:
                    yield row, sibling.pair


def _together(ratios: Sequence[float]) -> float:
    """What pairs that say the same say together."""
    count = len(ratios)
    mean = float(np.mean(np.maximum(ratios, _LEAST_OF_ONE)))
    return mean * count / (1 + _CORRELATION * (count - 1))


def _linked(rows: Sequence[int], links: Iterable[tuple[int, int]]) -> list[list[int]]:
    """Rows in sets that links connect."""
    set_of = {row: [row] for row in rows}
    for first, second in links:
        if set_of[first] is not set_of[second]:
            merged = set_of[first] + set_of[second]
            set_of.update(dict.fromkeys(merged, merged))
    return list({id(each): sorted(each) for each in set_of.values()}.values())
