# SPDX-License-Identifier: BSD-3-Clause
"""Maps that show the same place become parts of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from epi360.odometry.loop_closure import LoopClosure, median_range, similar
from epi360.odometry.pose_graph import PoseGraphEdge
from epi360.odometry.relocalization import MappedView
from epi360.odometry.similarity import Similarity

Array = NDArray[np.float64]
T = TypeVar("T")

# By which the scales of two connections of the same maps may differ: in their sigmas, of which few
# are smaller than the first number.
_LEAST_LOG_SCALE, _SIGMAS = 0.03, 2.0


@dataclass(frozen=True, eq=False)
class Connection:
    """The newest key frame of a map shows the place of an old one of another map.

    Attributes
    ----------
    loop : LoopClosure
        Between the two key frames.
    other_from_own : Similarity
        Between the worlds of the maps.
    new, old : MappedView
        The two key frames.
    threshold_rad : float
        What the directions of features may be off.
    is_sure : bool
        Whether the pictures make it sure that both show one place.
    """

    loop: LoopClosure
    other_from_own: Similarity
    new: MappedView
    old: MappedView
    threshold_rad: float
    is_sure: bool

    @classmethod
    def of(
        cls,
        loop: LoopClosure,
        new: MappedView,
        old: MappedView,
        threshold_rad: float,
        *,
        is_sure: bool,
    ) -> Connection:
        """Connection by a loop that is closed between two views."""
        assert loop.new_from_old is not None
        old_from_own = loop.new_from_old.inverse() @ Similarity.from_pose(new.cam_from_world)
        other_from_own = Similarity.from_pose(old.cam_from_world).inverse() @ old_from_own
        return cls(loop, other_from_own, new, old, threshold_rad, is_sure)

    def agrees_with(self, before: Connection) -> bool:
        """Whether it puts the newest key frame where an earlier connection does, in one scale."""
        assert self.loop.new_from_old is not None
        new = Similarity.from_pose(self.new.cam_from_world)
        old = Similarity.from_pose(self.old.cam_from_world)
        here, there = self.loop.new_from_old, new @ before.other_from_own.inverse() @ old.inverse()
        sigma = np.hypot(self.log_scale_sigma, before.log_scale_sigma)
        if abs(np.log(here.scale / there.scale)) > max(_LEAST_LOG_SCALE, _SIGMAS * sigma):
            return False
        return similar(here, there, median_range(self.new), self.threshold_rad)

    @property
    def log_scale_sigma(self) -> float:
        """Standard deviation of the logarithm of the scale, as far as points scatter."""
        assert self.loop.information is not None
        return float(self.loop.information[6, 6] ** -0.5)

    def with_scale_of_both(self, before: Connection) -> Connection:
        """Return the connection with the mean scale of an earlier one and its own."""
        assert self.loop.new_from_old is not None
        weights = np.array([self.log_scale_sigma, before.log_scale_sigma]) ** -2.0
        scales = np.log([self.other_from_own.scale, before.other_from_own.scale])
        factor = float(np.exp(scales[0] - weights @ scales / weights.sum()))
        found = self.loop.new_from_old
        scaled = Similarity(factor * found.scale, found.rotation, factor * found.translation)
        loop = replace(self.loop, new_from_old=scaled)
        return self.of(loop, self.new, self.old, self.threshold_rad, is_sure=self.is_sure)

    def ends(self, own_part: PartOfMap, other_part: PartOfMap) -> tuple[int, int, Array]:
        """Key frames that it joins, by their numbers in the joint map, and its information."""
        assert self.loop.information is not None
        information = own_part.grown(self.loop.information)
        return other_part.numbers[self.loop.old], own_part.numbers[self.loop.new], information


@dataclass(frozen=True, eq=False)
class PartOfMap:
    """A map that is a part of another now.

    Attributes
    ----------
    numbers : mapping
        Of its key frames: what they were, and what they are.
    growth : float
        Units of the whole in one of its own.
    """

    numbers: Mapping[int, int]
    growth: float

    def renumbered(self, of_key_frames: Mapping[int, T]) -> dict[int, T]:
        """What there is for key frames, by their numbers now."""
        return {self.numbers[number]: each for number, each in of_key_frames.items()}

    def ends_of(self, edge: PoseGraphEdge) -> tuple[int, int, Array]:
        """Key frames that an edge joins, by their numbers now, and its information."""
        assert edge.information is not None
        return self.numbers[edge.i], self.numbers[edge.j], self.grown(edge.information)

    def grown(self, information: Array) -> Array:
        """Information (7, 7) of an edge in the units of now."""
        units = np.repeat([1.0, 1.0 / self.growth, 1.0], [3, 3, 1])
        return np.asarray(units[:, None] * information * units)
