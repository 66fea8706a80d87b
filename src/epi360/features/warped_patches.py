# SPDX-License-Identifier: BSD-3-Clause
"""Whether a surface that one panorama shows looks the same in another, at the place it must have.

A patch around a point of known depth is warped into the other panorama over a plane through the
point, and correlated there within half a degree. So nothing needs to be detected a second time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.upright import is_full_panorama
from epi360.features.images import nadir_mask
from epi360.features.sphere_pictures import SpherePicture
from epi360.poses import Pose

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

WIDTH = 1024  # pixels of the panoramas that are compared; finer detail differs between cameras
_CAMERA = Equirectangular(WIDTH, WIDTH // 2)
_HALF, _RADIUS_DEG = 5, 1.5  # a patch has 11 x 11 samples
# The patch may lie elsewhere by so many samples, along the epipolar curve and across: real pairs
# have errors of half a degree, and every sample more lets other things look alike.
_ALONG, _ACROSS = 2, 1
_STEP = _RADIUS_DEG / _HALF
_PIXEL_DEG = 360.0 / WIDTH
_BLURS_PX = (0.8, 1.6, 3.2)
_FLATTEST = 0.15  # cosine between a ray and a normal; patches on flatter planes are smeared
_SIDE = 2 * _HALF + 1
_IN_MEMORY, _SHARP_IN_MEMORY = 128, 512  # panoramas, of 2 MB; without blurred ones, of 0.5 to 1 MB
# Of what is filled in, the width and how much coarser it is; the weight of the mean of all.
_FILL_PX, _COARSER, _FAR_AWAY = 16.0, 8, 1e-3

Name = TypeVar("Name", str, int)
Found = TypeVar("Found", bound="Panorama | None")


def _grid(half_x: int, half_y: int) -> Array:
    x, y = np.meshgrid(np.arange(-half_x, half_x + 1), np.arange(-half_y, half_y + 1))
    grid: Array = np.stack([x.ravel(), y.ravel()], axis=1) * np.tan(np.radians(_STEP))
    return grid


_PATCH, _WINDOW = _grid(_HALF, _HALF), _grid(_HALF + _ALONG, _HALF + _ACROSS)
_WINDOW_SHAPE = (2 * (_HALF + _ACROSS) + 1, 2 * (_HALF + _ALONG) + 1)
_NEAR = np.exp(-np.square(_PATCH / _PATCH.max()).sum(axis=1) / (2 * 0.7**2))
_WEIGHTS = (_NEAR / _NEAR.sum()).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Panorama:
    """Grey values of all directions, 1024 pixels wide: sharp, and blurred more and more.

    ``usable`` (512, 1024) says what counts; None: all. The rest is bare.
    """

    levels: NDArray[np.uint8]  # (4, 512, 1024)
    usable: NDArray[np.bool_] | None = None

    @classmethod
    def of(cls, image: NDArray[np.uint8], usable: NDArray[np.bool_] | None = None) -> Panorama:
        """Make one of an RGB picture, of which ``usable`` (512, 1024) counts."""
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        size = (WIDTH, WIDTH // 2)
        how = cv2.INTER_AREA if grey.shape[1] > WIDTH else cv2.INTER_LINEAR
        sharp = cv2.resize(grey, size, interpolation=how).astype(np.uint8)
        return cls.of_sharp(sharp if usable is None else _bare_where_masked(sharp, usable), usable)

    @classmethod
    def seen_by(
        cls,
        camera: Camera,
        image: NDArray[np.uint8],
        mask: NDArray[np.bool_] | None = None,
        mask_nadir_deg: float = 0.0,
    ) -> Panorama:
        """Make one of a camera's RGB picture; what it does not see does not count.

        Nor does what a mask of the picture's size leaves out, nor what lies so near to straight
        down as ``mask_nadir_deg``.
        """
        if not is_full_panorama(camera):
            grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
            picture = SpherePicture.of(grey, camera, mask, _CAMERA)
            usable = picture.seen & _above_nadir(mask_nadir_deg)
            return cls.of_sharp(_bare_where_masked(picture.grey, usable), usable)
        if mask is None and mask_nadir_deg == 0.0:
            return cls.of(image)
        usable = _above_nadir(mask_nadir_deg)
        if mask is not None:
            small = cv2.resize(
                mask.astype(np.uint8), (WIDTH, WIDTH // 2), interpolation=cv2.INTER_NEAREST
            )
            usable = usable & (small > 0)
        return cls.of(image, usable)

    @classmethod
    def of_sharp(
        cls, sharp: NDArray[np.uint8], usable: NDArray[np.bool_] | None = None
    ) -> Panorama:
        """Make one of its sharp grey values (512, 1024)."""
        levels = np.empty((1 + len(_BLURS_PX), *sharp.shape), np.uint8)
        levels[0] = sharp
        for level, sigma in zip(levels[1:], _BLURS_PX, strict=True):
            cv2.GaussianBlur(sharp, (0, 0), sigma, dst=level)
        return cls(levels, usable)

    def counts_at(self, directions: Array) -> NDArray[np.bool_]:
        """Whether the picture counts in directions (N, 3)."""
        if self.usable is None:
            return np.ones(len(directions), dtype=bool)
        pixels = _CAMERA.pixels_from_bearings(directions).astype(np.int64)
        column, row = np.minimum(pixels, [WIDTH - 1, WIDTH // 2 - 1]).T
        counts: NDArray[np.bool_] = self.usable[row, column]
        return counts

    def values(self, rays: Array, steps_deg: Array) -> Floats:
        """Grey values along rays (N, K, 3), of row i from the level for steps of that size."""
        levels = np.clip(np.round(np.log2(steps_deg / _PIXEL_DEG)), -1, 2).astype(int) + 1
        found = np.empty(rays.shape[:2], np.float32)
        for level in np.unique(levels):
            rows = levels == level
            found[rows] = _looked_up(self.levels[level], rays[rows])
        return found


@lru_cache(4)
def _above_nadir(mask_nadir_deg: float) -> NDArray[np.bool_]:
    """What is left of a panorama; all of a folder share it."""
    return nadir_mask(_CAMERA, mask_nadir_deg)


def _bare_where_masked(grey: NDArray[np.uint8], kept: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The picture with the mean of what is around, without an edge, where it is left out."""
    weights = kept.astype(np.float32)
    around, num_around = _blurred_much(grey * weights), _blurred_much(weights)
    mean = float(grey[kept].mean()) if kept.any() else 0.0
    filled = (around + _FAR_AWAY * mean) / (num_around + _FAR_AWAY)
    smooth = cv2.resize(filled, grey.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.where(kept, grey, np.round(smooth)).astype(np.uint8)


def _blurred_much(values: Floats) -> Floats:
    """Values at an eighth of the size, which is a tenth of the work where all detail goes."""
    height, width = values.shape
    small = cv2.resize(
        values, (width // _COARSER, height // _COARSER), interpolation=cv2.INTER_AREA
    )
    return np.asarray(cv2.GaussianBlur(small, (0, 0), _FILL_PX / _COARSER), np.float32)


def remembered(panorama_of: Callable[[Name], Found]) -> Callable[[Name], Found]:
    """The same panoramas; the last ones that were asked for stay in memory."""

    @lru_cache(_SHARP_IN_MEMORY)
    def sharp(name: Name) -> tuple[NDArray[np.uint8], NDArray[np.bool_] | None] | None:
        found = panorama_of(name)
        return None if found is None else (found.levels[0].copy(), found.usable)

    @lru_cache(_IN_MEMORY)
    def whole(name: Name) -> Panorama | None:
        found = sharp(name)
        return None if found is None else Panorama.of_sharp(*found)

    return cast("Callable[[Name], Found]", whole)


def _looked_up(grey: NDArray[np.uint8], rays: Array) -> Floats:
    x, y, z = np.moveaxis(rays, -1, 0).astype(np.float32)
    u = (np.arctan2(x, z) / np.float32(2 * np.pi) + 0.5) * WIDTH - 0.5
    v = (np.arctan2(y, np.hypot(x, z)) / np.float32(np.pi) + 0.5) * (WIDTH // 2) - 0.5
    values = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(values, np.float32)


def likeness(
    first: Panorama, second: Panorama, points: Array, second_from_first: Pose, normals: Array
) -> tuple[Floats, Floats]:
    """How alike patches around points look in both panoramas, and their contrast in the first.

    ``points`` (N, 3) are in the frame of the first camera, in units of the pose's translation.
    ``normals`` (K, N, 3) are those of the planes that are tried. Likeness (N,) is the largest
    correlation, from -1 to 1; contrast (N,) is a standard deviation of grey values.
    """
    if len(points) == 0:
        return np.empty(0, np.float32), np.empty(0, np.float32)
    distances = np.linalg.norm(points, axis=1)
    axes = _patch_axes(points / distances[:, None], second_from_first.inverse().translation)
    steps = np.full(len(points), _STEP)
    patches, contrasts = _centred(first.values(_rays(axes, _PATCH), steps))
    weighted = patches * (_WEIGHTS / np.maximum(contrasts, 1e-3)[:, None])
    rays = _rays(axes, _WINDOW)
    best = np.full(len(points), -1.0, np.float32)
    for normal in normals:
        seen = _on_plane(rays, axes[:, 0], normal) * distances[:, None, None]
        seen = seen @ second_from_first.rotation.T + second_from_first.translation
        ranges = np.linalg.norm(seen[:, len(_WINDOW) // 2], axis=1)
        windows = second.values(seen, _STEP * distances / np.maximum(ranges, 1e-9))
        best = np.maximum(best, _largest_correlation(windows, weighted))
    return best, contrasts


def _patch_axes(directions: Array, other_center: Array) -> Array:
    """Direction of each point, then towards the other camera and across, shape (N, 3, 3)."""
    along = other_center - (directions @ other_center)[:, None] * directions
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    return np.stack([directions, along, np.cross(directions, along)], axis=1)


def _rays(axes: Array, grid: Array) -> Array:
    """Rays (N, K, 3) through a grid on the plane that each direction is the normal of."""
    rays: Array = axes[:, None, 0] + grid @ axes[:, 1:]
    return rays


def _on_plane(rays: Array, directions: Array, normal: Array) -> Array:
    """Rays lengthened to the planes through the ends of the directions."""
    facing = np.abs(np.sum(normal * directions, axis=1)) > _FLATTEST
    normal = np.where(facing[:, None], normal, directions)
    along = np.sum(normal * directions, axis=1)[:, None]
    across = (rays @ normal[:, :, None])[:, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        depths = np.clip(np.nan_to_num(along / across, nan=3.0), 0.3, 3.0)
    on_plane: Array = rays * depths[:, :, None]
    return on_plane


def _centred(values: Floats) -> tuple[Floats, Floats]:
    """Values less their weighted mean, and their weighted standard deviation."""
    centred = values - (values @ _WEIGHTS)[:, None]
    return centred, np.sqrt(np.square(centred) @ _WEIGHTS)


def _largest_correlation(windows: Floats, weighted: Floats) -> Floats:
    shaped = windows.reshape(-1, *_WINDOW_SHAPE)
    cut = np.lib.stride_tricks.sliding_window_view(shaped, (_SIDE, _SIDE), axis=(1, 2))
    values = cut.reshape(len(windows), -1, _SIDE * _SIDE)
    means = values @ _WEIGHTS
    variances = np.square(values) @ _WEIGHTS - means * means
    products = np.matmul(values, weighted[:, :, None])[:, :, 0]
    correlations: Floats = products / np.sqrt(np.maximum(variances, 1e-2))
    return np.asarray(correlations.max(axis=1), np.float32)
