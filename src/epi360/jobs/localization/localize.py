# SPDX-License-Identifier: BSD-3-Clause
"""The pose of a new image in a map: the whole flow on one page."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.estimation import AbsolutePoseResult
from epi360.estimation.absolute_result import no_pose
from epi360.features import Features, ImageSource
from epi360.features.image_cameras import find_camera
from epi360.features.images import read_masked_image
from epi360.jobs.localization.camera_by_map import Place, place_and_camera
from epi360.jobs.localization.localization_result import LocalizationOptions, LocalizationResult
from epi360.jobs.localization.map_matches import MapMatches, SecondLook, joined, look_again
from epi360.jobs.localization.map_search import FIRST_VIEWS, Found, MapSearch
from epi360.jobs.localization.map_views import LocalizationMap
from epi360.jobs.localization.new_image import NewImage

Mask = NDArray[np.bool_]

_NUM_AROUND = 4  # further images of the map that the second look takes in
# A right pose shows more of the map's points than poses that are turned away; of those on rendered
# homes the right ones at least five times as many.
_LEAST_LIFT = 1.5


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
    TypeError
        If the map, the names in ``without`` or the options are something else.

    Notes
    -----
    Four images of the map that look most alike are matched first, then more of them until a pose is
    found and confirmed: most of what the map's images around it have in sight must look the same in
    the new image. Then the next ones that show other places are asked. Where nothing confirms a
    pose, or another place explains half as much of the view, the verdict is "ambiguous". The pose
    says where every point of these images and of those around must be, and what looks alike there
    is matched as well; the pose is refined with all, unless poses that are turned away show as
    much.
    """
    begun = time.perf_counter()
    _check(world, without, options)
    picture, usable = read_masked_image(image, mask)
    camera = _camera_of(image, picture, camera, world)
    path = os.fspath(image) if isinstance(image, str | os.PathLike) else None
    features = world.source.of_new(picture, camera, usable, options.mask_nadir_deg, path)
    found = localize_features(features, camera, world, frozenset(without), options, usable)
    return dataclasses.replace(found, seconds=time.perf_counter() - begun)


def _check(world: LocalizationMap, without: Sequence[str], options: LocalizationOptions) -> None:
    if not isinstance(world, LocalizationMap):
        raise TypeError(f"world must be what load_map returns, got {type(world).__name__}")
    if not isinstance(options, LocalizationOptions):
        raise TypeError(f"options must be LocalizationOptions, got {type(options).__name__}")
    if isinstance(without, str):
        raise TypeError(f"without must be a sequence of names, got the string {without!r}")


def _camera_of(
    image: ImageSource, picture: NDArray[np.uint8], camera: Camera | None, world: LocalizationMap
) -> Camera:
    try:
        return find_camera(image, picture, camera, "image")
    except ValueError as error:
        height, width = picture.shape[:2]
        known = world.camera_of_size(width, height) if camera is None else None
        if known not in (None, Equirectangular(width, height)):
            return known
        several = world.names_of_size(width, height) if camera is None else []
        if len(several) < 2:  # or the raw frame of a 360 camera
            raise
        names = ", ".join(several)
        raise ValueError(f"{error}; the map has {len(several)} of this size: {names}") from None


def localize_features(
    features: Features,
    camera: Camera,
    world: LocalizationMap,
    without: frozenset[str],
    options: LocalizationOptions,
    mask: Mask | None = None,
) -> LocalizationResult:
    """`localize_image` for an image whose features are known."""
    new = NewImage.of(features, camera, mask)
    place = place_and_camera(MapSearch(world, new, without, options))
    search, found = place.search, place.found
    if not found.result.success:
        return _as_result(search, found)
    return _refined(place, _second_look(search, found))


def _second_look(search: MapSearch, found: Found) -> SecondLook:
    """Look for the points of the images that agree with the pose, and of those around it."""
    result, world = found.result, search.world
    numbers, counts = np.unique(found.matches.views[result.inlier_mask], return_counts=True)
    agreeing = [int(k) for k in numbers[np.argsort(-counts, kind="stable")]]
    known = search.left_out.union(agreeing)
    around = [k for k in world.covisible(agreeing[0]) if k not in known][:_NUM_AROUND]
    views = [(k, world.view(k)) for k in [*agreeing[:FIRST_VIEWS], *around]]
    return look_again(views, search.new, result.cam_from_world, search.radius_rad(result))


def _refined(place: Place, second: SecondLook) -> LocalizationResult:
    """Pose from the matches of both looks, with the verdict on the first."""
    search, found = place.search, place.found
    result, matches = found.result, found.matches
    if second.seen_share < _LEAST_LIFT * second.chance_share:
        refused = dataclasses.replace(found, result=_refused(result, second))
        return _with_shares(_as_result(search, refused), second)
    both = joined([matches.chosen(result.inlier_mask), second.matches])
    final, used = search.pose_of(both, result.cam_from_world), both
    if final.success and final.num_inliers >= result.num_inliers:
        final = dataclasses.replace(final, probability=result.probability, warnings=result.warnings)
    else:
        final, used = result, matches
    final = place.with_camera_uncertainty(final, used)
    shown = _as_result(search, dataclasses.replace(found, result=final), used)
    return _with_shares(shown, second)


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


def _as_result(
    search: MapSearch, found: Found, used: MapMatches | None = None
) -> LocalizationResult:
    """What was found, with the matches that the last pose was estimated from."""
    result, matches = found.result, found.matches
    used = matches if used is None else used
    values = {
        field.name: getattr(result, field.name) for field in dataclasses.fields(AbsolutePoseResult)
    }
    return LocalizationResult(
        **values,
        camera=search.new.camera,
        keypoints=search.new.features.keypoints[used.rows],
        points=used.points,
        point_ids=used.ids,
        num_matches=len(matches),
        map_images=_names_by_inliers(search, used, result),
        same_share=found.around.share,
    )


def _names_by_inliers(
    search: MapSearch, matches: MapMatches, result: AbsolutePoseResult
) -> tuple[str, ...]:
    images = search.world.model.images
    counts = np.bincount(matches.views[result.inlier_mask], minlength=len(images))
    ordered = sorted(search.looked_at, key=lambda number: -int(counts[number]))
    return tuple(images[number].name for number in ordered)
