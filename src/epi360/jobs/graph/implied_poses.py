# SPDX-License-Identifier: BSD-3-Clause
"""Poses that accepted pairs imply for others: two pairs of three images give that of the third.

The rotation follows from both, the direction of the translation also from how large the units of
one pair are in those of the other, which points say that both pairs see from the shared camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from epi360.epipolar.essential import cheirality_mask
from epi360.epipolar.residuals import pose_residuals
from epi360.places.shared_points import Cloud, PosedPair, cloud_of, scale_between
from epi360.poses import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
RowSide = tuple[int, int]

_LEAST_PARALLAX_DEG = 1.0  # of the points that say how large units are
_MOST_WAYS = 8  # that are tried for one pair
_FEWEST_SIGMAS = 5.0  # of its error by the scale, in the length of a translation
_AGREES_DEG = 1.0  # so near to its epipolar plane lies a match that agrees with a pose
_NUM_EXCHANGES, _CHANCE = 16, 1e-3


@dataclass(frozen=True, eq=False)
class Way:
    """The pose that two pairs imply, and their rows."""

    cam2_from_cam1: Pose
    rows: tuple[int, int]

    def agreeing(self, bearings1: Array, bearings2: Array) -> Mask:
        """Which matches lie in front of both cameras and near to their epipolar planes."""
        near = near_matches(self.cam2_from_cam1, bearings1, bearings2, _AGREES_DEG)
        return near & cheirality_mask(bearings1, bearings2, self.cam2_from_cam1)

    def num_agreeing(self, bearings1: Array, bearings2: Array) -> int:
        """Count the matches that agree."""
        return int(np.count_nonzero(self.agreeing(bearings1, bearings2)))

    def is_chance(self, bearings1: Array, bearings2: Array) -> bool:
        """Whether as many might agree if the partners of all matches were exchanged.

        It is chance unless that would happen once in a thousand times at most.
        """
        last = len(bearings1) - 1
        steps = np.unique(np.linspace(1, last, min(last, _NUM_EXCHANGES)).astype(int))
        exchanged = [self.num_agreeing(bearings1, np.roll(bearings2, step, 0)) for step in steps]
        expected = float(np.mean(exchanged)) + 1.0 / len(steps)
        fewer = self.num_agreeing(bearings1, bearings2) - 1
        return fewer < 0 or bool(pdtrc(fewer, expected) > _CHANCE)


class ImpliedPoses:
    """Poses that some pairs, each with its row, imply for two images that are no such pair."""

    def __init__(self, pairs: Sequence[PosedPair]) -> None:
        self._pairs = pairs
        self._at: dict[int, dict[int, RowSide]] = {}
        for row, pair in enumerate(pairs):
            for side in (0, 1):
                self._at.setdefault(pair.images[side], {})[pair.images[1 - side]] = row, side
        self._clouds: dict[RowSide, Cloud] = {}

    def ways(self, image1: int, image2: int) -> list[Way]:
        """Poses from one image to another over the images that both are paired with.

        Those over pairs with most points come first, eight at most.
        """
        ends1, ends2 = self._at.get(image1, {}), self._at.get(image2, {})
        shared = sorted(ends1.keys() & ends2.keys())
        shared.sort(key=lambda other: -min(map(self._num_points, (ends1[other], ends2[other]))))
        ways = (self._way(ends1[other], ends2[other]) for other in shared[:_MOST_WAYS])
        return [way for way in ways if way is not None]

    def _way(self, start: RowSide, end: RowSide) -> Way | None:
        """Pose from the image of one row and side to that of another; None if not known."""
        scale = scale_between(*(self._cloud(row, 1 - side) for row, side in (start, end)))
        if scale is None:
            return None
        (row1, side1), (row2, side2) = start, end
        first, last = self._pairs[row1].other_from(side1), self._pairs[row2].other_from(1 - side2)
        factor, sigma = scale
        translation = last.rotation @ first.translation + factor * last.translation
        length = float(np.linalg.norm(translation))
        if length < _FEWEST_SIGMAS * factor * sigma:
            return None  # both images lie at about one place, so that no direction is known
        return Way(Pose(last.rotation @ first.rotation, translation / length), (row1, row2))

    def _num_points(self, end: RowSide) -> int:
        return len(self._pairs[end[0]].keypoints[0])

    def _cloud(self, row: int, side: int) -> Cloud:
        if (row, side) not in self._clouds:
            self._clouds[row, side] = cloud_of(self._pairs[row], side, _LEAST_PARALLAX_DEG)
        return self._clouds[row, side]


def near_matches(pose: Pose, bearings1: Array, bearings2: Array, limit_deg: float) -> Mask:
    """Which matches lie so near to the epipolar planes of a pose, in the second view."""
    residuals = pose_residuals(pose, bearings1, bearings2, "angular")
    return np.asarray(np.abs(residuals) < np.radians(limit_deg))
