# SPDX-License-Identifier: BSD-3-Clause
"""SIFT key points of one image, with no blind spots at the seam and the poles of a panorama."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from epi360 import _core
from epi360.cameras import Camera
from epi360.features.image_cameras import find_camera
from epi360.features.images import ImageSource, read_masked_image, shrunk, usable_at
from epi360.features.views import View, search_views

Array = NDArray[np.float64]

# SIFT's default of 0.04 finds too little on wide baselines indoors; 0.02 gives twice the matches.
CONTRAST_THRESHOLD = 0.02
# With this threshold all of 17 real pairs indoors with wide baselines succeed, with the usual one
# 14. It finds half as many features again.
FAINT_CONTRAST_THRESHOLD = 0.013
SMALLEST_WIDTH = 64  # the least that max_width may be
_DUPLICATE_PX = 1.0
_LAYERS_PER_OCTAVE = 3  # SIFT's own default


@dataclass(frozen=True)
class Features:
    """Key points of one image.

    Attributes
    ----------
    keypoints : ndarray, shape (N, 2)
        Continuous pixels (u, v) of the original image.
    descriptors : ndarray, shape (N, 128), float32
        RootSIFT, unit length.
    sizes_px : ndarray, shape (N,)
        Diameter of the described region, in pixels of the original image at the horizon.
    """

    keypoints: Array
    descriptors: NDArray[np.float32]
    sizes_px: Array

    def __len__(self) -> int:
        return len(self.keypoints)

    def first(self, count: int) -> Features:
        """Return the ``count`` strongest of what `extract_features` found."""
        return self.chosen(slice(count))

    def chosen(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Features:
        """Return those of an ``index``: a mask (N,), rows or a slice."""
        return Features(self.keypoints[index], self.descriptors[index], self.sizes_px[index])


def extract_features(
    image: ImageSource,
    camera: Camera | None = None,
    mask: ImageSource | None = None,
    *,
    mask_nadir_deg: float = 0.0,
    max_width: int = 4096,
    max_features: int = 10000,
    contrast_threshold: float = CONTRAST_THRESHOLD,
) -> Features:
    """SIFT key points and RootSIFT descriptors of an image, strongest first, or none.

    Parameters
    ----------
    image : path or array
        What ``read_image`` takes.
    camera : Camera, optional
        Default: a full equirectangular panorama of the image's size, or the part of one that the
        GPano metadata of a file state.
    mask : path or array, optional
        White = use; of the image's size.
    mask_nadir_deg : float
        Ignore this angle around straight down (+y): the tripod and who holds it.
    max_width : int
        A wider image is searched at this width; key points are in pixels of the original.
    max_features : int
        The strongest are kept.
    contrast_threshold : float
        Least contrast of a key point, as SIFT measures it; lower finds more.

    Raises
    ------
    ValueError
        If image, camera and mask do not fit together, or the image is no panorama and no camera
        is given.

    Notes
    -----
    Lowe, IJCV 2004; RootSIFT: Arandjelović & Zisserman, CVPR 2012. A full panorama is searched as a
    strip around the horizon, continued across the seam, and two faces at the poles.
    """
    return find_keypoints(
        image,
        camera,
        mask,
        mask_nadir_deg=mask_nadir_deg,
        max_width=max_width,
        max_features=max_features,
        contrast_threshold=contrast_threshold,
    ).features()


@dataclass(frozen=True)
class SiftKeypoints:
    """Key points as SIFT finds them, strongest first, in pixels of the original image."""

    pixels: Array
    sizes: Array
    strengths: Array
    descriptors: NDArray[np.uint8]

    def chosen(self, index: NDArray[np.bool_] | NDArray[np.int64]) -> SiftKeypoints:
        """Return those of a mask or of indices."""
        return SiftKeypoints(
            self.pixels[index], self.sizes[index], self.strengths[index], self.descriptors[index]
        )

    def features(self) -> Features:
        """Return what is matched: unit descriptors."""
        return Features(self.pixels, root_sift(self.descriptors), self.sizes)

    def num_above(self, contrast_threshold: float) -> int:
        """Return how many of them a search at a higher threshold would find: the first so many."""
        contrasts = self.strengths.astype(np.float32) * np.float32(_LAYERS_PER_OCTAVE)
        return int(np.count_nonzero(contrasts >= np.float32(contrast_threshold)))


def root_sift(descriptors: NDArray[np.float32] | NDArray[np.uint8]) -> NDArray[np.float32]:
    """RootSIFT of SIFT's descriptors: of unit length."""
    values = np.asarray(descriptors, np.float32)
    sums = np.maximum(values.sum(axis=1, keepdims=True), 1e-9)
    return np.asarray(np.sqrt(values / sums), np.float32)


def find_keypoints(
    image: ImageSource,
    camera: Camera | None = None,
    mask: ImageSource | None = None,
    *,
    mask_nadir_deg: float,
    max_width: int,
    max_features: int,
    contrast_threshold: float,
) -> SiftKeypoints:
    """SIFT key points of an image with their strengths; the arguments of `extract_features`."""
    check_options(max_width, mask_nadir_deg)
    if max_features < 1:
        raise ValueError(f"max_features must be at least 1, got {max_features}")
    if not 0.0 < contrast_threshold < 1.0:
        raise ValueError(f"contrast_threshold must be in (0, 1), got {contrast_threshold}")
    picture, usable = read_masked_image(image, mask)
    camera = find_camera(image, picture, camera, "image")
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)
    grey, stretch = shrunk(grey, max_width)
    views = search_views(grey, camera)
    parts = [_searched(view, contrast_threshold, stretch) for view in views]
    found = _merged(parts, camera, stretch[0])
    order = np.argsort(-found.strengths, kind="stable")
    kept = order[usable_rows(found.pixels, camera, usable, mask_nadir_deg)[order]]
    return found.chosen(kept[:max_features])


def usable_rows(
    pixels: Array, camera: Camera, mask: NDArray[np.bool_] | None, mask_nadir_deg: float
) -> NDArray[np.bool_]:
    """Which pixels (N, 2) a mask leaves, less those so near straight down."""
    usable = np.ones(len(pixels), bool) if mask is None else usable_at(mask, pixels)
    if mask_nadir_deg > 0.0:
        usable &= camera.bearings_from_pixels(pixels)[:, 1] < np.cos(np.radians(mask_nadir_deg))
    return usable


def check_options(max_width: int, mask_nadir_deg: float) -> None:
    """Raise ``ValueError`` before any work if an option is out of its range."""
    if max_width < SMALLEST_WIDTH:
        raise ValueError(f"max_width must be at least {SMALLEST_WIDTH} pixels, got {max_width}")
    if not 0.0 <= mask_nadir_deg < 180.0:
        raise ValueError(f"mask_nadir_deg must be in [0, 180), got {mask_nadir_deg}")


_NOTHING = SiftKeypoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), np.uint8))


def _searched(view: View, contrast_threshold: float, stretch: Array) -> SiftKeypoints:
    rows, descriptors = _core.find_sift(view.picture, view.reported(), contrast_threshold)
    # The core puts pixel centres at integers.
    moved, own, relative = view.to_image(rows[:, :2] + 0.5)
    sizes = rows[:, 2] * relative * stretch[0]
    return SiftKeypoints(moved * stretch, sizes, rows[:, 3], descriptors).chosen(own)


def _merged(parts: list[SiftKeypoints], camera: Camera, pixel: float) -> SiftKeypoints:
    """All views' key points, without twins, which would be each other's runner-up."""
    if not parts:
        return _NOTHING
    merged = parts[0]
    for part in parts[1:]:
        fresh = ~_repeated(part, merged, camera, pixel)
        part = part.chosen(fresh)
        merged = SiftKeypoints(
            np.concatenate([merged.pixels, part.pixels]),
            np.concatenate([merged.sizes, part.sizes]),
            np.concatenate([merged.strengths, part.strengths]),
            np.concatenate([merged.descriptors, part.descriptors]),
        )
    return merged


def _repeated(
    part: SiftKeypoints, others: SiftKeypoints, camera: Camera, pixel: float
) -> NDArray[np.bool_]:
    """Which key points lie within a pixel of another view's of similar size."""
    chord = _DUPLICATE_PX * pixel * 2.0 * np.pi / camera.width
    tree = cKDTree(camera.bearings_from_pixels(others.pixels))
    near = tree.query_ball_point(camera.bearings_from_pixels(part.pixels), chord)
    rows = np.repeat(np.arange(len(near)), [len(each) for each in near])
    twins = np.array([row for each in near for row in each], dtype=np.intp)
    ratio = part.sizes[rows] / others.sizes[twins]
    repeated = np.zeros(len(part.pixels), dtype=bool)
    repeated[rows[(ratio > 1 / 1.5) & (ratio < 1.5)]] = True
    return repeated
