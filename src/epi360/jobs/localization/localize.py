# SPDX-License-Identifier: BSD-3-Clause
"""The pose of a new image in a map: the whole flow on one page."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.estimation import AbsolutePoseResult, estimate_absolute_pose
from epi360.estimation.absolute_evidence import num_cells
from epi360.estimation.absolute_result import no_pose
from epi360.features import Features, ImageSource, read_image
from epi360.features.image_cameras import find_camera
from epi360.jobs.localization.map_matches import (
    MapMatches,
    SecondLook,
    joined,
    look_again,
    matches_with,
    no_matches,
)
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.jobs.localization.other_places import Found, PoseOf, other_places, with_rival
from epi360.poses import Pose
from epi360.two_view import MAX_NOISE_PX, smallest_pixel_deg

Array = NDArray[np.float64]

# Points of a map are less certain than key points: their own errors come on top.
_MAX_NOISE_PX = 2.0 * MAX_NOISE_PX
_MIN_INLIERS, _SHARED_ERROR = 15, 1.0  # as for pairs of images
_FIRST_VIEWS = 4  # that are looked at together, before twice as many
_NUM_AROUND = 4  # further images of the map that the second look takes in
_RADIUS_PX = 2.0  # of the second look, at least
# A right pose shows more of the map's points than poses that are turned away; of those on rendered
# homes the right ones at least five times as many.
_LEAST_LIFT = 1.5
# Of the cells with features, those with an inlier. In copies of a room (two rendered homes) wrong
# poses reach 0.66; right ones have more where the map has seen the room from about there.
_LEAST_COVERAGE = 0.7


@dataclass(frozen=True)
class LocalizationOptions:
    """How a new image is localized.

    Parameters
    ----------
    max_views : int
        Images of the map that are matched with the new one, those that look most like it first.
    mask_nadir_deg : float
        Ignored around straight down (+y) in the new image.
    seed : int
        Random seed of the sampling.
    """

    max_views: int = 16
    mask_nadir_deg: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the values."""
        if self.max_views < 1:
            raise ValueError(f"max_views must be at least 1, got {self.max_views}")
        if not 0.0 <= self.mask_nadir_deg < 180.0:
            raise ValueError(f"mask_nadir_deg must be in [0, 180), got {self.mask_nadir_deg}")


@dataclass(frozen=True, kw_only=True)
class LocalizationResult(AbsolutePoseResult):
    """Pose of a new image in a map and the evidence for it.

    The arrays have a row for each match of the last look: a feature of the image and a point of the
    map that it may show. `status` and `probability` are the verdict on the matches by descriptors
    alone, before the pose guides the search for more.

    Attributes
    ----------
    camera : Camera
        Camera of the image.
    keypoints : ndarray, shape (N, 2)
        Continuous pixels of the image.
    points : ndarray, shape (N, 3)
        Points in the world.
    point_ids : ndarray, shape (N,)
        Rows of the points in the model; larger numbers are points that are not in it, of features
        that were found anew.
    num_matches : int
        Matches by descriptors alone.
    map_images : tuple of str
        Images of the map that were matched, those with most inliers first.
    seen_share, chance_share : float
        Share of the points in sight for which the image has a similar feature in place; the same
        for poses that are turned by 7 degrees. NaN without a pose.
    seconds : float
        Wall time.
    """

    camera: Camera
    keypoints: Array
    points: Array
    point_ids: NDArray[np.int64]
    num_matches: int
    map_images: tuple[str, ...]
    seen_share: float = math.nan
    chance_share: float = math.nan
    seconds: float = math.nan


def localize_image(
    image: ImageSource,
    world: LocalizationMap,
    *,
    camera: Camera | None = None,
    mask: ImageSource | None = None,
    without: Sequence[str] = (),
    options: LocalizationOptions = LocalizationOptions(),  # noqa: B008 - frozen
) -> LocalizationResult:
    """Pose of a new image in a map.

    Parameters
    ----------
    image : path or array
        What ``read_image`` takes.
    world : LocalizationMap
        What `load_map` returns.
    camera : Camera, optional
        Default: a full panorama of the image's size, or the part of one that the GPano metadata of
        a file state; for other images the map's only camera of their size.
    mask : path or array, optional
        White = use; of the image's size.
    without : sequence of str
        Names of images of the map that are not looked at, such as the image itself.
    options : LocalizationOptions
        How it is done.

    Returns
    -------
    result : LocalizationResult
        Look at ``status`` first: "ok", or the reason why there is no pose to rely on.

    Raises
    ------
    ValueError
        If image, camera and mask do not fit together, or the image is no panorama and no camera is
        known.
    FileNotFoundError
        If a file is not there.

    Notes
    -----
    Four images of the map that look most alike are matched first, then more of them while the
    verdict is not "ok". Then the next ones that show other places are asked: where they explain
    half as much of the view by another pose, the verdict is "ambiguous". The pose says where every
    point of these images and of those around must be, and what looks alike there is matched as
    well; the pose is refined with all, unless poses that are turned away show as much.
    """
    begun = time.perf_counter()
    picture = read_image(image)
    camera = _camera_of(image, picture, camera, world)
    path = os.fspath(image) if isinstance(image, str | os.PathLike) else None
    features = world.source.of_new(picture, camera, mask, options.mask_nadir_deg, path)
    found = localize_features(features, camera, world, frozenset(without), options)
    return dataclasses.replace(found, seconds=time.perf_counter() - begun)


def _camera_of(
    image: ImageSource, picture: NDArray[np.uint8], camera: Camera | None, world: LocalizationMap
) -> Camera:
    try:
        return find_camera(image, picture, camera, "image")
    except ValueError:
        height, width = picture.shape[:2]
        known = world.camera_of_size(width, height) if camera is None else None
        if known in (None, Equirectangular(width, height)):  # the raw frame of a 360 camera
            raise
        return known


def localize_features(
    features: Features,
    camera: Camera,
    world: LocalizationMap,
    without: frozenset[str],
    options: LocalizationOptions,
) -> LocalizationResult:
    """`localize_image` for an image whose features are known."""
    bearings = camera.bearings_from_pixels(features.keypoints)
    # Features of another program may lie where a lens sees nothing.
    is_seen = np.isfinite(bearings[:, 0])
    features, bearings = features.chosen(is_seen), bearings[is_seen]
    ranked = [
        number
        for number in world.similar_views(features)
        if world.model.images[number].name not in without
    ][: options.max_views]
    parts: dict[int, MapMatches] = {}

    def matched(numbers: Sequence[int]) -> list[MapMatches]:
        for number in numbers:
            if number not in parts:
                parts[number] = matches_with(world.view(number), number, features)
        return [parts[number] for number in numbers]

    def pose_of(matches: MapMatches, guess: Pose | None = None) -> AbsolutePoseResult:
        return _pose_of(matches, bearings, camera, options, guess)

    found = Found(pose_of(no_matches()), no_matches())
    while len(parts) < len(ranked) and not found.result.success:
        looked_at = matched(ranked[: max(2 * len(parts), _FIRST_VIEWS)])
        matches = joined(looked_at)
        found = Found(_robust_pose(matches, looked_at, pose_of), matches)
    if found.result.success:
        found = with_rival(found, matched(other_places(world, found, ranked)), bearings, pose_of)
    result, matches = found.result, found.matches
    views = _names_by_inliers(world, list(parts), matches, result)
    if not result.success:
        return _with_matches(result, matches, features, camera, views, len(matches))
    second = _second_look(world, matches, result, features, bearings, camera)
    return _refined(result, matches, second, features, bearings, camera, views, options)


def _robust_pose(
    matches: MapMatches, parts: Sequence[MapMatches], pose_of: PoseOf
) -> AbsolutePoseResult:
    """Pose from all matches; where that fails, from where the best single image leads."""
    result = pose_of(matches, None)
    if result.status != "too_few_inliers":
        return result
    for part in sorted(parts, key=len, reverse=True)[:_FIRST_VIEWS]:
        alone = pose_of(part, None)
        if alone.success:
            return pose_of(matches, alone.cam_from_world)
    return result


def _pose_of(
    matches: MapMatches,
    bearings: Array,
    camera: Camera,
    options: LocalizationOptions,
    guess: Pose | None,
) -> AbsolutePoseResult:
    return estimate_absolute_pose(
        bearings[matches.rows],
        matches.points,
        point_covariances=matches.covariances,
        guess=guess,
        max_noise_deg=_MAX_NOISE_PX * smallest_pixel_deg((camera, camera)),
        min_num_inliers=_MIN_INLIERS,
        shared_error=_SHARED_ERROR,
        seed=options.seed,
    )


def _second_look(
    world: LocalizationMap,
    matches: MapMatches,
    result: AbsolutePoseResult,
    features: Features,
    bearings: Array,
    camera: Camera,
) -> SecondLook:
    """Look for the points of the images that agree with the pose, and of those around it."""
    numbers, counts = np.unique(matches.views[result.inlier_mask], return_counts=True)
    agreeing = [int(k) for k in numbers[np.argsort(-counts, kind="stable")]]
    around = [k for k in world.covisible(agreeing[0]) if k not in agreeing][:_NUM_AROUND]
    chosen = [*agreeing[:_FIRST_VIEWS], *around]
    pixel_rad = math.radians(smallest_pixel_deg((camera, camera)))
    radius = max(math.radians(result.inlier_threshold_deg), _RADIUS_PX * pixel_rad)
    views = [(number, world.view(number)) for number in chosen]
    return look_again(views, features, bearings, camera, result.cam_from_world, radius)


def _refined(
    result: AbsolutePoseResult,
    matches: MapMatches,
    second: SecondLook,
    features: Features,
    bearings: Array,
    camera: Camera,
    views: tuple[str, ...],
    options: LocalizationOptions,
) -> LocalizationResult:
    """Pose from the matches of both looks, with the verdict on the first."""
    if second.seen_share < _LEAST_LIFT * second.chance_share:
        refused = _refused(result, second)
        shown = _with_matches(refused, matches, features, camera, views, len(matches))
        return _with_shares(shown, second)
    both = joined([matches.chosen(result.inlier_mask), second.matches])
    final = _pose_of(both, bearings, camera, options, result.cam_from_world)
    if final.success and final.num_inliers >= result.num_inliers:
        final = dataclasses.replace(final, probability=result.probability, warnings=result.warnings)
        used = both
    else:
        final, used = result, matches
    shown = _with_matches(final, used, features, camera, views, len(matches))
    cells = num_cells(bearings[used.rows[shown.inlier_mask]])
    warnings = shown.warnings + _doubts(cells, num_cells(bearings))
    return dataclasses.replace(_with_shares(shown, second), warnings=warnings)


def _with_shares(result: LocalizationResult, second: SecondLook) -> LocalizationResult:
    return dataclasses.replace(
        result, seen_share=second.seen_share, chance_share=second.chance_share
    )


def _refused(result: AbsolutePoseResult, second: SecondLook) -> AbsolutePoseResult:
    """No pose, because the image shows no more of what the map expects than by chance."""
    beyond_chance = max(0.0, 1.0 - second.chance_share / max(second.seen_share, 1e-9))
    return dataclasses.replace(
        no_pose(len(result.inlier_mask), "too_few_inliers"),
        probability=result.probability * beyond_chance,
        alternatives=(result.cam_from_world,),
        noise_deg=result.noise_deg,
        inlier_threshold_deg=result.inlier_threshold_deg,
    )


def _doubts(cells: int, cells_of_features: int) -> tuple[str, ...]:
    """A sentence where a right pose in an unchanged place would explain more of the view."""
    if cells >= _LEAST_COVERAGE * cells_of_features:
        return ()
    return (
        f"the map explains {cells} of {cells_of_features} parts of the view: it knows little of "
        "the rest, the place has changed, or it is another one that looks alike",
    )


def _names_by_inliers(
    world: LocalizationMap,
    looked_at: Sequence[int],
    matches: MapMatches,
    result: AbsolutePoseResult,
) -> tuple[str, ...]:
    counts = np.bincount(matches.views[result.inlier_mask], minlength=len(world.model.images))
    ordered = sorted(looked_at, key=lambda number: -int(counts[number]))
    return tuple(world.model.images[number].name for number in ordered)


def _with_matches(
    result: AbsolutePoseResult,
    matches: MapMatches,
    features: Features,
    camera: Camera,
    views: tuple[str, ...],
    num_matches: int,
) -> LocalizationResult:
    values = {
        field.name: getattr(result, field.name) for field in dataclasses.fields(AbsolutePoseResult)
    }
    return LocalizationResult(
        **values,
        camera=camera,
        keypoints=features.keypoints[matches.rows],
        points=matches.points,
        point_ids=matches.ids,
        num_matches=num_matches,
        map_images=views,
    )
