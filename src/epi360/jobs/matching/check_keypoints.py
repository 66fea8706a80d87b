# SPDX-License-Identifier: BSD-3-Clause
"""Key points that somebody else has found: whether they are pixels of the images."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.interop.match_graph import MatchGraph

Array = NDArray[np.float64]

_MARGIN_PX = 1.0  # beyond the border, where a corner that is half outside may be found
_MOST_OUTSIDE = 0.1  # of the key points of an image
FEWEST_KEYPOINTS = 50  # key points of an image that tell something
_UPPER_LEFT = 0.55  # of the width and of the height


def check_keypoints(graph: MatchGraph, names: Iterable[str]) -> None:
    """Raise where the key points of images were not found in pictures of their cameras' sizes.

    Raises
    ------
    ValueError
        If a tenth of the key points of an image lie outside it, or those of all images lie in their
        upper left quarters.
    """
    views = []
    for name in names:
        image = graph.images[name]
        assert image.camera is not None  # its pairs could not be verified
        views.append((name, graph.cameras[image.camera], image.keypoints))
        check_inside(image.keypoints, views[-1][1], name)
    check_filled(views)


def check_filled(views: Iterable[tuple[str, Camera, Array]]) -> None:
    """Raise ``ValueError`` if the key points of all images lie in their upper left quarters.

    ``views`` has the name, the camera and the key points (N, 2) of each image; two or more must
    have enough key points to tell.
    """
    seen = [view for view in views if len(view[2]) >= FEWEST_KEYPOINTS]
    if len(seen) < 2:
        return
    if all((keypoints < _UPPER_LEFT * _size(camera)).all() for _, camera, keypoints in seen):
        name, camera, _ = seen[0]
        raise ValueError(
            f"all key points of {len(seen)} images lie in their upper left quarters, as those of "
            f"{name}, {camera.width}x{camera.height} pixels; were they found in smaller pictures?"
        )


def check_inside(keypoints: Array, camera: Camera, name: str) -> None:
    """Raise ``ValueError`` if a tenth of the key points (N, 2) of an image lie outside it.

    Missing ones, NaN, lie nowhere.
    """
    too_far = (keypoints < -_MARGIN_PX) | (keypoints > _size(camera) + _MARGIN_PX)
    outside = int(too_far.any(axis=1).sum())
    if outside > _MOST_OUTSIDE * len(keypoints):
        raise ValueError(
            f"{outside} of {len(keypoints)} key points of {name} lie outside its "
            f"{camera.width}x{camera.height} pixels; were they found in a larger picture?"
        )


def _size(camera: Camera) -> Array:
    return np.array([camera.width, camera.height], dtype=np.float64)
