# SPDX-License-Identifier: BSD-3-Clause
"""Poses of a new image that the images of a map lead to, and what confirms them."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.estimation import AbsolutePoseResult, estimate_absolute_pose
from epi360.estimation.absolute_evidence import directions_of
from epi360.estimation.image_matches import IMAGE_OPTIONS, MAX_NOISE_PX
from epi360.jobs.localization.localization_result import LocalizationOptions
from epi360.jobs.localization.map_matches import MapMatches, joined, matches_with, no_matches
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.jobs.localization.new_image import NewImage
from epi360.jobs.localization.surroundings import Surroundings, surroundings_at
from epi360.poses import Pose, angles_of_units

Array = NDArray[np.float64]

# Points of a map are less certain than key points: their own errors come on top.
_MAX_NOISE_PX = 2.0 * MAX_NOISE_PX
FIRST_VIEWS = 4  # that are looked at together, before twice as many
_RADIUS_PX = 2.0  # around the place of a point, at least
_CLEARLY_OFF = 3.0  # gates


@dataclass(frozen=True, eq=False)
class Found:
    """A pose, the matches that it was estimated from, and what the map knows around it.

    It is confirmed if the surroundings speak for it, or nobody asked them to.
    """

    result: AbsolutePoseResult
    matches: MapMatches
    around: Surroundings = Surroundings()
    is_confirmed: bool = False


class MapSearch:
    """The images of a map that look most like a new one, matched with it when they are needed."""

    def __init__(
        self,
        world: LocalizationMap,
        new: NewImage,
        without: Collection[str],
        options: LocalizationOptions,
    ) -> None:
        self.world, self.new, self.options = world, new, options
        images = world.model.images
        self.left_out = frozenset(k for k, image in enumerate(images) if image.name in without)
        similar = world.similar_views(new.features)
        self.ranked = [k for k in similar if k not in self.left_out][: options.max_views]
        self._matches: dict[int, MapMatches] = {}  # of images, also if they were not looked at
        self.looked_at: list[int] = []  # images whose matches were asked for

    def matched(self, numbers: Sequence[int]) -> list[MapMatches]:
        """Matches with each of some images."""
        for number in numbers:
            if number not in self._matches:
                view = self.world.view(number)
                self._matches[number] = matches_with(view, number, self.new.features)
            if number not in self.looked_at:
                self.looked_at.append(number)
        return [self._matches[number] for number in numbers]

    def by_camera(self, camera: Camera) -> MapSearch:
        """The search from its beginning, if the image is one of another camera.

        Nothing is matched twice, unless that camera does not see all features.
        """
        other = copy.copy(self)
        other.new = NewImage.of(self.new.features, camera, self.new.mask)
        if len(other.new.bearings) != len(self.new.bearings):
            other._matches = {}
        other.looked_at = []
        return other

    def pose_of(
        self, matches: MapMatches, guess: Pose | None = None, bearings: Array | None = None
    ) -> AbsolutePoseResult:
        """Pose of matches, from a guess where there is one; by other bearings (N, 3), if given."""
        return estimate_absolute_pose(
            self.new.bearings[matches.rows] if bearings is None else bearings,
            matches.points,
            point_covariances=matches.covariances,
            guess=guess,
            max_noise_deg=_MAX_NOISE_PX * self.new.pixel_deg,
            min_num_inliers=IMAGE_OPTIONS.min_num_inliers,
            shared_error=IMAGE_OPTIONS.shared_error,
            seed=self.options.seed,
        )

    def radius_rad(self, result: AbsolutePoseResult) -> float:
        """How far from the place of a point its feature may be."""
        return math.radians(max(result.inlier_threshold_deg, _RADIUS_PX * self.new.pixel_deg))

    def with_surroundings(self, result: AbsolutePoseResult, matches: MapMatches) -> Found:
        """A pose and what the map knows around it, if there is one to rely on."""
        if not result.success:
            return Found(result, matches)
        inliers = matches.chosen(result.inlier_mask)
        pose, radius = result.cam_from_world, self.radius_rad(result)
        around = surroundings_at(self.world, inliers, pose, self.new, radius, self.left_out)
        return Found(result, matches, around, self.options.known_place or around.confirm)

    def first_look(self) -> list[Found]:
        """Poses by the images that look most alike, by more of them until one is confirmed.

        The first says what the matches say. If they are ambiguous, each of their two poses follows.
        """
        found = [Found(self.pose_of(no_matches()), no_matches())]
        with_pose: list[Found] = []
        while len(self.looked_at) < len(self.ranked) and not any(f.is_confirmed for f in found):
            parts = self.matched(self.ranked[: max(2 * len(self.looked_at), FIRST_VIEWS)])
            matches = joined(parts)
            result = self._robust_pose(matches, parts)
            found = [self.with_surroundings(result, matches), *self._apart(result, matches)]
            if any(each.result.success for each in found):
                with_pose = found
        # More images may bring so many wrong matches that a pose of fewer ones is lost.
        return with_pose or found

    def _robust_pose(self, matches: MapMatches, parts: Sequence[MapMatches]) -> AbsolutePoseResult:
        """Pose from all matches; where that fails, from where the best single image leads."""
        result = self.pose_of(matches)
        if result.status != "too_few_inliers":
            return result
        for part in sorted(parts, key=len, reverse=True)[:FIRST_VIEWS]:
            alone = self.pose_of(part)
            if alone.success:
                return self.pose_of(matches, alone.cam_from_world)
        return result

    def _apart(self, result: AbsolutePoseResult, matches: MapMatches) -> list[Found]:
        """Both poses of ambiguous matches, each from those that the other does not explain."""
        if result.status != "ambiguous":
            return []
        poses = (result.cam_from_world, *result.alternatives)
        bearings = self.new.bearings[matches.rows]
        gate = _CLEARLY_OFF * math.radians(result.inlier_threshold_deg)
        found = []
        for pose, other in zip(poses, poses[::-1], strict=True):
            off = angles_of_units(bearings, directions_of(other, matches.points)) > gate
            rest = matches.chosen(np.asarray(off, np.bool_))
            found.append(self.with_surroundings(self.pose_of(rest, pose), rest))
        return found
