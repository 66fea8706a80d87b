# SPDX-License-Identifier: BSD-3-Clause
"""Whether two images with a pose show one place, by what both cameras must see.

Doors, floors and furniture repeat from room to room, and what moves along with the camera agrees
with a pose of its own. So matches may agree on a pose that is wrong. What surrounds them tells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.resizing import pixels_per_radian
from epi360.estimation.result import (
    LEAST_PROBABILITY,
    ImagePairResult,
    RelativePoseResult,
    SamePlace,
    with_pose_refused,
)
from epi360.features.sphere_pictures import share_seen
from epi360.features.warped_patches import Panorama
from epi360.places.corridor import shown_by_itself
from epi360.places.own_evidence import OwnEvidence, grow_both
from epi360.places.shared_points import PosedPair

Array = NDArray[np.float64]
Cameras = tuple[Camera, Camera]
Panoramas = tuple[Panorama, Panorama]

SURE = 0.95  # of poses without a warning
# What is thought of a pose that the matches alone determine, before the pictures are compared: so
# many are those of another place, or of a thing that moves, and so many of the others of a copy.
_INDOORS, _IN_THE_OPEN = (0.1, 0.02), (0.05, 0.0006)
# As much more must speak for a copy in the open; a folder says itself how common they are, of both
# kinds together.
_MORE_IN_THE_OPEN = math.log(_INDOORS[1] / _IN_THE_OPEN[1])
_ELSEWHERE_ON_FLOOR = 0.5  # printed floors repeat from room to room
_AMONG_EQUAL_DOORS = 0.5  # of copies, whose share in corridors is in the ratio over them
_ON_ONE_WALL = (0.5, 0.5)  # so do papered walls, and right pairs are rarely on one alone
_IN_DOUBT = (0.5, 0.5)
# Of what a pair shows, so much counts. Things that move look like a copy whose owners have put
# other things there, and in photographed homes less grows than in the rendered ones of the fit.
_MOST, _LEAST_OVER_COPIES = 10.0, -5.0
# No more speaks for a pair on one wall, nor for one that sees a part of the sphere: of those of
# rendered homes through lenses of 90 to 190 degrees, the weights tell no better.
_MOST_OF_PART = 3.0
# In photographed homes less grows than in rendered ones, so this never speaks for another place;
# nor for a copy in the open, where what drives along looks like what other owners have put there.
_LEAST_IN_FOLDER = 0.0

# Around a camera that is compared: at 300 the twin rooms of the tests look alike.
_FEWEST_PIXELS, _ROUNDING = 512, 1e-6
# Of the sphere that it sees: lenses of 107 degrees and more do.
_LEAST_SEEN = 0.2

DOUBT = (
    "little of what both cameras must see around the matches looks as the pose says; the images "
    "may show two places with similar things"
)
ONE_WALL = "nearly all inliers lie on one wall, and rooms may have the same paper, tiles or doors"
EQUAL_DOORS = (
    "the place repeats itself, as a corridor with equal doors does, and little of what there is "
    "only once tells which part of it this is"
)


@lru_cache(maxsize=4096)
def can_be_compared(camera: Camera) -> bool:
    """Whether a camera sees enough of what is around it, and finely enough."""
    if share_seen(camera) < _LEAST_SEEN:
        return False
    return 2 * math.pi * pixels_per_radian(camera) >= _FEWEST_PIXELS - _ROUNDING


def look_around(result: ImagePairResult, cameras: Cameras, panoramas: Panoramas) -> ImagePairResult:
    """Compare what both images show around an accepted pose; it may be refused by that.

    The result is returned as it is if they show too little.
    """
    pair = pair_of_images(result, bearings_of(result, cameras))
    own = shown_by_itself(pair, grow_both(pair, panoramas, num_threads=2), panoramas)
    if not own.is_known:
        return result
    place = same_place(own)
    probability = result.probability * place.here
    told = replace(result, place=place, probability=probability)
    if probability < LEAST_PROBABILITY:
        told = _refused(told, looks_wrong=place.here <= result.probability)
    return replace(told, warnings=(*told.warnings, *doubts(own, place)))


def bearings_of(result: ImagePairResult, cameras: Cameras) -> tuple[Array, Array]:
    """Where all matched key points of both images look, (N, 3) each."""
    first, second = cameras
    return (
        first.bearings_from_pixels(result.keypoints1),
        second.bearings_from_pixels(result.keypoints2),
    )


def pair_of_images(result: RelativePoseResult, bearings: Sequence[Array]) -> PosedPair:
    """An accepted pose of the matches of two images with its inliers, as of images 0 and 1."""
    rows = np.flatnonzero(result.inlier_mask)
    matches = np.column_stack([rows, rows])
    return PosedPair.of(
        (0, 1), result.cam2_from_cam1, matches, bearings, noise_deg=result.noise_deg
    )


def doubts(own: OwnEvidence, place: SamePlace) -> tuple[str, ...]:
    """Warnings about a pose, by what the pair shows by itself and what that makes of it."""
    if own.on_one_wall:
        return (ONE_WALL,)
    if own.repeats:
        return (EQUAL_DOORS,) if place.here < SURE else ()
    return (DOUBT,) if LEAST_PROBABILITY <= place.here < SURE else ()


def same_place(own: OwnEvidence, copies_indoors: float = _INDOORS[1]) -> SamePlace:
    """Probabilities of the three explanations of a pose, by what the pair shows by itself.

    ``copies_indoors`` is the share of copies, of poses that are not of another place, in a room.
    """
    elsewhere, copy = _IN_THE_OPEN if own.in_the_open else (_INDOORS[0], copies_indoors)
    if own.repeats:
        copy = _AMONG_EQUAL_DOORS
    if own.inliers_on_floor or own.grown_on_floor:
        elsewhere = _ELSEWHERE_ON_FLOOR
    if own.on_one_wall:
        elsewhere, copy = _ON_ONE_WALL
    return _weighed(own, elsewhere, copy)


def same_place_in_doubt(own: OwnEvidence) -> SamePlace:
    """The same where another place, and a copy, are as probable as not before the pictures."""
    return _weighed(own, *_IN_DOUBT)


def _weighed(own: OwnEvidence, elsewhere: float, copy: float) -> SamePlace:
    """Probabilities from what was thought before the pictures were compared."""
    own = limited(own)
    weights = np.array(
        [
            (1.0 - elsewhere) * (1.0 - copy),
            elsewhere * np.exp(-own.over_others),
            (1.0 - elsewhere) * copy * np.exp(-own.over_copies),
        ]
    )
    return SamePlace(*(weights / weights.sum()).tolist())


def limited(own: OwnEvidence) -> OwnEvidence:
    """As much of the evidence as counts."""
    most = _MOST_OF_PART if own.on_one_wall or own.is_partial else _MOST
    most_over_others = 0.0 if own.grown_on_floor else most  # rooms with one floor show as much
    return replace(
        own,
        over_others=float(np.clip(own.over_others, -_MOST, most_over_others)),
        over_copies=float(np.clip(own.over_copies, _LEAST_OVER_COPIES, most)),
    )


def limited_in_folder(own: OwnEvidence, folder_in_the_open: bool = False) -> OwnEvidence:
    """As much of the evidence as counts beside that of other pairs.

    A pair on the floor or on one wall has nothing to say. Copies are rarer in the open; that
    a pair is there is only believed in a folder in the open, for some pairs of copies look so, too.
    """
    if own.inliers_on_floor or own.grown_on_floor or own.on_one_wall or not own.is_known:
        return OwnEvidence()
    own = limited(own)
    over_copies = own.over_copies
    if own.in_the_open and folder_in_the_open:
        over_copies = max(over_copies + _MORE_IN_THE_OPEN, _LEAST_IN_FOLDER)
    return replace(own, over_others=max(own.over_others, _LEAST_IN_FOLDER), over_copies=over_copies)


def _refused(result: ImagePairResult, *, looks_wrong: bool) -> ImagePairResult:
    """The result with its pose among those that are not believed.

    Unless it ``looks_wrong``, its matches are what speaks most against it.
    """
    return with_pose_refused(result, "another_place" if looks_wrong else "too_few_inliers")
