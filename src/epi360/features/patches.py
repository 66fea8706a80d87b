# SPDX-License-Identifier: BSD-3-Clause
"""Patches around points as first seen, found again many frames later with sub-pixel accuracy.

Points in a picture are in OpenCV's coordinates: pixel centres lie at integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

_HALF = 5
_AXIS = np.arange(-_HALF, _HALF + 1, dtype=np.float32)
_GRID = np.stack(np.meshgrid(_AXIS, _AXIS), axis=-1).reshape(-1, 2)
_SIDE = 2 * _HALF + 1
_WEIGHTS = np.exp(-np.square(_GRID).sum(axis=1) / (2 * (0.8 * _HALF) ** 2)).astype(np.float32)
_WEIGHTS /= _WEIGHTS.sum()
# Variance of grey values (4 squared) over that of the shape's change between two looks (0.2
# squared), found by trial: less lets weak patches slide, more makes them follow a zoom too late.
_STIFFNESS = np.float32(450.0)
_ITERATIONS = 6
_LARGEST_CHANGE = 0.6  # of the shape; the patch is then taken again at the new size


@dataclass(frozen=True)
class Patches:
    """What points looked like when their patches were taken.

    Attributes
    ----------
    values : ndarray, shape (N, 121), float32
        Grey values on a grid of pixels.
    shapes : ndarray, shape (N, 2, 2), float32
        What has become of the grid since then.
    views : ndarray, shape (N,)
        View in which each patch was taken.
    """

    values: Floats
    shapes: Floats
    views: NDArray[np.intp]

    def __getitem__(self, index: NDArray[np.generic]) -> Patches:
        return Patches(self.values[index], self.shapes[index], self.views[index])

    def __setitem__(self, index: NDArray[np.generic], others: Patches) -> None:
        self.values[index] = others.values
        self.shapes[index] = others.shapes
        self.views[index] = others.views

    def joined(self, others: Patches) -> Patches:
        """These patches and then others."""
        return Patches(
            np.concatenate([self.values, others.values]),
            np.concatenate([self.shapes, others.shapes]),
            np.concatenate([self.views, others.views]),
        )


def no_patches(count: int) -> Patches:
    """Room for so many patches, taken in no view."""
    return Patches(
        np.zeros((count, _SIDE**2), np.float32),
        np.tile(np.eye(2, dtype=np.float32), (count, 1, 1)),
        np.full(count, -1, dtype=np.intp),
    )


def take_patches(picture: Floats, points: Floats, view: int) -> Patches:
    """Patches around points (N, 2) of a picture."""
    shapes = np.tile(np.eye(2, dtype=np.float32), (len(points), 1, 1))
    views = np.full(len(points), view, dtype=np.intp)
    return Patches(_sampled(picture, points, shapes), shapes, views)


def align_patches(
    picture: Floats, patches: Patches, points: Floats
) -> tuple[Floats, Floats, Floats]:
    """Places (N, 2) of patches in a picture, their shapes there, and how unlike they look.

    The places start at points. Unlikeness is the residual's deviation divided by the patch's, after
    a change of brightness and contrast; infinite where the shape changed too much.
    """
    gradients = _gradients(patches.values)
    weighted = gradients * _WEIGHTS
    normal = np.matmul(weighted, gradients.transpose(0, 2, 1))
    shape_rows = np.arange(4)
    normal[:, shape_rows, shape_rows] += _STIFFNESS
    all_rows = np.arange(8)
    normal[:, all_rows, all_rows] += 1e-3 + 1e-5 * normal[:, all_rows, all_rows]
    inverse = np.linalg.inv(normal)
    before, shapes, places = patches.shapes, patches.shapes, points
    for _ in range(_ITERATIONS):
        residuals = _sampled(picture, places, shapes) - patches.values
        slope = np.matmul(weighted, residuals[..., None])[..., 0]
        slope[:, :4] += _STIFFNESS * (shapes - before).reshape(-1, 4)
        step = np.matmul(inverse, slope[..., None])[..., 0]
        shapes = shapes @ np.linalg.inv(np.eye(2, dtype=np.float32) + step[:, :4].reshape(-1, 2, 2))
        places = places - np.matmul(shapes, step[:, 4:6, None])[..., 0]
    unlike = _deviation(residuals - step[:, 6:7] * patches.values)
    unlike /= np.maximum(_deviation(patches.values), 1e-3)
    unlike[np.abs(shapes - np.eye(2)).max(axis=(1, 2)) > _LARGEST_CHANGE] = np.inf
    unlike[~np.isfinite(places).all(axis=1)] = np.inf
    return places, shapes, unlike


def _sampled(picture: Floats, points: Floats, shapes: Floats) -> Floats:
    if len(points) == 0:
        return np.empty((0, len(_GRID)), dtype=np.float32)
    places = np.matmul(_GRID, shapes.transpose(0, 2, 1)) + points[:, None]
    u, v = np.ascontiguousarray(places.transpose(2, 0, 1))
    values = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, dtype=np.float32)


def _gradients(values: Floats) -> Floats:
    """Derivatives (N, 8, 121) by shape, place, contrast and brightness."""
    square = values.reshape(-1, _SIDE, _SIDE)
    along_v, along_u = (g.reshape(values.shape) for g in np.gradient(square, axis=(1, 2)))
    x, y = _GRID.T
    rows = [along_u * x, along_u * y, along_v * x, along_v * y, along_u, along_v, values]
    return np.stack([*rows, np.ones_like(values)], axis=1)


def _deviation(values: Floats) -> Floats:
    """Weighted standard deviation (N,) of each row."""
    centred = values - (values @ _WEIGHTS)[:, None]
    return np.asarray(np.sqrt(np.square(centred) @ _WEIGHTS), dtype=np.float32)
