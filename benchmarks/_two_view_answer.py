# SPDX-License-Identifier: BSD-3-Clause
"""What a method says about a problem, and how far it is from the truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epi360.poses import Pose, rotation_error_deg, translation_error_deg, vector_from_rotation


@dataclass(frozen=True)
class Answer:
    """Pose of one method on one problem.

    Attributes
    ----------
    cam2_from_cam1 : Pose
        NaN where the method gives none.
    accepted : bool
        Whether the method itself stands behind rotation and direction.
    status : str
        The method's own word.
    has_warnings : bool
        Whether it said something beside an accepted pose.
    alternatives : tuple of Pose
        Others that it offers.
    covariance, translation_basis : ndarray
        (5, 5) and (3, 2), NaN where the method states none.
    """

    cam2_from_cam1: Pose
    accepted: bool
    status: str = ""
    has_warnings: bool = False
    alternatives: tuple[Pose, ...] = ()
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.full((5, 5), np.nan))
    translation_basis: NDArray[np.float64] = field(default_factory=lambda: np.full((3, 2), np.nan))


def errors_deg(pose: Pose, truth: Pose) -> tuple[float, float]:
    """Rotation and direction error; NaN where pose or truth has none."""
    return rotation_error_deg(pose, truth), translation_error_deg(pose, truth)


def normalised_squared_error(answer: Answer, truth: Pose) -> float:
    """d^T C^-1 d / 5 with the parameters that ``RelativePoseResult`` documents; 1 is calibrated."""
    pose, B = answer.cam2_from_cam1, answer.translation_basis
    values = (answer.covariance, B, truth.translation, pose.translation)
    if not all(np.isfinite(value).all() for value in values):
        return float("nan")
    turn = vector_from_rotation(truth.rotation @ pose.rotation.T)
    push = B.T @ truth.translation / (pose.translation @ truth.translation)
    d = np.concatenate([turn, push])
    try:
        return float(d @ np.linalg.solve(answer.covariance, d)) / 5.0
    except np.linalg.LinAlgError:
        return float("nan")
