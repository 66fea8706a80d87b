# SPDX-License-Identifier: BSD-3-Clause
"""What the estimator of a pose in a map returns: the pose, the evidence for it and a verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from epi360.epipolar.essential import skew
from epi360.estimation.absolute_verdict import AbsoluteStatus
from epi360.estimation.short_repr import ShortRepr
from epi360.poses import Pose

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, repr=False)
class AbsolutePoseResult(ShortRepr):
    """Pose of a camera in a map and the evidence for it.

    Attributes
    ----------
    cam_from_world : Pose
        x_cam = R x_world + t; NaN unless the status is "ok" or "ambiguous".
    inlier_mask : ndarray, shape (N,), bool
        Matches whose bearing is less than the gate from the direction to their point, in the order
        of the input.
    residuals_rad : ndarray, shape (N,)
        That angle, up to pi; NaN for missing rows and where there is no pose.
    covariance : ndarray, shape (6, 6)
        Of (w, d), where the true pose is R_true = exp([w]x) R, t_true = t + d; radians and the unit
        of the points. The map is taken for true but for the errors of its points that are given.
    noise_deg : float
        Standard deviation of the bearings per axis, over the inliers.
    inlier_threshold_deg : float
        The gate that was used, given or estimated.
    sphere_coverage : float
        Share of 48 equal-area cells of the sphere of view that hold an inlier.
    status : str
        "ok" or the reason why the pose must not be used as it is: "too_few_matches",
        "too_few_inliers", "concentrated_inliers" (the inliers are one patch, or do not determine
        the pose to 5 degrees and a tenth of their distance) or "ambiguous" (another pose explains
        at least half as much of the view).
    probability : float
        Probability in [0, 1] that the pose that was found is right, whatever the status says of it;
        0 where none was found.
    alternatives : tuple of Pose
        After "ambiguous" the other pose; after "too_few_inliers" and "concentrated_inliers" the
        pose that was found and refused.
    warnings : tuple of str
        Sentences for a person; empty when there is nothing to say.
    """

    cam_from_world: Pose
    inlier_mask: Mask
    residuals_rad: Array
    covariance: Array
    noise_deg: float
    inlier_threshold_deg: float
    sphere_coverage: float
    status: AbsoluteStatus
    probability: float
    alternatives: tuple[Pose, ...] = ()
    warnings: tuple[str, ...] = ()

    _SHOWN: ClassVar[tuple[str, ...]] = (
        "status", "probability", "num_inliers", "noise_deg", "rotation_sigma_deg",
        "position_sigma", "cam_from_world", "alternatives", "warnings",
    )  # fmt: skip

    @property
    def success(self) -> bool:
        """Whether the pose may be used as it is."""
        return self.status == "ok"

    @property
    def num_inliers(self) -> int:
        """Number of matches that support the pose."""
        return int(np.count_nonzero(self.inlier_mask))

    @property
    def rotation_sigma_deg(self) -> float:
        """Standard deviation of the rotation over all axes, in degrees."""
        return math.degrees(math.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def center_covariance(self) -> Array:
        """Covariance (3, 3) of the camera's centre -R't in the world, in the points' unit."""
        R, t = self.cam_from_world.rotation, self.cam_from_world.translation
        # c' = -R' (exp(-w) (t + d)) with R' = R transposed: c' = c - R' (d + t x w).
        moves = -R.T @ np.hstack([skew(t), np.eye(3)])
        return np.asarray(moves @ self.covariance @ moves.T)

    @property
    def position_sigma(self) -> float:
        """Standard deviation of the camera's centre over all axes, in the points' unit."""
        return math.sqrt(np.trace(self.center_covariance))


def no_pose(count: int, status: AbsoluteStatus) -> AbsolutePoseResult:
    """Result without a pose for so many matches."""
    return AbsolutePoseResult(
        cam_from_world=Pose.nan(),
        inlier_mask=np.zeros(count, dtype=bool),
        residuals_rad=np.full(count, np.nan),
        covariance=np.full((6, 6), np.nan),
        noise_deg=math.nan,
        inlier_threshold_deg=math.nan,
        sphere_coverage=0.0,
        status=status,
        probability=0.0,
    )
