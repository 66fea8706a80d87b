# SPDX-License-Identifier: BSD-3-Clause
"""Gravity in the camera, where it is known, as a prior of the odometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.epipolar.arguments import direction_array
from epi360.odometry.key_frames import KeyFrame

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GravityPrior:
    """Direction of gravity in the camera, the same in every frame, and how well it is known."""

    direction: Array
    sigma_rad: float

    @classmethod
    def given(cls, gravity: ArrayLike | None, sigma_deg: float) -> GravityPrior | None:
        """Prior of checked arguments; None if gravity is not known."""
        if gravity is None:
            return None
        if not 0.0 < sigma_deg <= 90.0:
            raise ValueError(f"gravity_sigma_deg must be in (0, 90], got {sigma_deg}")
        return cls(direction_array(gravity, "gravity"), float(np.radians(sigma_deg)))

    def in_world(self, key_frames: Sequence[KeyFrame]) -> Array:
        """Direction of gravity in the world: the mean of what the key frames say.

        The world is the camera's frame at the first key frame, which is tilted as much as others.
        """
        mean = sum((frame.rotation.T for frame in key_frames), np.zeros((3, 3))) @ self.direction
        return np.asarray(mean / np.linalg.norm(mean))
