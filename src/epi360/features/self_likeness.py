# SPDX-License-Identifier: BSD-3-Clause
"""How much of a panorama looks like other parts of the same panorama."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.features.detection import extract_features
from epi360.features.warped_patches import Panorama

Array = NDArray[np.float64]

_MOST, _FEWEST = 1000, 50  # key points above the floor
_BELOW_HORIZON = np.sin(np.radians(10.0))  # y of what lies lower: floors repeat in any room
_APART, _BESIDE = np.cos(np.radians([8.0, 3.0]))  # cosines: other parts, and one and the same
_RATIO = 0.9  # of the distances of descriptors, to the nearest and to one that is not beside it

_keypoints: WeakKeyDictionary[Panorama, SeenKeypoints] = WeakKeyDictionary()
_shares: WeakKeyDictionary[Panorama, float] = WeakKeyDictionary()


class SeenKeypoints(NamedTuple):
    """Bearings (N, 3) and unit descriptors (N, 128) of key points, the strongest first."""

    bearings: Array
    descriptors: NDArray[np.float32]

    def some(self, rows: slice | NDArray[np.int64]) -> SeenKeypoints:
        """Some of them."""
        return SeenKeypoints(self.bearings[rows], self.descriptors[rows])


def keypoints_of(panorama: Panorama) -> SeenKeypoints:
    """Key points of a panorama, which are found once."""
    if panorama not in _keypoints:
        _keypoints[panorama] = _found(panorama)
    return _keypoints[panorama]


def share_like_itself(panorama: Panorama) -> float:
    """Share of the key points above the floor that match others in the same panorama.

    Two match that are each other's nearest more than 8 degrees away, and much nearer than any that
    is not beside these. 0 where there are too few key points to say so.
    """
    if panorama not in _shares:
        _shares[panorama] = _share(keypoints_of(panorama))
    return _shares[panorama]


def _found(panorama: Panorama) -> SeenKeypoints:
    grey, usable = panorama.levels[0], panorama.usable
    camera = Equirectangular(grey.shape[1], grey.shape[0])
    mask = None if usable is None else (255 * usable).astype(np.uint8)
    features = extract_features(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), camera, mask)
    found = SeenKeypoints(camera.bearings_from_pixels(features.keypoints), features.descriptors)
    above = found.bearings[:, 1] < _BELOW_HORIZON
    some = np.cumsum(above) <= _MOST  # with those of the floor among them
    return found.some(np.flatnonzero(some))


def _share(found: SeenKeypoints) -> float:
    above = found.some(np.flatnonzero(found.bearings[:, 1] < _BELOW_HORIZON))
    if len(above.bearings) < _FEWEST:
        return 0.0
    return float(np.mean(_has_its_like(above.bearings, above.descriptors)))


def _has_its_like(bearings: Array, descriptors: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Whether each of some key points (N,) matches another one that lies elsewhere."""
    cosines = bearings @ bearings.T
    likeness = np.where(cosines > _APART, -1.0, descriptors @ descriptors.T)
    everyone = np.arange(len(bearings))
    nearest = likeness.argmax(axis=1)
    best = likeness[everyone, nearest]
    second = np.where(cosines[nearest] > _BESIDE, -1.0, likeness).max(axis=1)
    found: NDArray[np.bool_] = (nearest[nearest] == everyone) & (
        1.0 - best < _RATIO**2 * (1.0 - second)
    )
    return found
