# SPDX-License-Identifier: BSD-3-Clause
"""What a pose says if its matches agree better with other angles of the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.changed_angles import PairOfAngles
from epi360.cameras.changed_camera import changed_lens, changed_panorama
from epi360.estimation.angle_changes import (
    LARGEST_CHANGE,
    changed_by_a_turn,
    robust_gain,
)
from epi360.estimation.angle_search import (
    LEAST_CHANGE,
    LEAST_MIDDLE_RAD,
    MOST_BEYOND,
    Bearings,
    Estimate,
    OtherAngles,
    find_other_angles,
    views_that_may_change,
)
from epi360.estimation.angle_words import angles_in_words, change_in_words
from epi360.estimation.copies import Indices, distinct_rows
from epi360.estimation.lens_beside_panorama import view_of_lens
from epi360.estimation.result import RelativePoseResult, pose_sigmas_deg
from epi360.poses import Pose, rotation_error_deg, translation_error_deg, vector_from_rotation

Array = NDArray[np.float64]

# What the warning asks, by which it is known.
CALIBRATION_QUESTION = "is the field of view, or the calibration, right?"
# The pose with other angles must be so many of the stated standard deviations away. If it is so far
# away that the pose as given is wrong, it is the result.
_LEAST_MOVE, _MOST_MOVE_DEG = 1.0, 10.0
_FEWEST_INLIERS = 20
_MOST_CLAMPED_DEG = 1.0  # by which the middle of a panorama may miss the change: it ends at a pole
THEIR_POSE = "this is the pose that they say then"
AS_GIVEN = "with the angles as they were given"
_IMAGES = ("both images", "image 1", "image 2")


class _Turn(NamedTuple):
    """Parallax that a turn with other angles may show, and how large their change may be."""

    parallax_deg: float
    least: float
    most: float


# Of angles that are wrong by a sixth, and of one of two panoramas whose lowest fifth was cut off.
# Smaller changes of one alone show no more parallax than many a step, nor do larger ones of both.
_TURN_OF_BOTH, _TURN_OF_ONE = _Turn(12.0, LEAST_CHANGE, 0.25), _Turn(25.0, 0.04, LARGEST_CHANGE)
# By how much more than a cut at one end a change may lower the middle of a panorama.
_MOST_OF_CUT = 1.3
# With the right angles a turn leaves the inliers of the step a median residual, over their noise,
# of 0.4 to 1.2 (of two Gaussian components: 1.18); what was a step of some centimetres in a room
# leaves 1.6 and more. Where the parallax is so many times the noise, no turn leaves little of a
# step among things at different distances.
_MOST_LEFT, _MUCH_PARALLAX, _MOST_LEFT_OF_MUCH = 1.35, 50.0, 3.0
# Of the robust log-likelihood, for each inlier of a step. Turns of a lens beside a panorama lose up
# to 0.2, steps at walls 0.6. Turns of real panoramas one of which was cut and made smaller lose up
# to 0.72; two steps of more than a metre, which other angles turned into turns at one wall, 1.7.
_MOST_LOSS_BESIDE_PANORAMA, _MOST_LOSS_OF_TURN = 0.35, 1.1
_WIDER_THAN_SPHERE = 1.02  # as a factor, to which a change of a whole panorama is known


class Doubted(NamedTuple):
    """A result, and the cameras that its pose belongs to, None where there is no such model."""

    result: RelativePoseResult
    cameras: tuple[Camera | None, Camera | None]


def with_calibration_doubt(
    result: RelativePoseResult,
    bearings: Bearings,
    cameras: tuple[Camera, Camera],
    estimate: Estimate,
) -> Doubted:
    """Return the result, or another one with a warning, if the cameras' angles seem to be wrong.

    ``bearings``, (N, 3) each, are those that the result was estimated from, wrong matches included.
    If with other angles a rotation explains the matches, by ``estimate``, about as well as the
    given pose does, that is the result; of a lens beside a panorama, whose noise a wrong focal
    length makes large, only if no pose with other angles does so better. Or else, if they agree
    clearly better with a pose and other angles, that pose is an alternative, and what it differs by
    is added to the covariance, for the result belongs to the cameras that were given. Where it
    would say nothing of the pose then, the other pose is the result.
    """
    given = Doubted(result, cameras)
    if not result.success:
        return given
    distinct, _ = distinct_rows(*bearings)
    if result.inlier_mask[distinct].sum() < _FEWEST_INLIERS:
        return given
    turned = _turned(result, bearings, distinct, cameras, estimate)
    if turned is not None and view_of_lens(cameras) is None:
        return turned
    other = find_other_angles(result, bearings, distinct, cameras, estimate)
    if other is None:
        return given if turned is None else turned
    if turned and _is_as_good(turned.result, other.answer, _inliers(other.answer, distinct)):
        return turned
    return _with_other_angles(result, other, cameras)


def _changed(
    cameras: tuple[Camera, Camera], changes: Sequence[Array]
) -> tuple[Camera | None, Camera | None]:
    """The cameras with other angles, by the changes of each."""
    first, second = map(_changed_camera, cameras, changes)
    return first, second


def _changed_camera(camera: Camera, changes: Array) -> Camera | None:
    if not len(changes):
        return camera
    if not isinstance(camera, Equirectangular):
        return changed_lens(camera, changes)
    found = changed_panorama(camera, changes)
    lowered = camera.center_latitude_deg - found.center_latitude_deg
    return found if abs(lowered - np.degrees(changes[2])) < _MOST_CLAMPED_DEG else None


def _turned(
    result: RelativePoseResult,
    bearings: Bearings,
    distinct: Indices,
    cameras: tuple[Camera, Camera],
    estimate: Estimate,
) -> Doubted | None:
    """The answer with other angles, if these show that the camera has only turned."""
    inliers = _inliers(result, distinct)
    agreeing = bearings[0][inliers], bearings[1][inliers]
    rotation, noise_deg = result.cam2_from_cam1.rotation, result.noise_deg
    is_beside = view_of_lens(cameras) is not None
    most_loss = _MOST_LOSS_BESIDE_PANORAMA if is_beside else _MOST_LOSS_OF_TURN
    for only in views_that_may_change(cameras):
        limits = _TURN_OF_ONE if only else _TURN_OF_BOTH
        if result.parallax_deg > limits.parallax_deg:
            continue
        changes = changed_by_a_turn(rotation, agreeing, cameras, noise_deg, only=only)
        if changes is None or not limits.least < np.abs(changes).max() < limits.most:
            continue
        angles = PairOfAngles.of(cameras, bearings, is_curved=True, only=only)
        if angles.share_beyond(changes) > MOST_BEYOND:
            continue
        own = [changes[each] for each in angles.columns]
        if not all(map(_may_be_of_a_cut, own, cameras)):
            continue
        answer = estimate(*(view.bearings for view in angles.changed(changes)))
        if answer.status != "pure_rotation" or not _is_as_good(answer, result, inliers):
            continue
        if _loss(answer, result, distinct) < most_loss:
            told = _with_turn(answer, angles, changes, cameras)
            return Doubted(told, _changed(cameras, own))
    return None


def _loss(turn: RelativePoseResult, step: RelativePoseResult, distinct: Indices) -> float:
    """How much less well a turn explains the matches than a step, by the noise of the step.

    Of the robust log-likelihood, for each inlier of the step.
    """
    # The residuals of a turn have two components, those of a step one.
    after = turn.residuals_rad[distinct] / np.sqrt(2.0)
    return -robust_gain(step.residuals_rad[distinct], after, step.noise_deg) / step.num_inliers


def _inliers(result: RelativePoseResult, distinct: Indices) -> Indices:
    """Rows of the inliers that are no copies."""
    return distinct[result.inlier_mask[distinct]]


def _may_be_of_a_cut(changes: Array, camera: Camera) -> bool:
    """Whether a panorama may have been cut so that its angles change so; lenses may change anyhow.

    What is cut off at one end moves the middle and shrinks the height; a camera that rises moves
    the middle alone, where all is at about one distance. No panorama shows more than a sphere.
    """
    if not len(changes) or not isinstance(camera, Equirectangular):
        return True
    spans = np.array([camera.horizontal_fov_deg / 360.0, camera.vertical_fov_deg / 180.0])
    if np.any(spans * (1.0 + changes[:2]) > _WIDER_THAN_SPHERE):
        return False
    _, higher, lowered = np.abs(changes)
    most = _MOST_OF_CUT * higher * np.radians(camera.vertical_fov_deg) / 2.0
    return bool(lowered <= max(most, LEAST_MIDDLE_RAD))


def _is_as_good(turn: RelativePoseResult, step: RelativePoseResult, inliers: Indices) -> bool:
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
    words = " and ".join(
        angles_in_words(_IMAGES[view], cameras[max(view, 1) - 1], own[view]) for view in views
    )
    sentence = (
        f"the camera has only turned if {words}; with the angles as they were given, the matches "
        f"agree with a step: {CALIBRATION_QUESTION}"
    )
    return replace(answer, warnings=(*answer.warnings, sentence))


def _with_other_angles(
    given: RelativePoseResult, other: OtherAngles, cameras: tuple[Camera, Camera]
) -> Doubted:
    """The result with the other pose as an alternative, or that pose, if it is far away."""
    answer, doubts = other.answer, other.clear_changes()
    poses = given.cam2_from_cam1, answer.cam2_from_cam1
    turned, moved = rotation_error_deg(*poses), _moved_deg(*poses)
    turn_sigma, direction_sigma = pose_sigmas_deg(given)
    if turned < _LEAST_MOVE * turn_sigma and moved < _LEAST_MOVE * direction_sigma:
        return Doubted(given, cameras)
    own = other.found.changes
    words = [
        change_in_words(each, own, _IMAGES[each.view], cameras[max(each.view, 1) - 1])
        for each in doubts
    ]
    changes = " and ".join(dict.fromkeys(words))
    distance = f"{turned:.1f} degrees away in rotation and {moved:.1f} in direction"
    if max(turned, moved) > _MOST_MOVE_DEG:
        sentence = (
            f"the matches agree better if {changes}, and {THEIR_POSE}; {AS_GIVEN} it "
            f"would be {distance}: {CALIBRATION_QUESTION}"
        )
        uncertain = other.found.pose_covariance(answer.translation_basis)
        told = replace(
            answer,
            warnings=(*answer.warnings, sentence),
            covariance=answer.covariance + uncertain,
        )
        return Doubted(told, _changed(cameras, [other.sizes_of(view) for view in (1, 2)]))
    sentence = (
        f"the matches agree better if {changes}, with a pose that is {distance}: "
        f"{CALIBRATION_QUESTION}"
    )
    told = replace(
        given,
        warnings=(*given.warnings, sentence),
        covariance=given.covariance + _second_moment(given, answer.cam2_from_cam1),
        alternatives=(*given.alternatives, answer.cam2_from_cam1),
    )
    return Doubted(told, cameras)


def _moved_deg(pose: Pose, other: Pose) -> float:
    """Angle between the directions of two poses, seen from the view where it is larger."""
    there = translation_error_deg(pose, other)
    return max(there, translation_error_deg(pose.inverse(), other.inverse()))


def _second_moment(given: RelativePoseResult, pose: Pose) -> Array:
    """Outer product of the five numbers by which another pose differs."""
    turn = vector_from_rotation(pose.rotation @ given.cam2_from_cam1.rotation.T)
    moved = np.concatenate([turn, given.translation_basis.T @ pose.translation])
    return np.outer(moved, moved)
