# SPDX-License-Identifier: BSD-3-Clause
"""Whether the matches that do not agree with a pose agree on another direction of the step.

In an office with equal desks, matches put one desk upon the next, and those that do not are left.
With the rotation given, these agree on another direction, which often is the right one. Wrong
matches of a place with little that is equal agree on none, and those of one thing that drives past
lie on one side. This needs no pictures; where there are some, they tell more (`own_evidence`,
`look_alikes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.places.look_alikes import Alike
from epi360.places.own_evidence import LARGEST_SPREAD, depth_spread
from epi360.places.shared_points import PosedPair, cloud_of
from epi360.poses import Pose

Array = NDArray[np.float64]

_CARRIED_DEG = 1.0  # between both bearings of what moves along with the camera
_APART_DEG = 20.0  # nearer directions have votes of the matches that just miss the first one
# Votes for the other direction, as a number, as a share of the matches that are left, and for each
# vote for the first one. Of 248 right poses in real rooms and streets none has as much of all
# three; of accepted ones in four rendered offices with equal desks, 24 of 35 wrong ones and 14 of
# 45 right ones.
_FEWEST, _OF_THOSE_LEFT, _MANY = 10, 0.1, 0.25
# Length of the mean of the voters' bearings, in the view in which they are spread more: of vehicles
# that pass 5 m away 0.8 and more, of 28 of 33 wrong poses in those offices less than this.
_ON_ONE_SIDE = 0.75
# Where so many pairs of a folder have that, the place repeats itself everywhere, and less is
# enough.
_OFTEN, _OFTEN_PAIRS, _SOME = 0.2, 3, 0.1
# Share of pairs in the open, of a folder that is: 0.68 of `Tram`, all of `Walking_Girl`, 0.17 of
# `zind_tour`, none to 0.3 of seven rendered offices and 0.58 of one.
_MOSTLY_OPEN = 0.6
_LEAST_PARALLAX_DEG = 0.3  # of inliers whose distance says something


class DirectionVotes(NamedTuple):
    """How many matches agree with the direction of a pose, and with the best other one.

    The latter are of the ``num_left`` matches that are no inliers, nor look the same way in both
    views, as what the camera carries does. ``on_one_side`` says that they lie together in either
    view, as those of one thing that moves, and ``in_the_open`` that the place is: there traffic,
    clouds and water move in all directions, and desks are rare.
    """

    num_own: int
    num_other: int
    num_left: int
    on_one_side: bool = False
    in_the_open: bool = False

    @classmethod
    def of(
        cls, pose: Pose, bearings: Sequence[Array], inlier_mask: NDArray[np.bool_]
    ) -> DirectionVotes:
        """Let matches vote: bearings (N, 3) of both views, and which of them are inliers."""
        turned, seen = bearings[0] @ pose.rotation.T, bearings[1]
        direction = pose.translation / np.linalg.norm(pose.translation)

        def voters(some: NDArray[np.bool_]) -> Alike:
            return Alike(turned[some], seen[some], np.arange(np.count_nonzero(some))[None])

        carried = np.sum(bearings[0] * seen, axis=1) > np.cos(np.radians(_CARRIED_DEG))
        left = ~inlier_mask & ~carried
        num_own = voters(np.ones_like(inlier_mask)).num_for(direction)
        others = voters(left)
        other, num_other = others.best_apart_from(direction, _APART_DEG)
        (rows,) = others.owners_for(other)
        together = min(_togetherness(view[left][rows]) for view in (turned, seen))
        return cls(num_own, num_other, int(np.count_nonzero(left)), together >= _ON_ONE_SIDE)

    def are_for_another(self, share: float) -> bool:
        """Whether many are for the other direction, at least this share of those for the first."""
        least = max(_FEWEST, _OF_THOSE_LEFT * self.num_left, share * self.num_own)
        return self.num_other >= least


def is_in_the_open(pair: PosedPair) -> bool:
    """Whether the distances of the inliers differ more than in a room, from both cameras."""
    known = [cloud_of(pair, side, _LEAST_PARALLAX_DEG).distances for side in (0, 1)]
    return min(map(len, known)) >= _FEWEST and min(map(depth_spread, known)) > LARGEST_SPREAD


def which_repeat(votes: Sequence[DirectionVotes]) -> list[bool]:
    """Which pairs of a folder show a part of the place that repeats itself.

    Where many clearly do, of those that have matches left, so do others of which less is left, also
    on one side: no vehicle is in the way of as many. In the open, where most pairs are, none does.
    """
    if votes and sum(each.in_the_open for each in votes) >= _MOSTLY_OPEN * len(votes):
        return [False] * len(votes)
    clear = [each.are_for_another(_MANY) and not each.on_one_side for each in votes]
    num_asked = sum(each.num_left > 0 for each in votes)
    if sum(clear) < max(_OFTEN_PAIRS, _OFTEN * num_asked):
        return clear
    return [each.are_for_another(_SOME) for each in votes]


def _togetherness(bearings: Array) -> float:
    """Length of the mean of bearings (N, 3): 1 where all look one way, also of none."""
    return float(np.linalg.norm(bearings.mean(axis=0))) if len(bearings) else 1.0
