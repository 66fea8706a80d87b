# SPDX-License-Identifier: BSD-3-Clause
"""Whether the matches that do not agree with a pose agree on another one that looks right as well.

In a corridor with equal doors each pose that puts one door upon another looks right around all
doors. What is left of the matches of a right pair are wrong ones: where these agree on a pose of
their own, hardly anything around it looks as it says. Nor do key points that merely look alike
agree on another direction (`look_alikes`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from epi360.cameras import Camera
from epi360.estimation.angle_search import Estimate
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.result import ImagePairResult
from epi360.features.shared_surfaces import SharedSurfaces
from epi360.features.warped_patches import Panorama
from epi360.places.corridor import repeats_itself
from epi360.places.look_alikes import rival_direction
from epi360.places.own_evidence import OwnEvidence, grow_both
from epi360.places.same_place import bearings_of, pair_of_images
from epi360.poses import Pose, poses_agree

# What is left of narrow views, near misses of the right pose, gives its direction to 15 degrees.
_TURNED_DEG, _APART_DEG = 10.0, 30.0
# Over another place, and over a copy. Of 110 right pairs of a real tour, a real sequence and
# photographed homes none has such a second pose: the most is 2 over another place. Of corridors
# with equal doors they have 6 to 15.
_LOOKS_RIGHT = 4.0, 2.0

REPEATED = (
    "other matches agree on another pose, around which the pictures look as right: the place "
    "repeats itself, as a corridor with equal doors does"
)

LOOK_ALIKES = (
    "things that look alike agree as well on another direction: the place has many that are equal, "
    "as an office with equal desks does"
)
MANY_OTHERS = (
    "many other matches agree on another pose, around which less looks right: something large may "
    "move, or the place repeat itself"
)
_MANY = 1.0 / 3.0  # of the inliers
# A furnished room that looks much the same when it is turned by half has a second pose with 0.14 to
# 0.17 times the matches of the right one. Of corridors, a wrong one may have six times as many as
# the right one.
_COMPETING = 0.25


def is_another(first: Pose, second: Pose) -> bool:
    """Whether two poses are not one with errors."""
    return not poses_agree(first, second, _TURNED_DEG, _APART_DEG)


def looks_right(own: OwnEvidence) -> bool:
    """Whether a pose would be believed for what the pair shows by itself."""
    over_others, over_copies = _LOOKS_RIGHT
    return own.is_known and own.over_others > over_others and own.over_copies > over_copies


def competes(
    num_others: int,
    num_inliers: int,
    views: tuple[SharedSurfaces, SharedSurfaces],
    panoramas: Sequence[Panorama],
) -> bool:
    """Whether another pose that looks right may be the right one.

    Enough matches agree with it, or what it shows is a corridor, where few may.
    """
    return num_others >= _COMPETING * num_inliers or repeats_itself(views, panoramas)


def are_many(num_others: int, num_inliers: int) -> bool:
    """Whether so many other matches agree on another pose that it deserves a warning."""
    return num_others > _MANY * num_inliers


def with_rival_pose(
    result: ImagePairResult,
    cameras: tuple[Camera, Camera],
    panoramas: tuple[Panorama, Panorama],
    estimate: Estimate,
) -> ImagePairResult:
    """Return an accepted result, or both poses, if the other matches say one that looks as right.

    Or if key points that look alike agree as well on another direction. Which of the two poses is
    right nothing tells, so that the status is "planar_ambiguous", as that of other pairs with two
    poses. A second pose of many matches that looks less right is a warning.
    """
    if not result.success:
        return result
    bearings = bearings_of(result, cameras)
    elsewhere = rival_direction(pair_of_images(result, bearings), panoramas, num_threads=2)
    if elsewhere is not None:
        return _with_both(result, elsewhere, LOOK_ALIKES)
    left = ~result.inlier_mask
    if np.count_nonzero(left) < IMAGE_OPTIONS.min_num_inliers:
        return result
    other = estimate(*(np.where(left[:, None], each, np.nan) for each in bearings))
    if not other.success or not is_another(result.cam2_from_cam1, other.cam2_from_cam1):
        return result
    pair = pair_of_images(other, bearings)
    views = grow_both(pair, panoramas, num_threads=2)
    counts = other.num_inliers, result.num_inliers
    if not (looks_right(OwnEvidence.of(pair, views)) and competes(*counts, views, panoramas)):
        if not are_many(*counts):
            return result
        return replace(result, warnings=(*result.warnings, MANY_OTHERS))
    return _with_both(result, other.cam2_from_cam1, REPEATED)


def _with_both(result: ImagePairResult, other: Pose, warning: str) -> ImagePairResult:
    """Both poses, of which nothing tells which is right."""
    return replace(
        result,
        status="planar_ambiguous",
        alternatives=(other, *result.alternatives),
        probability=0.5 * result.probability,
        warnings=(*result.warnings, warning),
    )
