# SPDX-License-Identifier: BSD-3-Clause
"""Images to matched key points in continuous pixels; seam, poles and masks are handled here."""

from epi360.features.detection import Features, extract_features
from epi360.features.images import (
    ImageSource,
    looks_like_dual_fisheye,
    nadir_mask,
    read_image,
    read_mask,
    require_panorama,
)
from epi360.features.matching import match_features
from epi360.features.tracking import Tracks, track_features

__all__ = [
    "Features", "ImageSource", "Tracks", "extract_features", "looks_like_dual_fisheye",
    "match_features", "nadir_mask", "read_image", "read_mask", "require_panorama", "track_features",
]  # fmt: skip
