# SPDX-License-Identifier: BSD-3-Clause
"""Two images to a pose: the whole flow on one page."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import smallest_pixel_deg
from epi360.estimation import (
    ImagePairResult,
    RelativePoseResult,
    estimate_relative_pose,
)
from epi360.estimation.angle_search import Bearings
from epi360.estimation.calibration_doubt import Doubted, with_calibration_doubt
from epi360.estimation.image_matches import IMAGE_OPTIONS as IMAGE_OPTIONS
from epi360.estimation.image_matches import noise_of_keypoints
from epi360.estimation.lens_beside_panorama import with_focal_uncertainty
from epi360.estimation.options import check_threshold
from epi360.estimation.seen_through import without_what_is_seen_through
from epi360.estimation.sky_motion import with_ground_motion
from epi360.estimation.verdict import noise_in_pixels
from epi360.features import Features, ImageSource, extract_features, match_features
from epi360.features.detection import (
    CONTRAST_THRESHOLD,
    FAINT_CONTRAST_THRESHOLD,
    SMALLEST_WIDTH,
    check_options,
)
from epi360.features.image_cameras import find_camera
from epi360.features.images import read_masked_image
from epi360.features.warped_patches import Panorama
from epi360.places.repeated_place import with_rival_pose
from epi360.places.same_place import can_be_compared, look_around
from epi360.second_look import is_precise, is_settled, later_is_better

# Of the 55 pairs of a real sequence 2688 pixels wide, a first look at this width settles most, in a
# third of the time and with the same errors.
_FIRST_LOOK_WIDTH = 1920


def relative_pose_of_images(
    image1: ImageSource,
    image2: ImageSource,
    *,
    camera1: Camera | None = None,
    camera2: Camera | None = None,
    mask1: ImageSource | None = None,
    mask2: ImageSource | None = None,
    mask_nadir_deg: float = 0.0,
    gravity1: ArrayLike | None = None,
    gravity2: ArrayLike | None = None,
    gravity_sigma_deg: float = 1.0,
    inlier_threshold_deg: float | Literal["auto"] = "auto",
    max_width: int = 4096,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> ImagePairResult:
    """Relative pose of two images: features, matches, robust estimate.

    Parameters
    ----------
    image1, image2 : path or array
        What ``read_image`` takes; their sizes may differ.
    camera1, camera2 : Camera, optional
        Default: a full equirectangular panorama of the image's size, or the part of one that the
        GPano metadata of a file state.
    mask1, mask2 : path or array, optional
        White = use; of the image's size.
    mask_nadir_deg : float
        Ignore this angle around straight down in both images.
    gravity1, gravity2 : array_like, shape (3,), optional
        Direction of gravity (down) in both cameras; (0, 1, 0) for upright panoramas.
    gravity_sigma_deg : float
        Standard deviation of the directions of gravity, per axis and view.
    inlier_threshold_deg : float or "auto"
        As in ``estimate_relative_pose``.
    max_width : int
        Wider images are searched at this width; key points are in pixels of the originals.
    seed : int
        Random seed of the sampling; the same images and seed give the same result.
    progress : callable, optional
        Gets a few words at the start of each stage.

    Returns
    -------
    result : ImagePairResult
        With the matched key points; look at ``status`` first.

    Raises
    ------
    ValueError
        If an image, camera, mask or option cannot be used.
    FileNotFoundError
        If a file is not there.

    Notes
    -----
    Wide images are searched at 1920 pixels first; only where that does not settle the pose, at
    their full width; and where the verdict is still not "ok", for fainter features. What both
    cameras must see around the matches is compared, unless they see less than a fifth of the
    sphere: matches on a thing that stands in another place too, or that moves along, agree on a
    pose of their own. So may the matches that are left; if their pose looks as right, both are
    given. Where only the sky of panoramas agrees with a pose, the ground is asked, and a pose that
    needs other angles of the cameras is compared by these.
    """
    check_options(max_width, mask_nadir_deg)
    check_threshold(inlier_threshold_deg)
    say = progress or (lambda _: None)
    say("reading images")
    sources = (
        (image1, camera1, mask1, mask_nadir_deg, "image1", "mask1"),
        (image2, camera2, mask2, mask_nadir_deg, "image2", "mask2"),
    )
    with ThreadPoolExecutor(2) as pool:
        view1, view2 = pool.map(lambda source: _View.read(*source), sources)
    views = (view1, view2)
    estimate = partial(
        estimate_relative_pose,
        gravity1=gravity1,
        gravity2=gravity2,
        gravity_sigma_deg=gravity_sigma_deg,
        inlier_threshold_deg=inlier_threshold_deg,
        options=IMAGE_OPTIONS,
        seed=seed,
    )
    best: ImagePairResult | None = None
    for search in _searches(views, max_width):
        say(f"finding features ({search.max_width} pixels wide)")
        with ThreadPoolExecutor(2) as pool:
            features1, features2 = pool.map(lambda view, s=search: view.features(s), views)
        say("matching features and estimating the pose")
        result = _estimated(views, features1, features2, estimate)
        if best is None or later_is_better(best.status, result.status):
            best = result
        if is_precise(best) or (search.is_full and is_settled(best.status)):
            break
    assert best is not None
    bearings1, bearings2 = (
        view.camera.bearings_from_pixels(keypoints)
        for view, keypoints in zip(views, (best.keypoints1, best.keypoints2), strict=True)
    )
    told = asked_again(best, (bearings1, bearings2), (view1.camera, view2.camera), estimate)
    best = _with_keypoints(told.result, best.keypoints1, best.keypoints2, told.cameras)
    camera1, camera2 = told.cameras
    if not best.success or camera1 is None or camera2 is None:
        return best
    if not (can_be_compared(camera1) and can_be_compared(camera2)):
        return best
    say("comparing what both cameras must see")
    seen = replace(view1, camera=camera1), replace(view2, camera=camera2)
    with ThreadPoolExecutor(2) as pool:
        panorama1, panorama2 = pool.map(_View.panorama, seen)
    cameras, panoramas = (camera1, camera2), (panorama1, panorama2)
    again = partial(estimate, **noise_of_keypoints(smallest_pixel_deg(cameras)))
    return with_rival_pose(look_around(best, cameras, panoramas), cameras, panoramas, again)


@dataclass(frozen=True)
class _Search:
    """How hard to look for features."""

    max_width: int
    contrast_threshold: float
    is_full: bool


def _searches(views: tuple[_View, _View], max_width: int) -> list[_Search]:
    """List a first look at moderate size, the full size, and fainter features as a last resort.

    An easy pair does not pay for a hard one.
    """
    full = max(SMALLEST_WIDTH, min(max_width, max(view.camera.width for view in views)))
    searches = [
        _Search(full, CONTRAST_THRESHOLD, True),
        _Search(full, FAINT_CONTRAST_THRESHOLD, True),
    ]
    if full > 1.25 * _FIRST_LOOK_WIDTH:
        searches.insert(0, _Search(_FIRST_LOOK_WIDTH, CONTRAST_THRESHOLD, False))
    return searches


def _estimated(
    views: tuple[_View, _View],
    features1: Features,
    features2: Features,
    estimate: Callable[..., RelativePoseResult],
) -> ImagePairResult:
    matches = match_features(features1, features2)
    keypoints1 = features1.keypoints[matches[:, 0]]
    keypoints2 = features2.keypoints[matches[:, 1]]
    cameras = (views[0].camera, views[1].camera)
    result = estimate(
        cameras[0].bearings_from_pixels(keypoints1),
        cameras[1].bearings_from_pixels(keypoints2),
        **noise_of_keypoints(smallest_pixel_deg(cameras)),
    )
    return _with_keypoints(result, keypoints1, keypoints2, cameras)


def asked_again(
    result: RelativePoseResult,
    bearings: Bearings,
    cameras: tuple[Camera, Camera],
    estimate: Callable[..., RelativePoseResult],
) -> Doubted:
    """What the matches of two images say in the end, and the cameras that this pose belongs to.

    The ground is asked where only the sky agrees, then what is left where inliers would be seen
    through a surface, then whether other angles of the cameras explain more, and what the focal
    length of a lens beside a panorama leaves open; see `with_ground_motion`,
    `without_what_is_seen_through`, `with_calibration_doubt` and `with_focal_uncertainty`. Warnings
    have noise in pixels.
    """
    pixel_deg = smallest_pixel_deg(cameras)
    again = partial(estimate, **noise_of_keypoints(pixel_deg))
    grounded = with_ground_motion(result, bearings, cameras, again)
    seen = without_what_is_seen_through(grounded, bearings, again)
    told = with_calibration_doubt(seen, bearings, cameras, again)
    result = told.result
    if told.cameras == cameras:  # others are uncertain by what the matches say of them
        result = with_focal_uncertainty(result, bearings, cameras)
    return told._replace(result=noise_in_pixels(result, pixel_deg))


@dataclass(frozen=True)
class _View:
    """One image with its camera and mask, checked."""

    picture: NDArray[np.uint8]
    camera: Camera
    mask: NDArray[np.bool_] | None
    mask_nadir_deg: float

    @classmethod
    def read(
        cls,
        image: ImageSource,
        camera: Camera | None,
        mask: ImageSource | None,
        mask_nadir_deg: float,
        name: str,
        mask_name: str,
    ) -> _View:
        picture, usable = read_masked_image(image, mask, name=name, mask_name=mask_name)
        camera = find_camera(image, picture, camera, name)
        return cls(picture, camera, usable, mask_nadir_deg)

    def panorama(self) -> Panorama:
        return Panorama.seen_by(self.camera, self.picture, self.mask, self.mask_nadir_deg)

    def features(self, search: _Search) -> Features:
        return extract_features(
            self.picture,
            self.camera,
            self.mask,
            mask_nadir_deg=self.mask_nadir_deg,
            max_width=search.max_width,
            contrast_threshold=search.contrast_threshold,
        )


def _with_keypoints(
    result: RelativePoseResult,
    keypoints1: NDArray[Any],
    keypoints2: NDArray[Any],
    cameras: tuple[Camera | None, Camera | None],
) -> ImagePairResult:
    values = {field.name: getattr(result, field.name) for field in fields(RelativePoseResult)}
    return ImagePairResult(**values, keypoints1=keypoints1, keypoints2=keypoints2, cameras=cameras)
