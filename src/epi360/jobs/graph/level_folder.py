# SPDX-License-Identifier: BSD-3-Clause
"""Whether the panoramas of a folder are level, by the poses that are accepted without knowing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.upright import DOWN, elevation_deg, tilt_deg
from epi360.jobs.graph.graph_check import awaits_confirmation
from epi360.jobs.records.match_store import LEVEL_PAIRS, Verdict
from epi360.runs.made_from import fingerprint
from epi360.second_look import is_settled, prior_is_better

Array = NDArray[np.float64]

_CONFIDENT = 0.99  # probability of the poses that may say that a folder is level
_FEWEST_POSES = 5
_LARGEST_SHARE = 0.9  # of these poses within the limits; a few wrong ones may be among them
_TILT_DEG, _MEDIAN_TILT_DEG = 3.0, 1.5
_ELEVATION_DEG, _MEDIAN_ELEVATION_DEG = 6.0, 2.5
# A camera that is mounted askew and goes straight ahead shows no tilt; where it turns it does.
_TURN_DEG = 30.0
_GRAVITY_SIGMAS_DEG = 0.5, 2.0  # least and largest
_LEAST_ELEVATION_SIGMA_DEG = 2.0
_SIGMAS = 3.0  # a pose that is farther from the prior is estimated again


@dataclass(frozen=True)
class Level:
    """The prior that the poses of a level folder give, in degrees to one decimal."""

    gravity_sigma_deg: float  # of a panorama's vertical, per axis
    elevation_sigma_deg: float | None = None  # of the translations, where all have one height

    @property
    def prior(self) -> str:
        """The prior in words, as it is in the table of pairs."""
        return "level" if self.elevation_sigma_deg is None else "level, one height"

    @property
    def known(self) -> dict[str, Any]:
        """What `estimate_relative_poses` is told of the poses."""
        return {
            "gravity1": DOWN,
            "gravity2": DOWN,
            "gravity_sigma_deg": self.gravity_sigma_deg,
            "elevation_sigma_deg": self.elevation_sigma_deg,
        }

    @property
    def store(self) -> str:
        """Sub-folder for the pairs that are estimated with this prior."""
        key = (self.gravity_sigma_deg, self.elevation_sigma_deg)
        return f"{LEVEL_PAIRS}{fingerprint(key)}"

    def fits(self, verdict: Verdict) -> bool:
        """Whether a pose, or a rotation, is within three sigma of the prior."""
        pose = verdict.cam2_from_cam1
        if tilt_deg(pose.rotation) > _SIGMAS * self.gravity_sigma_deg:
            return False
        sigma_deg = self.elevation_sigma_deg
        return sigma_deg is None or not abs(elevation_deg(pose.translation)) > _SIGMAS * sigma_deg

    def asks_again(self, verdict: Verdict) -> bool:
        """Whether a pair is estimated again with the prior."""
        return self._contradicts(verdict) or not is_settled(verdict.status, verdict.warnings)

    def keeps(self, verdict: Verdict, later: Verdict) -> bool:
        """Whether the verdict with the prior is kept in place of the one without."""
        if not self.asks_again(verdict):
            return False
        waits = verdict.status != "ok" and awaits_confirmation(later)
        return waits or prior_is_better(later.status, self._contradicts(verdict))

    def told(self, verdict: Verdict, later: Verdict) -> Verdict:
        """The verdict that counts, of one without the prior and one with it.

        A pose that is kept without the prior, though it is less probable with it, is as probable as
        that: what other pairs must say for it is asked by its probability.
        """
        if self.keeps(verdict, later):
            return later
        if verdict.status != "ok" or not later.probability < verdict.probability:
            return verdict
        return replace(verdict, probability=later.probability)

    def _contradicts(self, verdict: Verdict) -> bool:
        return is_settled(verdict.status) and not self.fits(verdict)


def find_level(verdicts: Sequence[Verdict]) -> Level | None:
    """Prior of a level folder, from the verdicts on its pairs of panoramas; None if not level.

    A folder is level if at least five poses are confident, and nine in ten of them turn gravity by
    less than 3 degrees, with a median under 1.5; it is of one height if nine in ten also go less
    than 6 degrees up or down, with a median under 2.5.
    """
    poses = [
        verdict.cam2_from_cam1
        for verdict in verdicts
        if verdict.status == "ok" and verdict.probability > _CONFIDENT
    ]
    if len(poses) < _FEWEST_POSES:
        return None
    tilts = np.array([tilt_deg(pose.rotation) for pose in poses])
    turns = np.array([_turn_deg(pose.rotation) for pose in poses])
    turning = tilts[turns > _TURN_DEG]
    if not _are_small(tilts, _TILT_DEG, _MEDIAN_TILT_DEG) or (
        len(turning) and np.median(turning) > _TILT_DEG
    ):
        return None
    least, largest = _GRAVITY_SIGMAS_DEG
    sigma_deg = _rms(tilts[tilts < _TILT_DEG]) / 2.0**0.5
    gravity_sigma_deg = round(min(max(least, sigma_deg), largest), 1)
    rises = np.array([abs(elevation_deg(pose.translation)) for pose in poses])
    if not _are_small(rises, _ELEVATION_DEG, _MEDIAN_ELEVATION_DEG):
        return Level(gravity_sigma_deg)
    sigma_deg = 1.5 * _rms(rises[rises < _ELEVATION_DEG])
    return Level(gravity_sigma_deg, round(max(_LEAST_ELEVATION_SIGMA_DEG, sigma_deg), 1))


def _are_small(angles: Array, limit: float, median_limit: float) -> bool:
    share = float(np.mean(angles < limit))
    return share >= _LARGEST_SHARE and bool(np.median(angles) < median_limit)


def _turn_deg(rotation: Array) -> float:
    """Angle of a rotation about the vertical."""
    return float(np.degrees(np.abs(np.arctan2(rotation[0, 2], rotation[2, 2]))))


def _rms(angles: Array) -> float:
    return float(np.sqrt(np.mean(angles**2)))
