# SPDX-License-Identifier: BSD-3-Clause
"""The cameras and points of a map for the 3D view of a page."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from epi360.interop import Reconstruction
from epi360.poses import Pose
from epi360.report.html_page import packed

_MAX_POINTS = 50_000  # more only cover each other, and cost 32 bytes each
_MAX_NAMES = 12  # of cameras: more hide each other
_NEAR = 95.0  # percentile of the distances of points that the first look takes in


def model_scene(model: Reconstruction) -> dict[str, Any]:
    """Return what `showScene` of the scripts draws; the model has at least one image."""
    poses = [image.cam_from_world for image in model.images]
    return cloud_scene([image.name for image in model.images], poses, model.points, model.colors)


def cloud_scene(
    names: Sequence[str],
    cam_from_world: Sequence[Pose],
    points: NDArray[np.float64],
    colors: NDArray[np.uint8],
) -> dict[str, Any]:
    """Return the scene of at least one camera, and points with their RGB."""
    step = max(1, -(-len(points) // _MAX_POINTS))
    points = points[::step]
    centers = np.array([-pose.rotation.T @ pose.translation for pose in cam_from_world])
    middle = np.median(centers, axis=0)
    spread = np.linalg.norm(np.concatenate([centers, points]) - middle, axis=1)
    reach = float(np.percentile(spread, _NEAR)) or 1.0
    named = len(names) <= _MAX_NAMES
    cameras = [
        {
            "name": name if named else "",
            "centre": center.tolist(),
            "rotation": pose.rotation.ravel().tolist(),
        }
        for name, pose, center in zip(names, cam_from_world, centers, strict=True)
    ]
    return {
        "points": packed(points),
        "colours": packed(colors[::step] / 255.0),
        "cameras": cameras,
        "middle": middle.tolist(),
        "reach": reach,
        "mark": 0.05 * reach,
    }
