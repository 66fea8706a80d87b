# SPDX-License-Identifier: BSD-3-Clause
"""What the points of a map say of the camera of a new image, and what becomes of its pose."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from epi360.cameras import Camera
from epi360.estimation import AbsolutePoseResult
from epi360.estimation.absolute_angles import (
    AnglesByPoints,
    SeenPoints,
    angles_by_points,
    with_focal_uncertainty_by_points,
)
from epi360.estimation.angle_words import change_in_words
from epi360.estimation.calibration_doubt import AS_GIVEN, CALIBRATION_QUESTION, THEIR_POSE
from epi360.jobs.localization.map_matches import MapMatches, joined
from epi360.jobs.localization.map_search import Found, MapSearch
from epi360.jobs.localization.other_places import find_place
from epi360.poses import Pose, rotation_error_deg, vector_from_rotation

_MOST_MATCHES = 800  # that are asked for other angles


class Place(NamedTuple):
    """Where an image was found, by the camera of the search.

    If the map's points agree better with other angles than this one has, ``doubted`` is the pose
    that these say.
    """

    search: MapSearch
    found: Found
    doubted: Pose | None = None

    def with_camera_uncertainty(
        self, result: AbsolutePoseResult, matches: MapMatches
    ) -> AbsolutePoseResult:
        """The pose with what is open of the camera in its covariance."""
        if self.doubted is None:
            return with_focal_uncertainty_by_points(result, _seen(self.search, matches))
        pose, other = result.cam_from_world, self.doubted
        turn = vector_from_rotation(other.rotation @ pose.rotation.T)
        moved = np.concatenate([turn, other.translation - pose.translation])
        return replace(result, covariance=result.covariance + np.outer(moved, moved))


def place_and_camera(search: MapSearch) -> Place:
    """Place that the image and the map speak for, and the search by the camera that it belongs to.

    That is another lens than the given one if the map's points agree better with one, and it may
    change. If others would do nearly as well, as before one wall, the given one stays and is
    doubted, and so is a panorama, and a lens of which one factor of angles is no focal length.
    """
    found = find_place(search)
    has_pose = found.result.num_inliers > 0
    matches = found.matches if has_pose else joined(search.matched(search.looked_at))
    other = _other_angles(search, found.result, matches)
    if other is None:
        return Place(search, found)
    doubt = _doubt(other, search.new.camera)
    apart = _apart(found.result.cam_from_world, other.answer.cam_from_world)
    if search.options.keep_cameras and not has_pose:
        return Place(search, _told(found, f"{doubt}; {AS_GIVEN} there is no pose"))
    may_change = other.is_certain and not search.options.keep_cameras
    if other.camera is not None and may_change:
        again = search.by_camera(other.camera)
        place = find_place(again)
        if place.result.success:
            before = f"it would be {apart}" if has_pose else "there is none to rely on"
            return Place(again, _told(place, f"{doubt}, and {THEIR_POSE}; {AS_GIVEN} {before}"))
    if not has_pose:
        return Place(search, found)
    told = _told(found, f"{doubt}, with a pose that is {apart}")
    return Place(search, told, other.answer.cam_from_world)


def _other_angles(
    search: MapSearch, result: AbsolutePoseResult, matches: MapMatches
) -> AnglesByPoints | None:
    """Other angles that some hundreds of the matches, evenly spaced, agree better with."""
    rows = np.arange(len(matches))[:: 1 + len(matches) // _MOST_MATCHES]
    some = matches.chosen(rows)
    if result.num_inliers:
        mask, residuals = result.inlier_mask[rows], result.residuals_rad[rows]
        result = replace(result, inlier_mask=mask, residuals_rad=residuals)
    return angles_by_points(
        result,
        _seen(search, some),
        lambda bearings, guess: search.pose_of(some, guess, bearings),
    )


def _seen(search: MapSearch, matches: MapMatches) -> SeenPoints:
    bearings = search.new.bearings[matches.rows]
    return SeenPoints(search.new.camera, bearings, matches.points, matches.covariances)


def _doubt(other: AnglesByPoints, camera: Camera) -> str:
    words = [change_in_words(each, other.changes, "the image", camera) for each in other.clear]
    return f"the points of the map agree better if {' and '.join(dict.fromkeys(words))}"


def _apart(pose: Pose, other: Pose) -> str:
    """How far apart two poses are, in the unit of the map."""
    moved = np.linalg.norm(pose.inverse().translation - other.inverse().translation)
    return f"{moved:.3g} away and turned by {rotation_error_deg(pose, other):.1f} degrees"


def _told(found: Found, sentence: str) -> Found:
    """The place with a sentence about the camera."""
    result = found.result
    warnings = (*result.warnings, f"{sentence}: {CALIBRATION_QUESTION}")
    return replace(found, result=replace(result, warnings=warnings))
