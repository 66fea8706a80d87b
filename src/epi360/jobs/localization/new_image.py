# SPDX-License-Identifier: BSD-3-Clause
"""A new image that is looked for in a map: its features, and where it can see something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360.cameras import Camera
from epi360.cameras.resizing import smallest_pixel_deg
from epi360.features import Features
from epi360.features.detection import usable_rows

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class NewImage:
    """Features of an image, their bearings (N, 3), a tree of these, and what a mask leaves."""

    features: Features
    camera: Camera
    bearings: Array
    tree: cKDTree
    mask: Mask | None
    nadir_deg: float  # around straight down there are no features: a mask, a tripod, a blur

    @classmethod
    def of(cls, features: Features, camera: Camera, mask: Mask | None = None) -> NewImage:
        """Features of another program may lie where a lens sees nothing: they are left out."""
        bearings = camera.bearings_from_pixels(features.keypoints)
        is_seen = np.isfinite(bearings[:, 0])
        bearings = bearings[is_seen]
        lowest = float(bearings[:, 1].max(initial=-1.0))
        nadir_deg = float(np.degrees(np.arccos(np.clip(lowest, -1.0, 1.0))))
        features = features.chosen(is_seen)
        return cls(features, camera, bearings, cKDTree(bearings), mask, nadir_deg)

    @property
    def pixel_deg(self) -> float:
        """Smallest angle that a pixel spans."""
        return smallest_pixel_deg((self.camera, self.camera))

    def shows(self, directions: Array) -> Mask:
        """Whether directions (N, 3) lie in the picture, and where it has features at all."""
        pixels = self.camera.pixels_from_bearings(directions)
        shown = np.isfinite(pixels[:, 0])
        shown[shown] = usable_rows(pixels[shown], self.camera, self.mask, self.nadir_deg)
        return shown
