# SPDX-License-Identifier: BSD-3-Clause
"""How an image is localized in a map, and what came of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.estimation import AbsolutePoseResult

Array = NDArray[np.float64]


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
    known_place : bool
        The map has the place that the image shows, so that it is no room that looks alike. Poses
        are accepted even where most of the place has changed since the map was made.
    keep_cameras : bool
        The camera stays as it is given, also where the points of the map agree clearly better with
        other angles. A warning says so then, and the covariance has how far their pose is away.
    """

    max_views: int = 16
    mask_nadir_deg: float = 0.0
    seed: int = 0
    known_place: bool = False
    keep_cameras: bool = False

    def __post_init__(self) -> None:
        """Check the values."""
        if self.max_views < 1:
            raise ValueError(f"max_views must be at least 1, got {self.max_views}")
        if not 0.0 <= self.mask_nadir_deg < 180.0:
            raise ValueError(f"mask_nadir_deg must be in [0, 180), got {self.mask_nadir_deg}")


@dataclass(frozen=True, kw_only=True, repr=False)
class LocalizationResult(AbsolutePoseResult):
    """Pose of a new image in a map and the evidence for it.

    The arrays have a row for each match of the last look: a feature of the image and a point of the
    map that it may show. `status` and `probability` are the verdict on the matches by descriptors
    alone, before the pose guides the search for more, and on what the map knows around the pose. A
    pose in a place of which the image shows too little is "ambiguous": it may be that of a copy.

    Attributes
    ----------
    camera : Camera
        Camera of the image: that which was given, or if the points of the map agree better with
        another focal length, the lens that has it; a warning says so then.
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
    same_share : float
        Share of the parts of the view in which an image of the map has points in sight that look
        the same as there, by the image that speaks most for the pose. NaN without a pose.
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
    same_share: float = math.nan
    seconds: float = math.nan

    _SHOWN: ClassVar[tuple[str, ...]] = (
        "status", "probability", "num_inliers", "num_matches", "noise_deg", "rotation_sigma_deg",
        "position_sigma", "cam_from_world", "map_images", "alternatives", "warnings",
    )  # fmt: skip
