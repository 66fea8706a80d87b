# SPDX-License-Identifier: BSD-3-Clause
"""Key points that somebody else has found: whether they are pixels of the images."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.cameras.upright import is_full_panorama
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
        If a tenth of the key points of an image lie outside it, or those of all panoramas lie in
        their upper left quarters.
    """
    quarters = []
    for name in names:
        image = graph.images[name]
        assert image.camera is not None  # its pairs could not be verified
        camera, keypoints = graph.cameras[image.camera], image.keypoints
        check_inside(keypoints, camera, name)
        if is_full_panorama(camera) and len(keypoints) >= FEWEST_KEYPOINTS:
            quarter = _UPPER_LEFT * _size(camera)
            quarters.append((name, camera, bool((keypoints < quarter).all())))
    if len(quarters) > 1 and all(is_all for _, _, is_all in quarters):
        name, camera, _ = quarters[0]
        raise ValueError(
            f"all key points of all {len(quarters)} panoramas lie in their upper left quarters, as "
            f"those of {name}, {camera.width}x{camera.height} pixels; were they found in smaller "
            "pictures?"
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
