# SPDX-License-Identifier: BSD-3-Clause
"""Whether the pairs of a rig agree with how the calibration says that its cameras are turned.

The pose of an image of camera a and one of camera b has the turn of b against a in it, and that of
the rig between both moments, which a pair of one camera says. What is left is compared.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose, rotation_error_deg

Array = NDArray[np.float64]
Moment = tuple[str, str]  # frame and camera

_FEWEST, _LEAST_DEG, _SIGMAS = 3, 1.0, 4.0


@dataclass(frozen=True, eq=False)
class Turn:
    """How a camera of a rig has turned from one moment to another, or against another camera."""

    first: Moment
    second: Moment
    rotation: Array
    sigma_deg: float

    def inverse(self) -> Turn:
        """The way back."""
        return Turn(self.second, self.first, self.rotation.T, self.sigma_deg)


@dataclass(frozen=True)
class RigDoubt:
    """Two cameras that are turned against each other otherwise than is stated.

    ``num_pairs`` say so, by ``off_deg`` in the median.
    """

    cameras: tuple[str, str]
    num_pairs: int
    off_deg: float


def rig_doubts(turns: Iterable[Turn], cam_from_rig: Mapping[str, Pose]) -> list[RigDoubt]:
    """Cameras of a rig that at least three pairs see turned otherwise, by more than their noise.

    ``turns`` are those of pairs whose rotations are believed.
    """
    within, between = {}, []
    for turn in turns:
        for each in (turn, turn.inverse()):
            if each.first[1] == each.second[1]:
                within[each.first, each.second] = each
            elif each.first[1] < each.second[1]:
                between.append(each)
    off: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    for turn in between:
        cameras = turn.first[1], turn.second[1]
        stated = cam_from_rig[cameras[1]].rotation @ cam_from_rig[cameras[0]].rotation.T
        rotation, sigma_deg = next(_at_one_moment(turn, within), (None, np.nan))
        if rotation is not None and np.isfinite(sigma_deg):
            off[cameras].append((rotation_error_deg(rotation, stated), sigma_deg))
    return [
        RigDoubt(cameras, len(measured), float(np.median([each[0] for each in measured])))
        for cameras, measured in off.items()
        if _is_off(np.array(measured))
    ]


def _at_one_moment(
    turn: Turn, within: Mapping[tuple[Moment, Moment], Turn]
) -> Iterator[tuple[Array, float]]:
    """Rotation of the second camera against the first, and its sigma, as far as it is known."""
    (start, first), (end, second) = turn.first, turn.second
    if start == end:
        yield turn.rotation, turn.sigma_deg
    before = within.get(((end, first), (start, first)))
    if before is not None:
        yield turn.rotation @ before.rotation, float(np.hypot(turn.sigma_deg, before.sigma_deg))
    after = within.get(((end, second), (start, second)))
    if after is not None:
        yield after.rotation @ turn.rotation, float(np.hypot(turn.sigma_deg, after.sigma_deg))


def _is_off(measured: Array) -> bool:
    """Whether measurements (N, 2), an angle and its sigma each, leave no doubt."""
    off_deg, sigma_deg = np.median(measured, axis=0)
    return len(measured) >= _FEWEST and bool(off_deg > max(_LEAST_DEG, _SIGMAS * sigma_deg))
