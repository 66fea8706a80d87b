# SPDX-License-Identifier: BSD-3-Clause
"""What a pose says if its matches would agree better with other angles of the cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.changed_angles import PairOfAngles
from epi360.estimation.angle_changes import (
    LARGEST_CHANGE,
    AngleChange,
    ChangedAngles,
    changed_by_a_turn,
    fit_angle_changes,
)
from epi360.estimation.copies import Indices, distinct_rows
from epi360.estimation.result import RelativePoseResult, pose_sigmas_deg
from epi360.poses import rotation_error_deg, translation_error_deg, vector_from_rotation

Array = NDArray[np.float64]

# What the warning asks, by which it is known.
CALIBRATION_QUESTION = "is the field of view, or the calibration, right?"
# A change that is worth a word: so large, so many of its standard deviations, so much likelier,
# and it moves the pose by so many of those that the pose states. Of 98 real pairs with good cameras
# none is so.
_LEAST_CHANGE, _LEAST_DEVIATIONS, _LEAST_GAIN, _LEAST_MOVE = 0.01, 3.0, 8.0, 1.0
_FEWEST_INLIERS = 20
_IMAGES = ("both images", "image 1", "image 2")
# A turn with angles that are wrong by a sixth shows less parallax than this. With the right ones it
# leaves the inliers of the step a median residual, over their noise, of 0.4 to 1.2 (of two Gaussian
# components: 1.18); what was a step of some centimetres in a room leaves 1.6 and more.
_MOST_PARALLAX_DEG, _MOST_LEFT = 12.0, 1.35


def with_calibration_doubt(
    result: RelativePoseResult,
    bearings: tuple[Array, Array],
    cameras: tuple[Camera, Camera],
    estimate: Callable[[Array, Array], RelativePoseResult],
) -> RelativePoseResult:
    """Return the result with a warning, and a larger covariance, if the cameras may be wrong.

    ``bearings``, (N, 3) each, are those that the result was estimated from, wrong matches included.
    What a change of the cameras' angles would move the pose by is added to its covariance. If with
    such a change a rotation explains as many matches, by ``estimate``, that is the result.
    """
    if not result.success or result.num_inliers < _FEWEST_INLIERS:
        return result
    distinct, _ = distinct_rows(*bearings)
    turned = _turned(result, bearings, distinct, cameras, estimate)
    if turned is not None:
        return turned
    matches = bearings[0][distinct], bearings[1][distinct]
    found = fit_angle_changes(result.cam2_from_cam1, matches, cameras, result.noise_deg)
    if found.gain < _LEAST_GAIN or not _moves(result, found):
        return result
    doubts = [each for each in found.changes if _is_clear(each)]
    if not doubts:
        return result
    sentences = tuple(
        f"the matches agree better if {_in_words(each, cameras[max(each.view, 1) - 1])}: "
        f"{CALIBRATION_QUESTION}"
        for each in doubts
    )
    return replace(
        result,
        warnings=(*result.warnings, *sentences),
        covariance=result.covariance + _second_moment(result, found),
    )


def _turned(
    result: RelativePoseResult,
    bearings: tuple[Array, Array],
    distinct: Indices,
    cameras: tuple[Camera, Camera],
    estimate: Callable[[Array, Array], RelativePoseResult],
) -> RelativePoseResult | None:
    """The answer with other angles, if these show that the camera has only turned."""
    if result.parallax_deg > _MOST_PARALLAX_DEG:
        return None
    inliers = distinct[result.inlier_mask[distinct]]
    agreeing = bearings[0][inliers], bearings[1][inliers]
    rotation, noise_deg = result.cam2_from_cam1.rotation, result.noise_deg
    changes = changed_by_a_turn(rotation, agreeing, cameras, noise_deg)
    if changes is None or not (np.abs(changes) > _LEAST_CHANGE).any():
        return None
    angles = PairOfAngles.of(cameras, bearings, is_curved=True)
    answer = estimate(*(view.bearings for view in angles.changed(changes)))
    if answer.status != "pure_rotation":
        return None
    left = np.median(answer.residuals_rad[inliers])
    if left > _MOST_LEFT * np.radians(noise_deg):
        return None
    if cameras[0] == cameras[1]:
        words = _meant(_IMAGES[0], cameras[0], changes)
    else:
        own = (changes[each] for each in angles.columns)
        words = " and ".join(map(_meant, _IMAGES[1:], cameras, own))
    sentence = (
        f"the camera has only turned if {words}; with the angles as they were given, the matches "
        f"agree with a step: {CALIBRATION_QUESTION}"
    )
    return replace(answer, warnings=(*answer.warnings, sentence))


def _is_clear(each: AngleChange) -> bool:
    size = abs(each.change)
    return _LEAST_CHANGE < size < LARGEST_CHANGE and size > _LEAST_DEVIATIONS * each.sigma


def _moves(result: RelativePoseResult, found: ChangedAngles) -> bool:
    """Whether the pose with other angles is another one."""
    rotation_deg, direction_deg = pose_sigmas_deg(result)
    poses = result.cam2_from_cam1, found.cam2_from_cam1
    return bool(
        rotation_error_deg(*poses) > _LEAST_MOVE * rotation_deg
        or translation_error_deg(*poses) > _LEAST_MOVE * direction_deg
    )


def _second_moment(result: RelativePoseResult, found: ChangedAngles) -> Array:
    """Outer product of the five numbers by which the pose with other angles differs."""
    pose, other = result.cam2_from_cam1, found.cam2_from_cam1
    turn = vector_from_rotation(other.rotation @ pose.rotation.T)
    moved = np.concatenate([turn, result.translation_basis.T @ other.translation])
    return np.outer(moved, moved)


def _in_words(each: AngleChange, camera: Camera) -> str:
    """What is changed, and by how much, of one or both images."""
    images = _IMAGES[each.view]
    if not isinstance(camera, Equirectangular):
        what = "larger" if each.change > 0.0 else "smaller"
        amount = f"{abs(each.change):.1%} {what} (1 sigma {each.sigma:.1%})"
        return f"angles from the axis of {images} are {amount}"
    is_wide = each.direction == "horizontal"
    degrees = camera.horizontal_fov_deg if is_wide else camera.vertical_fov_deg
    spans = f"{degrees * (1.0 + each.change):.1f} degrees {'around' if is_wide else 'high'}"
    return f"{images} are {spans}, not {degrees:.6g} (1 sigma {degrees * each.sigma:.1f})"


def _meant(images: str, camera: Camera, changes: Array) -> str:
    """What the angles of one or both images must be for a turn."""
    if isinstance(camera, Equirectangular):
        given = np.array([camera.horizontal_fov_deg, camera.vertical_fov_deg])
        around, high = given * (1.0 + changes)
        return f"{images} are {around:.1f} degrees around and {high:.1f} high"
    given = np.array([30.0, 60.0])
    powers = np.radians(given)[:, None] ** np.array([0.0, 2.0])
    first, second = given * (1.0 + powers @ changes)
    return (
        f"what is taken for 30 and 60 degrees from the axis of {images} is {first:.1f} and "
        f"{second:.1f} degrees"
    )
