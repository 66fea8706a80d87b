# SPDX-License-Identifier: BSD-3-Clause
"""What the core computes for `shared_surfaces`, in plain NumPy: slow, and made to be read.

A patch around a direction d of the first panorama has 9 x 9 samples 0.35 degrees apart, along the
epipolar curve and across. At a depth z and on a plane through z d, each sample is a point; seen
from the second camera it has another direction, and the values there are compared by their
correlation, weighted towards the middle. Shifts of up to two samples along and one across are
tried, and the depth follows the shift.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360.features.shared_surfaces import (
    LEAST_CONTRAST,
    NUM_CELLS,
    NUM_NEIGHBOURS,
    Floats,
    Indices,
    SharedSurfaces,
    cells_that_count,
    grid,
)
from epi360.features.warped_patches import Panorama, _looked_up
from epi360.poses import Pose

Array = NDArray[np.float64]

_HALF, _ALONG, _ACROSS = 4, 2, 1
_STEP = np.tan(np.radians(0.35))
_FOUND, _LIKE_ENOUGH, _BETTER_BY = 0.7, 0.9, 0.02
_FLATTEST, _FLATTEST_PLANE = 0.15, 0.1
_ONE_SURFACE, _FEWEST_OF_PLANE = 0.25, 4
_MOST_TRIES, _MOST_TRIES_FOUND = 24, 6


def _steps(half_x: int, half_y: int) -> Array:
    """Offsets (K, 2) of samples along and across, row by row."""
    y, x = np.mgrid[-half_y : half_y + 1, -half_x : half_x + 1]
    steps: Array = _STEP * np.stack([x.ravel(), y.ravel()], axis=1)
    return steps


_PATCH, _WINDOW = _steps(_HALF, _HALF), _steps(_HALF + _ALONG, _HALF + _ACROSS)
_NEAR = np.exp(-np.square(_PATCH / _STEP / _HALF).sum(axis=1) / (2 * 0.7**2))
_WEIGHTS = _NEAR / _NEAR.sum()


@dataclass(frozen=True, eq=False)
class _Patch:
    axes: Array  # direction, along, across
    values: Array  # less their mean, over their deviation
    contrast: float


@dataclass(frozen=True, eq=False)
class _Surface:
    likeness: float
    depth: float
    normal: Array


def _level(pixels_apart: float) -> int:
    return int(np.clip(np.floor(np.log2(pixels_apart) + 0.5), -1, 2)) + 1


def _patch_at(first: Panorama, pose: Pose, direction: Array) -> _Patch:
    center = pose.inverse().translation
    along = center - direction @ center * direction
    along /= np.linalg.norm(along)
    axes = np.stack([direction, along, np.cross(direction, along)])
    values = _looked_up(first.levels[_level(1.0)], (axes[0] + _PATCH @ axes[1:])[None])[0]
    centred = values - _WEIGHTS @ values
    contrast = float(np.sqrt(_WEIGHTS @ centred**2))
    return _Patch(axes, centred / max(contrast, 1e-3), contrast)


def _look_for(second: Panorama, pose: Pose, patch: _Patch, depth: float, normal: Array) -> _Surface:
    """Correlation at the best shift, and the depth that this shift says."""
    plane = normal if abs(normal @ patch.axes[0]) >= _FLATTEST else patch.axes[0]
    slopes = patch.axes[1:] @ plane / (patch.axes[0] @ plane)

    def seen(offsets: Array) -> Array:
        slope = 1 + offsets @ slopes
        stretch = np.where(slope > 1 / 3, 1 / np.where(slope > 1 / 3, slope, 1.0), 3.0)
        points = (
            depth * np.clip(stretch, 0.3, 3.0)[:, None] * (patch.axes[0] + offsets @ patch.axes[1:])
        )
        moved: Array = points @ pose.rotation.T + pose.translation
        return moved

    rays = seen(_WINDOW)
    middle = float(np.linalg.norm(seen(np.zeros((1, 2)))[0]))
    window = _looked_up(second.levels[_level(depth / middle)], rays[None])[0]
    window = window.reshape(2 * (_HALF + _ACROSS) + 1, -1).astype(np.float64)
    best, shift = -2.0, 0
    for across in range(2 * _ACROSS + 1):
        for along in range(2 * _ALONG + 1):
            part = window[across : across + 2 * _HALF + 1, along : along + 2 * _HALF + 1].ravel()
            variance = _WEIGHTS @ part**2 - (_WEIGHTS @ part) ** 2
            likeness = (_WEIGHTS * patch.values) @ part / np.sqrt(max(variance, 1.0))
            if likeness > best:
                best, shift = float(likeness), along - _ALONG
    ray = seen(np.array([[shift * _STEP, 0.0]]))[0]
    return _Surface(best, _depth_on(ray, pose, patch.axes[0], depth, shift), normal)


def _depth_on(ray: Array, pose: Pose, direction: Array, depth: float, shift: int) -> float:
    """Depth along a direction that lies nearest to a ray of the second camera."""
    ray = ray / np.linalg.norm(ray)
    here = np.cross(ray, pose.rotation @ direction)
    if shift == 0 or here @ here < 1e-4:
        return depth
    found = -float(here @ np.cross(ray, pose.translation)) / float(here @ here)
    return found if 0.02 < found < 1000.0 else depth


def likeness_of_reference(
    first: Panorama,
    second: Panorama,
    second_from_first: Pose,
    cells: Indices,
    depths: Array,
    normals: Array,
) -> Floats:
    """`likeness_of`, cell by cell."""
    found = []
    for cell, depth, normal in zip(cells, depths, normals, strict=True):
        direction = grid().directions[cell].astype(np.float64)
        patch = _patch_at(first, second_from_first, direction)
        best = _look_for(second, second_from_first, patch, depth, normal).likeness
        if best < _LIKE_ENOUGH:
            facing = _look_for(second, second_from_first, patch, depth, direction).likeness
            best = max(best, facing)
        found.append(best)
    return np.array(found, np.float32)


def grow_surfaces_reference(
    first: Panorama, second: Panorama, second_from_first: Pose, points: Array, *, most_cells: int
) -> SharedSurfaces:
    """`grow_surfaces` until so many cells are found; what is expected is not computed."""
    growth = _Growth(first, second, second_from_first)
    growth.start(points)
    growth.grow(most_cells)
    nothing = np.zeros(NUM_CELLS, np.float32)
    return SharedSurfaces(
        nothing,
        growth.depths.astype(np.float32),
        growth.likeness.astype(np.float32),
        growth.normals.astype(np.float32),
        nothing,
        nothing - 1,
        cells_that_count(first),
    )


class _Growth:
    def __init__(self, first: Panorama, second: Panorama, pose: Pose) -> None:
        self.first, self.second, self.pose = first, second, pose
        self.directions = grid().directions.astype(np.float64)
        self.depths, self.likeness = np.zeros(NUM_CELLS), np.full(NUM_CELLS, -1.0)
        self.normals = np.zeros((NUM_CELLS, 3))
        self.tries = np.zeros(NUM_CELLS, int)
        self.queue: list[tuple[float, int]] = []  # the likest first

    def start(self, points: Array) -> None:
        """Keep the seeds that look alike on a plane that faces either camera, or on the floor."""
        center = self.pose.inverse().translation
        distances = np.linalg.norm(points, axis=1)
        cells = grid().nearest(points / distances[:, None], 1).ravel()
        for k in np.argsort(cells, kind="stable"):
            direction = self.directions[cells[k]]
            back = distances[k] * direction - center
            between = direction + back / np.linalg.norm(back)
            normals = direction, between / np.linalg.norm(between), np.array([0.0, 1.0, 0.0])
            self._try(int(cells[k]), [(float(distances[k]), normal) for normal in normals], 0.0)

    def grow(self, most_cells: int) -> None:
        """Let the likest cell say where its neighbours must be, until none is left."""
        while self.queue and np.count_nonzero(self.depths) < most_cells:
            negative, cell = heapq.heappop(self.queue)
            if -negative < self.likeness[cell]:
                continue
            normal, point = self._plane(cell), self.depths[cell] * self.directions[cell]
            for j in grid().neighbours[cell]:
                if self._wants_a_try(j, -negative):
                    facing = normal @ self.directions[j]
                    depth = normal @ point / facing if facing != 0 else -1.0
                    planes = [(self.depths[cell], self.directions[j])]
                    if 0.5 < depth / self.depths[cell] < 2.0:
                        planes.insert(0, (depth, normal))
                    self._try(int(j), planes, _BETTER_BY)

    def _wants_a_try(self, cell: int, likeness: float) -> bool:
        has = self.likeness[cell]
        most = _MOST_TRIES_FOUND if has > 0 else _MOST_TRIES
        return bool(has < min(_LIKE_ENOUGH, likeness) and self.tries[cell] <= most)

    def _plane(self, cell: int) -> Array:
        """Normal of the plane through a cell and those of its neighbours at about its depth."""
        near = grid().neighbours[cell][:NUM_NEIGHBOURS]
        found = near[self.depths[near] > 0]
        gaps = np.abs(np.log(self.depths[found] / self.depths[cell]))
        rows = [cell, *found[gaps < _ONE_SURFACE]]
        normal: Array = self.normals[cell]
        if len(rows) < _FEWEST_OF_PLANE:
            return normal
        points = self.depths[rows, None] * self.directions[rows]
        fitted: Array = np.linalg.svd(points - points.mean(axis=0))[2][2]
        return normal if abs(fitted @ self.directions[cell]) < _FLATTEST_PLANE else fitted

    def _try(self, cell: int, planes: list[tuple[float, Array]], better_by: float) -> None:
        patch = _patch_at(self.first, self.pose, self.directions[cell])
        if patch.contrast < LEAST_CONTRAST:
            return
        best = _Surface(-2.0, 0.0, np.zeros(3))
        for depth, normal in planes:
            if better_by and best.likeness >= _LIKE_ENOUGH:
                break
            surface = _look_for(self.second, self.pose, patch, depth, normal)
            best = max(best, surface, key=lambda each: each.likeness)
        self.tries[cell] += 1
        if best.likeness > max(_FOUND, self.likeness[cell] + better_by):
            self.depths[cell], self.likeness[cell] = best.depth, best.likeness
            self.normals[cell] = best.normal
            heapq.heappush(self.queue, (-best.likeness, cell))
