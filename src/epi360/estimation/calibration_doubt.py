# SPDX-License-Identifier: BSD-3-Clause
"""What a pose says if its matches would agree better with other angles of the cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

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
_LEAST_MIDDLE_RAD = 0.02  # of the latitude of the middle row
_FEWEST_INLIERS = 20
_IMAGES, _VERBS = ("both images", "image 1", "image 2"), ("are", "is", "is")


class _Turn(NamedTuple):
    """Parallax that a turn with other angles may show, and how large their change may be."""

    parallax_deg: float
    least: float
    most: float


# Of angles that are wrong by a sixth, and of one of two panoramas whose lowest fifth was cut off.
# Smaller changes of one alone show no more parallax than many a step, nor do larger ones of both.
_TURN_OF_BOTH, _TURN_OF_ONE = _Turn(12.0, _LEAST_CHANGE, 0.25), _Turn(25.0, 0.04, LARGEST_CHANGE)
# By how much more than a cut at one end a change may lower the middle of a panorama.
_MOST_OF_CUT = 1.3
# With the right angles a turn leaves the inliers of the step a median residual, over their noise,
# of 0.4 to 1.2 (of two Gaussian components: 1.18); what was a step of some centimetres in a room
# leaves 1.6 and more. Where the parallax is so many times the noise, no turn leaves little of a
# step among things at different distances.
_MOST_LEFT, _MUCH_PARALLAX, _MOST_LEFT_OF_MUCH = 1.35, 50.0, 3.0


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
    if not result.success:
        return result
    distinct, _ = distinct_rows(*bearings)
    if result.inlier_mask[distinct].sum() < _FEWEST_INLIERS:
        return result
    turned = _turned(result, bearings, distinct, cameras, estimate)
    if turned is not None:
        return turned
    found = _best_changes(result, (bearings[0][distinct], bearings[1][distinct]), cameras)
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
    inliers = distinct[result.inlier_mask[distinct]]
    agreeing = bearings[0][inliers], bearings[1][inliers]
    rotation, noise_deg = result.cam2_from_cam1.rotation, result.noise_deg
    for only in _views_that_may_change(cameras):
        limits = _TURN_OF_ONE if only else _TURN_OF_BOTH
        if result.parallax_deg > limits.parallax_deg:
            continue
        changes = changed_by_a_turn(rotation, agreeing, cameras, noise_deg, only=only)
        if changes is None or not limits.least < np.abs(changes).max() < limits.most:
            continue
        angles = PairOfAngles.of(cameras, bearings, is_curved=True, only=only)
        own = (changes[each] for each in angles.columns)
        if not all(map(_may_be_of_a_cut, own, cameras)):
            continue
        answer = estimate(*(view.bearings for view in angles.changed(changes)))
        if answer.status == "pure_rotation" and _is_as_good(answer, result, inliers):
            return _with_turn(answer, angles, changes, cameras)
    return None


def _may_be_of_a_cut(changes: Array, camera: Camera) -> bool:
    """Whether a panorama may have been cut so that its angles change so; lenses may change anyhow.

    What is cut off at one end moves the middle and shrinks the height; a camera that rises moves
    the middle alone, where all is at about one distance.
    """
    if not len(changes) or not isinstance(camera, Equirectangular):
        return True
    _, higher, lowered = np.abs(changes)
    most = _MOST_OF_CUT * higher * np.radians(camera.vertical_fov_deg) / 2.0
    return bool(lowered <= max(most, _LEAST_MIDDLE_RAD))


def _is_as_good(
    turn: RelativePoseResult, step: RelativePoseResult, inliers: NDArray[np.intp]
) -> bool:
    """Whether a turn explains the inliers of a step as well, or nearly so and their parallax."""
    left = np.median(turn.residuals_rad[inliers]) / np.radians(step.noise_deg)
    has_much = step.parallax_deg > _MUCH_PARALLAX * step.noise_deg
    return bool(left <= (_MOST_LEFT_OF_MUCH if has_much else _MOST_LEFT))


def _with_turn(
    answer: RelativePoseResult,
    angles: PairOfAngles,
    changes: Array,
    cameras: tuple[Camera, Camera],
) -> RelativePoseResult:
    views = dict.fromkeys(view for view, _ in angles.names)
    own = {0: changes, 1: changes[angles.columns[0]], 2: changes[angles.columns[1]]}
    words = " and ".join(_meant(view, cameras[max(view, 1) - 1], own[view]) for view in views)
    sentence = (
        f"the camera has only turned if {words}; with the angles as they were given, the matches "
        f"agree with a step: {CALIBRATION_QUESTION}"
    )
    return replace(answer, warnings=(*answer.warnings, sentence))


def _views_that_may_change(cameras: tuple[Camera, Camera]) -> tuple[int, ...]:
    """Both (0), and of panoramas, either of which may be cut or stretched, one alone."""
    are_panoramas = all(isinstance(camera, Equirectangular) for camera in cameras)
    return (0, 2, 1) if are_panoramas else (0,)


def _best_changes(
    result: RelativePoseResult, bearings: tuple[Array, Array], cameras: tuple[Camera, Camera]
) -> ChangedAngles:
    """The changes that gain most; those of one view must gain clearly more than those of both."""
    pose, noise_deg = result.cam2_from_cam1, result.noise_deg
    both, *alone = (
        fit_angle_changes(pose, bearings, cameras, noise_deg, only=only)
        for only in _views_that_may_change(cameras)
    )
    best = max(alone, key=lambda each: each.gain, default=both)
    return best if best.gain > max(both.gain, 0.0) + _LEAST_GAIN else both


def _is_clear(each: AngleChange) -> bool:
    size = abs(each.change)
    return _least_change(each) < size < LARGEST_CHANGE and size > _LEAST_DEVIATIONS * each.sigma


def _least_change(each: AngleChange) -> float:
    return _LEAST_MIDDLE_RAD if each.direction == "middle" else _LEAST_CHANGE


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
    if each.direction == "middle":
        latitude = camera.center_latitude_deg - np.degrees(each.change)
        return (
            f"the middle row of {images} is at a latitude of {latitude:.1f} degrees, not "
            f"{camera.center_latitude_deg:.6g} (1 sigma {np.degrees(each.sigma):.1f})"
        )
    is_wide = each.direction == "horizontal"
    degrees = camera.horizontal_fov_deg if is_wide else camera.vertical_fov_deg
    spans = f"{degrees * (1.0 + each.change):.1f} degrees {'around' if is_wide else 'high'}"
    verb = _VERBS[each.view]
    return f"{images} {verb} {spans}, not {degrees:.6g} (1 sigma {degrees * each.sigma:.1f})"


def _meant(view: int, camera: Camera, changes: Array) -> str:
    """What the angles of one or both images must be for a turn."""
    images = _IMAGES[view]
    if isinstance(camera, Equirectangular):
        given = np.array([camera.horizontal_fov_deg, camera.vertical_fov_deg])
        around, high = given * (1.0 + changes[:2])
        middle = camera.center_latitude_deg - np.degrees(changes[2])
        return (
            f"{images} {_VERBS[view]} {around:.1f} degrees around and {high:.1f} high, with the "
            f"middle at a latitude of {middle:.1f}"
        )
    given = np.array([30.0, 60.0])
    powers = np.radians(given)[:, None] ** np.array([0.0, 2.0])
    first, second = given * (1.0 + powers @ changes)
    return (
        f"what is taken for 30 and 60 degrees from the axis of {images} is {first:.1f} and "
        f"{second:.1f} degrees"
    )
