# SPDX-License-Identifier: BSD-3-Clause
"""Relative pose of 360-degree and wide fisheye images, with an uncertainty and a verdict."""

from __future__ import annotations

# Before pycolmap, whose wheels would break it: see features/picture_writing.py.
import zlib  # noqa: F401
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from epi360 import epipolar
    from epi360.cameras import (
        Camera,
        DoubleSphere,
        Equirectangular,
        ExtendedUnified,
        KannalaBrandt,
        Pinhole,
        UnifiedCamera,
        load_camera,
        load_cameras,
    )
    from epi360.epipolar import Stability, pose_from_essential, stability, triangulate
    from epi360.estimation import (
        AbsolutePoseResult,
        Explanations,
        ImagePairResult,
        RansacOptions,
        RefinementResult,
        RelativePoseResult,
        SamePlace,
        eight_point,
        estimate_absolute_pose,
        estimate_relative_pose,
        estimate_relative_poses,
        paper_pose,
        refine_pose,
        residual_weights,
    )
    from epi360.features import (
        Features,
        Tracks,
        extract_features,
        match_features,
        read_image,
        read_mask,
        track_features,
    )
    from epi360.jobs.localization import (
        LocalizationMap,
        LocalizationOptions,
        LocalizationResult,
        load_map,
        localize_image,
    )
    from epi360.odometry import FrameResult, Odometry, OdometryOptions, Trajectory
    from epi360.poses import Pose, rotation_error_deg, translation_error_deg
    from epi360.two_view import relative_pose_of_images

# The module of each public name. Modules load on first use, so that starting the command or asking
# for a pose does not pay for what it does not need.
_HOMES = {
    "epi360.cameras": (
        "Camera", "DoubleSphere", "Equirectangular", "ExtendedUnified", "KannalaBrandt", "Pinhole",
        "UnifiedCamera", "load_camera", "load_cameras",
    ),
    "epi360.epipolar": ("Stability", "pose_from_essential", "stability", "triangulate"),
    "epi360.estimation": (
        "AbsolutePoseResult", "Explanations", "ImagePairResult", "RansacOptions",
        "RefinementResult", "RelativePoseResult", "SamePlace", "eight_point",
        "estimate_absolute_pose", "estimate_relative_pose", "estimate_relative_poses",
        "paper_pose", "refine_pose", "residual_weights",
    ),
    "epi360.features": (
        "Features", "Tracks", "extract_features", "match_features", "read_image", "read_mask",
        "track_features",
    ),
    "epi360.jobs.localization": (
        "LocalizationMap", "LocalizationOptions", "LocalizationResult", "load_map",
        "localize_image",
    ),
    "epi360.odometry": ("FrameResult", "Odometry", "OdometryOptions", "Trajectory"),
    "epi360.poses": ("Pose", "rotation_error_deg", "translation_error_deg"),
    "epi360.two_view": ("relative_pose_of_images",),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "AbsolutePoseResult", "Camera", "DoubleSphere", "Equirectangular", "Explanations",
    "ExtendedUnified", "Features", "FrameResult", "ImagePairResult", "KannalaBrandt",
    "LocalizationMap", "LocalizationOptions", "LocalizationResult", "Odometry",
    "OdometryOptions", "Pinhole", "Pose", "RansacOptions", "RefinementResult",
    "RelativePoseResult", "SamePlace", "Stability", "Tracks", "Trajectory", "UnifiedCamera",
    "eight_point", "epipolar", "estimate_absolute_pose", "estimate_relative_pose",
    "estimate_relative_poses", "extract_features", "load_camera", "load_cameras", "load_map",
    "localize_image", "match_features", "paper_pose", "pose_from_essential", "read_image",
    "read_mask", "refine_pose", "relative_pose_of_images", "residual_weights",
    "rotation_error_deg", "stability", "track_features", "translation_error_deg", "triangulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "epipolar":
        return import_module("epi360.epipolar")
    if name == "__version__":
        return import_module("epi360.extras").package_version()
    if name in _HOME_OF:
        return getattr(import_module(_HOME_OF[name]), name)
    raise AttributeError(f"module 'epi360' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
