# SPDX-License-Identifier: BSD-3-Clause
"""Similarity transforms: rigid transforms between frames whose units of length differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Similarity:
    """Transform x_a = s R x_b + t, named ``a_from_b``; an element of Sim(3).

    Attributes
    ----------
    scale : float
        Units of a in one unit of b; positive.
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)
        Position of the origin of b in the frame a, in units of a.
    """

    scale: float
    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        if not 0.0 < self.scale < np.inf:
            raise ValueError(f"scale must be positive and finite, got {self.scale}")
        rigid = Pose(self.rotation, self.translation)  # checks both and copies them
        object.__setattr__(self, "scale", float(self.scale))
        object.__setattr__(self, "rotation", rigid.rotation)
        object.__setattr__(self, "translation", rigid.translation)

    @classmethod
    def from_pose(cls, pose: Pose) -> Similarity:
        """Return the similarity of scale one that a pose is."""
        return cls(1.0, pose.rotation, pose.translation)

    def pose(self) -> Pose:
        """Return the rigid ``a_from_b`` after the units of a became those of b.

        Of a ``cam_from_world`` that is the pose with the same rotation and camera centre.
        """
        return Pose(self.rotation, self.translation / self.scale)

    def inverse(self) -> Similarity:
        """Return the similarity ``b_from_a`` of this ``a_from_b``."""
        translation = -(self.rotation.T @ self.translation) / self.scale
        return Similarity(1.0 / self.scale, self.rotation.T, translation)

    def __matmul__(self, other: Similarity) -> Similarity:
        """Return ``a_from_c`` of this ``a_from_b`` and the other's ``b_from_c``."""
        if not isinstance(other, Similarity):
            return NotImplemented
        return Similarity(
            self.scale * other.scale,
            self.rotation @ other.rotation,
            self.scale * (self.rotation @ other.translation) + self.translation,
        )

    def apply(self, points: Array) -> Array:
        """Return points (N, 3) of the frame b in the frame a."""
        return np.asarray(self.scale * (points @ self.rotation.T) + self.translation)
