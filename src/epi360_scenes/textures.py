# SPDX-License-Identifier: BSD-3-Clause
"""Textures of a scene in one buffer with their mip maps, and filtered look-up in them."""

import os
import zlib
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from epi360_scenes.painting import PAINTERS

Floats = NDArray[np.float32]
GAMMA = 2.2


@dataclass(frozen=True)
class TextureAtlas:
    """All textures of a scene with their mip maps in one buffer, in linear light."""

    names: tuple[str, ...]  # texture i is called names[i]
    texels: Floats  # (T, 3): RGB rows of all textures, level after level
    # (len(names), L): first row of each level, and its side in texels, a power of two; levels past
    # the last repeat it.
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]

    def sample(self, texture: NDArray[np.intp], uv: Floats, footprint: Floats) -> Floats:
        """RGB (N, 3) at positions (2, N) in turns, trilinear and repeating."""
        top = self.sizes.shape[1] - 1
        level = np.log2(np.maximum(footprint * self.sizes[texture, 0], 1.0))
        level = np.minimum(level, np.float32(top)).astype(np.float32)
        lower = level.astype(np.intp)
        blend = (level - lower)[:, None]
        fine = self._bilinear(texture, lower, uv)
        coarse = self._bilinear(texture, np.minimum(lower + 1, top), uv)
        rgb: Floats = fine + blend * (coarse - fine)
        return rgb

    def _bilinear(self, texture: NDArray[np.intp], level: NDArray[np.intp], uv: Floats) -> Floats:
        size, start = self.sizes[texture, level], self.starts[texture, level]
        across = uv * size - np.float32(0.5)
        floor = np.floor(across)
        weight = (across - floor).astype(np.float32)
        (column, row), mask = floor.astype(np.int64), size - 1
        row0, row1 = start + (row & mask) * size, start + ((row + 1) & mask) * size
        column0, column1 = column & mask, (column + 1) & mask
        (right, down), texels = weight[:, :, None], self.texels
        above = _mix(texels[row0 + column0], texels[row0 + column1], right)
        below = _mix(texels[row1 + column0], texels[row1 + column1], right)
        return _mix(above, below, down)


def _mix(a: Floats, b: Floats, weight: Floats) -> Floats:
    mixed: Floats = a + weight * (b - a)
    return mixed


def build_atlas(seed: int, names: Iterable[str] = PAINTERS) -> TextureAtlas:
    """Textures painted for a seed; each name has its own random numbers."""

    def painted(name: str) -> Floats:
        rng = np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode())]))
        return np.clip(PAINTERS[name](rng), 0, 1).astype(np.float32) ** np.float32(GAMMA)

    names = tuple(names)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return atlas_of_images(dict(zip(names, pool.map(painted, names), strict=True)))


def atlas_of_images(images: Mapping[str, Floats]) -> TextureAtlas:
    """Textures made of square pictures by name, with their mip maps."""
    pyramids = [_pyramid(image) for image in images.values()]
    num_levels = max((len(levels) for levels in pyramids), default=1)
    starts, sizes, start = [], [], 0
    for levels in pyramids:
        sides = [len(level) for level in levels] + [1] * (num_levels - len(levels))
        ends = start + np.cumsum(np.square(sides))
        end = ends[len(levels) - 1]
        starts.append(np.minimum([start, *ends[:-1]], end - 1))
        sizes.append(sides)
        start = int(end)
    flat = [level.reshape(-1, 3) for levels in pyramids for level in levels]
    texels = np.concatenate([np.empty((0, 3), np.float32), *flat])
    return TextureAtlas(tuple(images), texels, np.array(starts), np.array(sizes))


def _pyramid(image: Floats) -> list[Floats]:
    levels = [image]
    while len(levels[-1]) > 1:
        fine = levels[-1]
        rows = fine[::2] + fine[1::2]
        levels.append(np.float32(0.25) * (rows[:, ::2] + rows[:, 1::2]))
    return levels
