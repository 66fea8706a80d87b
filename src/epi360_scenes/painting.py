# SPDX-License-Identifier: BSD-3-Clause
"""Procedural pictures of surfaces: wood, bricks, books, paintings, painted from a generator.

Each painter returns a square RGB picture (S, S, 3) for the display, S a power of two, that repeats
without a seam where its surface does. Values may leave [0, 1] a little.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Generator = np.random.Generator
Color = tuple[float, float, float]


def _clouds(rng: Generator, size: int, fall: float = 1.6, stretch: float = 1.0) -> Floats:
    """Seamless noise (size, size) of zero mean and unit deviation: power falls as 1/f^(2 fall)."""
    v = np.fft.fftfreq(size)[:, None].astype(np.float32) * size
    u = np.fft.rfftfreq(size)[None, :].astype(np.float32) * size * stretch
    gain = (u * u + v * v + np.float32(1e-9)) ** np.float32(-fall / 2)
    gain[0, 0] = 0.0
    waves = rng.standard_normal((2, *gain.shape), dtype=np.float32)
    noise = np.fft.irfft2(gain * (waves[0] + np.complex64(1j) * waves[1]), s=(size, size))
    normalized: Floats = (noise / noise.std()).astype(np.float32)
    return normalized


def _flat(size: int, color: Color | NDArray[np.float64]) -> Floats:
    return np.tile(np.asarray(color, np.float32), (size, size, 1))


def _shaded(image: Floats, field: Floats, gain: float = 1.0) -> Floats:
    """Picture (S, S, 3) made lighter and darker by a field (S, S) around zero."""
    shaded: Floats = image * (1 + np.float32(gain) * field.astype(np.float32)[:, :, None])
    return shaded


def _ramp(field: Floats, colors: NDArray[np.float64] | list[Color]) -> Floats:
    """Colours along a ramp by the rank of a field's value, all colours equally frequent."""
    levels = np.quantile(field, np.linspace(0, 1, len(colors)))
    channels = [np.interp(field, levels, channel) for channel in np.asarray(colors).T]
    return np.stack(channels, axis=2).astype(np.float32)


def _patches(field: Floats, colors: NDArray[np.float64] | list[Color]) -> Floats:
    """Hard-edged colours by the rank of a field's value."""
    edges = np.quantile(field, np.linspace(0, 1, len(colors) + 1)[1:-1])
    return np.asarray(colors, np.float32)[np.searchsorted(edges, field)]


def _grid(size: int) -> tuple[Floats, Floats]:
    """Column and row of texel centres in turns."""
    ticks = (np.arange(size, dtype=np.float32) + 0.5) / size
    return np.broadcast_to(ticks, (size, size)), np.broadcast_to(ticks[:, None], (size, size))


def _lively(rng: Generator, num: int) -> NDArray[np.float64]:
    """Random pleasant colours, each a warm or cool base at a random lightness."""
    bases = np.array(
        [
            (0.76, 0.29, 0.20), (0.90, 0.62, 0.20), (0.18, 0.42, 0.47), (0.20, 0.27, 0.42),
            (0.86, 0.79, 0.64), (0.42, 0.55, 0.35), (0.62, 0.24, 0.30), (0.30, 0.52, 0.66),
            (0.93, 0.88, 0.80), (0.24, 0.22, 0.24), (0.83, 0.50, 0.36), (0.55, 0.47, 0.60),
        ]
    )  # fmt: skip
    return bases[rng.integers(len(bases), size=num)] * rng.uniform(0.75, 1.1, (num, 1))


def _strokes(rng: Generator, image: Floats, box: tuple[int, int, int, int], ink: float) -> None:
    """Lines of letter-like marks inside rows and columns (top, bottom, left, right)."""
    top, bottom, left, right = box
    height = max(4, (bottom - top) // 8)
    for row in range(top, bottom - height, 2 * height):
        column = left
        end = right - rng.integers(0, max(1, (right - left) // 3))
        while column < end:
            width = int(rng.integers(2, height + 2))
            a, b = sorted(rng.integers(0, height + 1, 2))
            image[row : row + height, column : column + max(1, width // 3)] = ink
            image[row + a : row + b + 1, column : column + width] = ink
            column += width + int(rng.integers(1, height))


def _planks(rng: Generator) -> Floats:
    """Floor boards along u: eight rows with random joints, tone and grain."""
    size, rows = 512, 8
    image = np.empty((size, size, 3), np.float32)
    grain = _clouds(rng, size, 1.1, 12.0) + 0.5 * _clouds(rng, size, 0.6, 40.0)
    step = size // rows
    for row in range(rows):
        band = slice(row * step, (row + 1) * step)
        joints = np.sort(rng.integers(0, size, 2))
        board = np.searchsorted(joints, np.arange(size)) % 2
        tone = rng.uniform(0.78, 1.08, 2)[board]
        warm = rng.uniform(0.94, 1.06, 2)[board]
        shifted = np.roll(grain[band], int(rng.integers(size)), axis=1)
        light = tone * (1.0 + 0.075 * shifted)
        image[band] = np.stack([0.67 * light, 0.50 * light * warm, 0.345 * light * warm], axis=2)
        image[band.start : band.start + 2] *= 0.55
        for joint in joints:
            image[band, joint : joint + 2] *= 0.5
    return image


def _wood(rng: Generator, color: Color) -> Floats:
    """Furniture wood with its grain along u."""
    size = 256
    rings = np.sin(9.0 * _clouds(rng, size, 2.0, 7.0))
    grain = 0.05 * rings + 0.07 * _clouds(rng, size, 0.8, 25.0)
    return _shaded(_flat(size, color), grain)


def _plaster(rng: Generator, color: Color, contrast: float) -> Floats:
    """Painted wall of low contrast: soft clouds and a fine roller texture."""
    size = 256
    field = _clouds(rng, size, 1.5) + 0.7 * _clouds(rng, size, 0.5)
    return _shaded(_flat(size, color), field, contrast)


def _bricks(rng: Generator) -> Floats:
    """Lay a running bond, sixteen courses; every brick has its own colour."""
    size, courses, columns = 512, 16, 4
    u, v = _grid(size)
    course = (v * courses).astype(np.intp)
    along = (u * columns + 0.5 * (course % 2)) % columns
    colors = rng.uniform(0.80, 1.12, (courses, columns, 1)) * np.array((0.70, 0.44, 0.35))
    colors += rng.uniform(-0.05, 0.06, (courses, columns, 3))
    image = colors[course, along.astype(np.intp)].astype(np.float32)
    image = _shaded(image, _clouds(rng, size, 0.9), 0.09)
    wobble = 0.012 * _clouds(rng, size, 1.2)
    mortar = (along % 1.0 + wobble < 0.05) | ((v * courses) % 1.0 + 2 * wobble < 0.13)
    image[mortar] = _shaded(_flat(size, (0.74, 0.70, 0.64)), _clouds(rng, size, 0.2), 0.05)[mortar]
    return image


def _rug(rng: Generator) -> Floats:
    """Four-fold symmetric carpet with borders."""
    size = 512
    half = _clouds(rng, size, 1.35)[: size // 2, : size // 2]
    half = np.concatenate([half, half[:, ::-1]], axis=1)
    colors = [(0.50, 0.13, 0.14), (0.16, 0.20, 0.33), (0.80, 0.68, 0.50), (0.62, 0.24, 0.18),
              (0.28, 0.36, 0.40), (0.86, 0.78, 0.64)]  # fmt: skip
    image = _patches(np.concatenate([half, half[::-1]]), colors)
    u, v = _grid(size)
    border = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    for depth, color in ((0.135, 1), (0.12, 2), (0.11, None), (0.035, 2), (0.022, 0)):
        ring = border < depth
        if color is None:
            motif = np.sin(2 * np.pi * 14 * u) * np.sin(2 * np.pi * 14 * v)
            image[ring] = np.where(motif[ring, None] > 0, colors[3], colors[1])
        else:
            image[ring] = colors[color]
    return _shaded(image, _clouds(rng, size, 0.4), 0.10)


def _fabric(rng: Generator, color: Color) -> Floats:
    """Melange weave."""
    size = 256
    u, v = _grid(size)
    weave = np.sin(2 * np.pi * 64 * u) * np.sin(2 * np.pi * 64 * v)
    field = 0.05 * weave + 0.08 * _clouds(rng, size, 0.35) + 0.035 * _clouds(rng, size, 1.4)
    return _shaded(_flat(size, color), field)


def _cushion(rng: Generator) -> Floats:
    """Print a fabric."""
    image = _patches(_clouds(rng, 256, 1.7), _lively(rng, 6))
    return _shaded(image, _clouds(rng, 256, 0.4), 0.07)


def _leaves(rng: Generator) -> Floats:
    """Foliage: patches of light and dark green."""
    greens = [(0.08, 0.17, 0.07), (0.20, 0.36, 0.14), (0.13, 0.27, 0.11), (0.38, 0.53, 0.22)]
    return _shaded(_patches(_clouds(rng, 256, 1.1), greens), _clouds(rng, 256, 0.5), 0.1)


def _curtain(rng: Generator) -> Floats:
    """Vertical folds with a woven motif."""
    u, _ = _grid(256)
    turns = 2 * np.pi * u
    folds = np.sin(7 * turns + 0.8 * np.sin(3 * turns)) + 0.4 * np.sin(17 * turns)
    field = 0.13 * folds + 0.03 * _clouds(rng, 256, 0.5)
    return _shaded(_flat(256, (0.55, 0.59, 0.55)), field)


def _books(rng: Generator) -> Floats:
    """Paint a row of book spines, titles and all."""
    size, column = 256, 0
    image = _flat(size, (0.08, 0.06, 0.05))
    while column < size:
        width = int(rng.integers(10, 26))
        top = int(rng.integers(4, 70))
        color = _lively(rng, 1)[0]
        spine = image[top:, column : column + width - 1]
        shape = np.cos(np.linspace(-1.2, 1.2, spine.shape[1]))[None, :, None]
        spine[:] = color * (0.6 + 0.4 * shape)
        for _ in range(int(rng.integers(1, 4))):
            at, thick = int(rng.integers(top + 8, size - 20)), int(rng.integers(2, 14))
            spine[at - top : at - top + thick] = _lively(rng, 1)[0]
        title = int(rng.integers(top + 10, size - 60))
        for mark in range(title, title + 46, 4):
            image[mark : mark + int(rng.integers(1, 4)), column + 3 : column + width - 4] = 0.9
        column += width
    return image


def _landscape(rng: Generator) -> Floats:
    """Ridges under an evening sky."""
    size = 256
    u, v = _grid(size)
    image = _ramp(v + 0.05 * _clouds(rng, size, 1.8), [(0.28, 0.45, 0.62), (0.94, 0.78, 0.55)])
    sun = np.hypot(u - rng.uniform(0.25, 0.75), v - 0.36) < 0.07
    image[sun] = (1.0, 0.93, 0.70)
    for depth, far in enumerate(np.linspace(1.0, 0.0, 5)):
        ridge = 0.42 + 0.12 * depth + 0.05 * _clouds(rng, size, 1.5)[0] * (1 + depth / 2)
        hill = v > ridge[None, :]
        near = np.array((0.13, 0.23, 0.17)) + 0.06 * rng.standard_normal(3)
        color = far * np.array((0.62, 0.62, 0.66)) + (1 - far) * near
        shade = _clouds(rng, size, 1.0)
        image[hill] = _shaded(_flat(size, color), shade, 0.2 * (1 - far))[hill]
    return image


def _abstract(rng: Generator) -> Floats:
    """Painted fields of colour."""
    image = _patches(_clouds(rng, 256, 1.9), _lively(rng, 7))
    return _shaded(image, _clouds(rng, 256, 0.9), 0.06)


def _circles(rng: Generator) -> Floats:
    """Overlapping discs and rings."""
    image = _flat(256, (0.93, 0.90, 0.83))
    u, v = _grid(256)
    for color in _lively(rng, 34):
        radius = rng.uniform(0.03, 0.16)
        distance = np.hypot(u - rng.uniform(), v - rng.uniform())
        image[(distance < radius) & (distance > rng.choice([0.0, 0.6]) * radius)] = color
    return image


def _blocks(rng: Generator) -> Floats:
    """Rectangles divided by black lines."""
    image = _flat(256, (0.92, 0.90, 0.85))
    colors = np.array(
        [(0.75, 0.16, 0.13), (0.15, 0.25, 0.52), (0.93, 0.76, 0.22), (0.92, 0.90, 0.85)]
    )
    cuts = [np.sort(np.concatenate([[0, 256], rng.integers(12, 244, 7)])) for _ in range(2)]
    for top, bottom in pairwise(cuts[0].tolist()):
        for left, right in pairwise(cuts[1].tolist()):
            image[top:bottom, left:right] = colors[rng.choice(4, p=(0.2, 0.2, 0.2, 0.4))]
    for cut in cuts[0]:
        image[max(0, cut - 2) : cut + 2] = 0.07
    for cut in cuts[1]:
        image[:, max(0, cut - 2) : cut + 2] = 0.07
    return image


def _poster(rng: Generator) -> Floats:
    """Set a picture over lines of print."""
    image = _flat(256, (0.94, 0.91, 0.84))
    image[16:140, 16:240] = _patches(_clouds(rng, 256, 1.7), _lively(rng, 5))[16:140, 16:240]
    _strokes(rng, image, (152, 200, 16, 240), 0.12)
    for left in (16, 132):
        _strokes(rng, image, (204, 248, left, left + 104), 0.25)
    return image


def _map(rng: Generator) -> Floats:
    """Coloured countries in a blue sea, with a graticule."""
    size = 256
    height = _clouds(rng, size, 1.6)
    land = _patches(_clouds(rng, size, 1.8), _lively(rng, 9) * 0.5 + 0.42)
    sea = np.array((0.62, 0.76, 0.83)) + 0.02 * height[:, :, None]
    image = np.where((height > 0.1)[:, :, None], land, sea).astype(np.float32)
    image[np.abs(height - 0.1) < 0.05] = (0.25, 0.28, 0.30)
    image[::32] *= 0.8
    image[:, ::32] *= 0.8
    return image


def _window(rng: Generator) -> Floats:
    """Paint the garden behind the glass."""
    size = 512
    u, v = _grid(size)
    clouds = np.clip(0.5 + 0.5 * _clouds(rng, size, 1.6), 0, 1)[:, :, None]
    sky = np.array((0.50, 0.70, 0.93)) + (1 - v)[:, :, None] * np.array((-0.1, -0.05, 0.0))
    white = np.array((0.97, 0.97, 0.98))
    image: Floats = (sky * (1 - clouds) + clouds * white).astype(np.float32)
    for base, dark in ((0.50, 0.72), (0.60, 0.5), (0.72, 0.35)):
        edge = base + 0.055 * _clouds(rng, size, 1.1)[0]
        trees = v > edge[None, :]
        greens = _ramp(
            _clouds(rng, size, 1.0), [(0.20, 0.32, 0.14), (0.42, 0.56, 0.24), (0.66, 0.74, 0.40)]
        )
        image[trees] = (greens * (0.55 + 0.6 * dark))[trees]
    lawn = v > 0.86
    grass = _flat(size, (0.46, 0.62, 0.26))
    image[lawn] = _shaded(grass, _clouds(rng, size, 0.7, 0.3), 0.12)[lawn]
    return image


def _door(rng: Generator) -> Floats:
    """White door with four sunk panels."""
    image = _plaster(rng, (0.88, 0.86, 0.82), 0.012)
    for top, bottom in ((25, 120), (135, 235)):
        for left, right in ((30, 118), (138, 226)):
            image[top:bottom, left:right] *= 0.80
            image[top + 4 : bottom, left + 5 : right] *= 1.22
            image[top + 4 : bottom - 3, left + 5 : right - 4] *= 0.96
    return image


def _clock(rng: Generator) -> Floats:
    """Dial with twelve marks and two hands."""
    size = 256
    u, v = _grid(size)
    x, y = 2 * u - 1, 2 * v - 1
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    image = _flat(size, (0.94, 0.92, 0.86))
    hour = np.abs((angle * 6 / np.pi + 0.5) % 1 - 0.5)
    image[(hour < 0.10) & (radius > 0.68) & (radius < 0.85)] = 0.1
    for direction, length in zip(rng.uniform(-np.pi, np.pi, 2), (0.45, 0.65), strict=True):
        along = x * np.cos(direction) + y * np.sin(direction)
        beside = np.abs(y * np.cos(direction) - x * np.sin(direction))
        image[(beside < 0.03) & (along > -0.1) & (along < length)] = 0.1
    image[radius > 0.88] = (0.35, 0.22, 0.14)
    return image


PAINTERS: dict[str, Callable[[Generator], Floats]] = {
    "planks": _planks,
    "oak": lambda rng: _wood(rng, (0.66, 0.49, 0.32)),
    "walnut": lambda rng: _wood(rng, (0.38, 0.25, 0.17)),
    "white": lambda rng: _plaster(rng, (0.90, 0.89, 0.86), 0.010),
    "ceiling": lambda rng: _plaster(rng, (0.93, 0.92, 0.89), 0.018),
    "cream": lambda rng: _plaster(rng, (0.86, 0.81, 0.71), 0.022),
    "sage": lambda rng: _plaster(rng, (0.60, 0.67, 0.59), 0.026),
    "black": lambda rng: _plaster(rng, (0.10, 0.10, 0.11), 0.05),
    "brass": lambda rng: _plaster(rng, (0.72, 0.56, 0.30), 0.05),
    "terracotta": lambda rng: _plaster(rng, (0.72, 0.40, 0.28), 0.06),
    "bricks": _bricks,
    "rug": _rug,
    "sofa": lambda rng: _fabric(rng, (0.25, 0.38, 0.45)),
    "chair": lambda rng: _fabric(rng, (0.78, 0.52, 0.26)),
    "cushion1": _cushion,
    "cushion2": _cushion,
    "leaves": _leaves,
    "curtain": _curtain,
    "books1": _books,
    "books2": _books,
    "books3": _books,
    "landscape": _landscape,
    "abstract": _abstract,
    "circles": _circles,
    "blocks": _blocks,
    "poster1": _poster,
    "poster2": _poster,
    "map": _map,
    "window": _window,
    "door": _door,
    "clock": _clock,
    # Nearly without contrast: surfaces on which no corner is found.
    "plaster": lambda rng: _plaster(rng, (0.87, 0.86, 0.84), 0.003),
    "screed": lambda rng: _plaster(rng, (0.58, 0.57, 0.55), 0.005),
    "lacquer": lambda rng: _plaster(rng, (0.80, 0.80, 0.79), 0.002),
    "felt": lambda rng: _plaster(rng, (0.36, 0.38, 0.42), 0.006),
}
