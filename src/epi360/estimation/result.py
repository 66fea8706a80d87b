# SPDX-License-Identifier: BSD-3-Clause
"""What the robust estimator returns: a pose, the evidence for it and a verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.estimation.short_repr import ShortRepr
from epi360.poses import Pose

Status = Literal[
    "ok",
    "too_few_matches",
    "too_few_inliers",
    "pure_rotation",
    "planar_ambiguous",
    "concentrated_inliers",
    "another_place",
]


MISSING_MATCHES = "matches are missing"  # of the warning about them, by which it is known
LEAST_PROBABILITY = 0.85  # of a pose that is accepted; the core's kAccepted is the same


@dataclass(frozen=True)
class Explanations:
    """Probabilities of what the matches of two views may be; they sum to one.

    Attributes
    ----------
    nothing : float
        Background alone: the views have nothing in common. 1 where there are too few matches.
    rotation : float
        The camera only turned.
    surface : float
        One surface, nearly a plane, seen from the pose that was found.
    motion : float
        A general scene, seen from the pose that was found.
    rival : float
        Another pose; of a plane it may be the second one that its homography has.
    """

    nothing: float = math.nan
    rotation: float = math.nan
    surface: float = math.nan
    motion: float = math.nan
    rival: float = math.nan

    @property
    def found(self) -> float:
        """Probability of the pose that was found, whatever it is seen of."""
        return self.surface + self.motion


@dataclass(frozen=True)
class SamePlace:
    """Probabilities that two images show one place, by what both must see; they sum to one.

    NaN where nothing was compared.

    Attributes
    ----------
    here : float
        What surrounds the matches looks as the pose says.
    elsewhere : float
        The matches lie on a thing that another place has too, or on one that moves along.
    copy : float
        The images show two places that are copies of each other, such as rooms of a hotel.
    """

    here: float = math.nan
    elsewhere: float = math.nan
    copy: float = math.nan


@dataclass(frozen=True, repr=False)
class RelativePoseResult(ShortRepr):
    """Relative pose of two central cameras and the evidence for it.

    Numbers that the data do not determine are NaN: after a pure rotation the rotation is set and
    the translation, ``E`` and their covariance are NaN; after any other failure but
    ``planar_ambiguous`` the whole pose is NaN.

    Attributes
    ----------
    cam2_from_cam1 : Pose
        x2 = R x1 + t with |t| = 1: two views do not fix the scale.
    E : ndarray, shape (3, 3)
        Essential matrix [t]x R, Frobenius norm sqrt(2).
    inlier_mask : ndarray, shape (M,), bool
        Residual below the threshold and both depths positive; same order as the input.
    residuals_rad : ndarray, shape (M,)
        Signed residual of each match under the pose, NaN for missing rows. After a pure rotation:
        the angle between R b1 and b2 over sqrt 2, the same unit. A tangent Sampson residual is
        turned from pixels to radians by the cameras' mean resolution.
    noise_deg : float
        Standard deviation of the bearings' noise, per axis and view, over the inliers.
    inlier_threshold_deg : float
        The gate that was used, given or estimated.
    parallax_deg : float
        Median angle between R b1 and b2 over the inliers; near the noise, t means nothing.
    sphere_coverage : float
        Share of 48 equal-area cells of the sphere that hold an inlier, the lower of both views.
    num_iterations : int
        Minimal samples drawn.
    status : str
        "ok" or the reason why the pose must not be used as it is.
    covariance : ndarray, shape (5, 5)
        Covariance of d, where R_true = exp([d_0:3]x) R and t_true = (t + B d_3:5) / |.|, in radians
        squared. It spans a second pose up to 8 degrees away that explains the matches as well.
    translation_basis : ndarray, shape (3, 2)
        B: the two tangent directions at t.
    probability : float
        Probability in [0, 1] that the pose with translation which was found is right, whatever the
        status says of it: the sum of ``surface`` and ``motion`` of the explanations, for panoramas
        times that of an `ImagePairResult.place`, and half of it where other matches agree on
        another pose that looks as right. NaN after a pure rotation, 0 where no pose was found.
    explanations : Explanations
        Probabilities of the five things that the matches may be.
    alternatives : tuple of Pose
        Other poses that explain the matches about as well, or better with other angles of the
        cameras, which a warning names. Where the pose is refused because it is not probable enough
        or its inliers do not determine it: the pose that was found, first.
    warnings : tuple of str
        Sentences for a person; empty when there is nothing to say.
    """

    cam2_from_cam1: Pose
    E: NDArray[np.float64]
    inlier_mask: NDArray[np.bool_]
    residuals_rad: NDArray[np.float64]
    noise_deg: float
    inlier_threshold_deg: float
    parallax_deg: float
    sphere_coverage: float
    num_iterations: int
    status: Status
    covariance: NDArray[np.float64]
    translation_basis: NDArray[np.float64]
    alternatives: tuple[Pose, ...] = ()
    warnings: tuple[str, ...] = ()
    probability: float = math.nan
    explanations: Explanations = Explanations()

    _SHOWN: ClassVar[tuple[str, ...]] = (
        "status", "probability", "num_inliers", "num_matches", "noise_deg", "parallax_deg",
        "rotation_sigma_deg", "translation_sigma_deg", "cam2_from_cam1", "alternatives",
        "warnings",
    )  # fmt: skip

    @property
    def success(self) -> bool:
        """Whether the pose may be used as it is."""
        return self.status == "ok"

    @property
    def num_matches(self) -> int:
        """Number of input rows, missing ones included."""
        return len(self.inlier_mask)

    @property
    def num_inliers(self) -> int:
        """Number of rows that support the pose, copies of a match included."""
        return int(np.count_nonzero(self.inlier_mask))

    @property
    def rotation_sigma_deg(self) -> float:
        """Standard deviation of the rotation over all axes, in degrees."""
        return math.degrees(math.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def translation_sigma_deg(self) -> float:
        """Standard deviation of the direction of the translation over both axes, in degrees."""
        return math.degrees(math.sqrt(np.trace(self.covariance[3:, 3:])))


@dataclass(frozen=True, kw_only=True, repr=False)
class ImagePairResult(RelativePoseResult):
    """Relative pose of two images, with the matched key points behind it.

    Attributes
    ----------
    keypoints1, keypoints2 : ndarray, shape (M, 2)
        Continuous pixels of the original images, row i of both is match i.
    place : SamePlace
        Whether both images show the place of the pose, if both see enough of the sphere and the
        matches alone determine it. ``probability`` is then that of the matches times
        ``place.here``.
    cameras : tuple of Camera or None
        The two cameras that the pose, the residuals and the inliers belong to: the given ones, or,
        where a warning says that the pose is one of other angles, these; None if no camera model
        of epi360 has such angles.
    """

    keypoints1: NDArray[np.float64]
    keypoints2: NDArray[np.float64]
    place: SamePlace = SamePlace()
    cameras: tuple[Camera | None, Camera | None] = (None, None)


AnyResult = TypeVar("AnyResult", bound=RelativePoseResult)


def with_pose_refused(result: AnyResult, status: Status) -> AnyResult:
    """The result without its pose, which is the first of the alternatives then."""
    return replace(
        result,
        status=status,
        cam2_from_cam1=Pose.nan(),
        E=np.full((3, 3), math.nan),
        covariance=np.full((5, 5), math.nan),
        translation_basis=np.full((3, 2), math.nan),
        alternatives=(result.cam2_from_cam1, *result.alternatives),
    )


def among_all(
    result: RelativePoseResult, rows: NDArray[np.intp], num_matches: int
) -> RelativePoseResult:
    """The result of some rows of all matches, for all of them; the others have no residual.

    What it says of missing matches is of the rows alone, and is left out.
    """
    inlier_mask = np.zeros(num_matches, dtype=bool)
    inlier_mask[rows] = result.inlier_mask
    residuals_rad = np.full(num_matches, np.nan)
    residuals_rad[rows] = result.residuals_rad
    warnings = tuple(each for each in result.warnings if MISSING_MATCHES not in each)
    return replace(result, inlier_mask=inlier_mask, residuals_rad=residuals_rad, warnings=warnings)


def pose_sigmas_deg(result: RelativePoseResult) -> tuple[float, float]:
    """Expected root mean square errors of the rotation and of the translation's direction."""
    return result.rotation_sigma_deg, result.translation_sigma_deg
