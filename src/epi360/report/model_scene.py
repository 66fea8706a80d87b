# SPDX-License-Identifier: BSD-3-Clause
"""The cameras and points of a map for the 3D view of a page."""

from typing import Any

import numpy as np

from epi360.interop import Reconstruction
from epi360.report.html_page import packed

_MAX_POINTS = 50_000  # more only cover each other, and cost 32 bytes each
_MAX_NAMES = 12  # of cameras: more hide each other
_NEAR = 95.0  # percentile of the distances of points that the first look takes in


def model_scene(model: Reconstruction) -> dict[str, Any]:
    """Return what `showScene` of the scripts draws; the model has at least one image."""
    step = max(1, -(-len(model.points) // _MAX_POINTS))
    points = model.points[::step]
    centers = np.array(
        [-each.cam_from_world.rotation.T @ each.cam_from_world.translation for each in model.images]
    )
    middle = np.median(centers, axis=0)
    spread = np.linalg.norm(np.concatenate([centers, points]) - middle, axis=1)
    reach = float(np.percentile(spread, _NEAR)) or 1.0
    named = len(model.images) <= _MAX_NAMES
    cameras = [
        {
            "name": image.name if named else "",
            "centre": center.tolist(),
            "rotation": image.cam_from_world.rotation.ravel().tolist(),
        }
        for image, center in zip(model.images, centers, strict=True)
    ]
    return {
        "points": packed(points),
        "colours": packed(model.colors[::step] / 255.0),
        "cameras": cameras,
        "middle": middle.tolist(),
        "reach": reach,
        "mark": 0.05 * reach,
    }
