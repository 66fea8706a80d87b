# SPDX-License-Identifier: BSD-3-Clause
"""Surfaces that repeat all over a home: carpet, tiles, blinds, doors, and a tripod's logo."""

import zlib
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from epi360_scenes.painting import PAINTERS
from epi360_scenes.textures import GAMMA, TextureAtlas, atlas_of_images

Floats = NDArray[np.float32]
Generator = np.random.Generator
Color = tuple[float, float, float]


def _speckle(rng: Generator, size: int, grain: float) -> Floats:
    """Seamless noise of unit deviation whose finest blobs are about `grain` texels wide."""
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    gain = np.exp(-0.5 * (frequency * grain * 2.0) ** 2)
    gain[0, 0] = 0.0
    waves = np.fft.rfft2(rng.standard_normal((size, size)))
    field = np.fft.irfft2(waves * gain, s=(size, size))
    return np.asarray(field / field.std(), np.float32)


def _turns(size: int) -> tuple[Floats, Floats]:
    ticks = (np.arange(size, dtype=np.float32) + 0.5) / size
    return np.broadcast_to(ticks, (size, size)), np.broadcast_to(ticks[:, None], (size, size))


def _colored(field: Floats, color: Color | NDArray[np.float64]) -> Floats:
    return np.asarray(field[:, :, None] * np.asarray(color, np.float32), np.float32)


def _wear(rng: Generator, size: int) -> Floats:
    """What no other place of a surface has: stains, wear and grain, around one."""
    fields = [_speckle(rng, size, grain) for grain in (8, 18, 40)]
    return np.asarray(1 + 0.07 * fields[0] + 0.07 * fields[1] + 0.06 * fields[2], np.float32)


def _carpet(rng: Generator) -> Floats:
    """Wall-to-wall carpet: one woven motif again and again, and its wear."""
    size, motifs = 1024, 16
    u, v = _turns(size)
    base = rng.uniform(0.35, 0.6, 3)
    thread = base * rng.uniform(0.7, 1.3, 3)
    x, y = np.abs((u * motifs) % 1 - 0.5), np.abs((v * motifs) % 1 - 0.5)
    diamond = np.abs(x + y - rng.uniform(0.25, 0.42)) < 0.05
    dot = np.hypot(x, y) < rng.uniform(0.06, 0.14)
    pile = _wear(rng, size)
    image = _colored(pile, base)
    motif = diamond | dot
    image[motif] = _colored(pile, thread)[motif]
    return image


def _laminate(rng: Generator) -> Floats:
    """Floor boards of forty prints, laid in any order: a board is found in many places."""
    size, rows, prints, length = 1024, 24, 40, 300
    grain = _speckle(rng, size, 4) + 0.6 * _speckle(rng, size, 10)
    grain = np.asarray(grain[:, ::2].repeat(2, axis=1)[:, :length])
    step = size // rows
    starts = rng.integers(size - step, size=prints)
    tones = rng.uniform(0.8, 1.1, prints)
    image = np.empty((size, size, 3), np.float32)
    wear = _wear(rng, size)
    for row in range(rows + 1):
        band = slice(row * step, min((row + 1) * step, size))
        column = -int(rng.integers(length))
        while column < size:
            one = int(rng.integers(prints))
            board = tones[one] * (1 + 0.06 * grain[starts[one] : starts[one] + step])
            left, right = max(column, 0), min(column + length, size)
            part = board[: band.stop - band.start, left - column : right - column]
            image[band, left:right] = _colored(part, (0.66, 0.49, 0.34))
            image[band, right - 2 : right] *= 0.6
            column += length
        image[band.start : band.start + 2] *= 0.6
    return image * wear[:, :, None]


def _wall(rng: Generator) -> Floats:
    """Painted wall that nobody has painted for a while."""
    size = 1024
    tint = rng.uniform((0.74, 0.72, 0.62), (0.88, 0.84, 0.76))
    field = 0.035 * _speckle(rng, size, 10) + 0.04 * _speckle(rng, size, 26)
    return _colored((1 + field).astype(np.float32), tint)


def _tiles(rng: Generator) -> Floats:
    """Printed floor tiles, sixteen by sixteen, all with the same motif, between joints."""
    size, count = 1024, 16
    side = size // count
    quarter = _speckle(rng, side, 6)[: side // 2, : side // 2]
    quarter = quarter + quarter.T
    half = np.concatenate([quarter, quarter[:, ::-1]], axis=1)
    motif = np.concatenate([half, half[::-1]])
    colors = rng.uniform(0.35, 0.8, 3) * rng.uniform(0.75, 1.15, (3, 1))
    print_ = colors[np.searchsorted(np.quantile(motif, (0.4, 0.75)), motif)]
    image = np.tile(print_, (count, count, 1)).astype(np.float32)
    image *= np.sqrt(_wear(rng, size))[:, :, None]
    tones = rng.uniform(0.9, 1.08, (count, count)).repeat(side, axis=0).repeat(side, axis=1)
    image *= tones[:, :, None].astype(np.float32)
    for joint in range(0, size, side):
        image[joint : joint + 2] = 0.45
        image[:, joint : joint + 2] = 0.45
    return image


def _wall_tiles(rng: Generator) -> Floats:
    """Glazed wall tiles in a running bond, none quite like the next."""
    size, courses, columns = 1024, 32, 16
    u, v = _turns(size)
    course = (v * courses).astype(np.intp)
    along = (u * columns + 0.5 * (course % 2)) % columns
    glaze = rng.uniform(0.6, 0.85, 3) + rng.uniform(-0.06, 0.06, (courses, columns, 1))
    image = glaze[course, along.astype(np.intp)].astype(np.float32)
    image *= np.sqrt(_wear(rng, size))[:, :, None]
    joint = (along % 1.0 < 0.03) | ((v * courses) % 1.0 < 0.06)
    image[joint] = (0.5, 0.49, 0.47)
    return image


def _blinds(rng: Generator) -> Floats:
    """Closed window blinds: slats, cords, and light that falls through the gaps."""
    size, slats = 512, 20
    u, v = _turns(size)
    across = (v * slats) % 1.0
    light = 0.62 + 0.2 * across + 0.015 * _speckle(rng, size, 6)
    light = np.where(across < 0.14, 0.98, light)
    for cord in (0.15, 0.5, 0.85):
        light = np.where(np.abs(u - cord) < 0.006, 0.35, light)
    return _colored(light.astype(np.float32), (1.0, 0.97, 0.9))


def _panel_door(rng: Generator) -> Floats:
    """Stained door with six panels, mouldings and a kick plate."""
    size = 256
    rings = np.sin(7.0 * _speckle(rng, size, 30) + 40 * _turns(size)[0])
    grain = 1 + 0.02 * rings + 0.015 * _speckle(rng, size, 2)
    image = _colored(grain, rng.uniform((0.42, 0.28, 0.18), (0.62, 0.42, 0.28)))
    for top, bottom in ((14, 62), (76, 150), (164, 222)):
        for left, right in ((26, 116), (140, 230)):
            image[top:bottom, left:right] *= 0.6
            image[top + 3 : bottom, left + 6 : right] *= 1.55
            image[top + 6 : bottom - 4, left + 14 : right - 12] *= 0.92
    image[234:252, 16:240] = (0.66, 0.62, 0.52)
    return image


def _wallpaper(rng: Generator) -> Floats:
    """Pale stripes with a small printed sprig."""
    size, rows = 1024, 8
    u, v = _turns(size)
    tint = rng.uniform(0.70, 0.88, 3)
    field = 1 + 0.03 * np.sign(np.sin(2 * np.pi * 32 * u)) + 0.04 * _speckle(rng, size, 18)
    image = _colored(field.astype(np.float32), tint)
    half = _speckle(rng, 64, 5)
    sprig = (half + half[:, ::-1]) * np.hanning(64)[:, None] * np.hanning(64)
    ink = np.tile(np.pad(sprig > 0.45, 32), (rows, rows))
    ink = np.where((v * rows).astype(int) % 2 == 1, np.roll(ink, 64, axis=1), ink)
    image[ink.astype(bool)] *= rng.uniform(0.62, 0.82)
    return image


def _front(rng: Generator) -> Floats:
    """Cupboard front: two doors with frames and knobs."""
    size = 256
    image = _colored(1 + 0.015 * _speckle(rng, size, 2), rng.uniform(0.35, 0.8, 3))
    for left in (6, 132):
        image[6:250, left : left + 118] *= 0.93
        image[24:232, left + 18 : left + 100] *= 0.78
        image[28:230, left + 22 : left + 98] *= 1.2
    image[:, 126:130] = 0.12
    for knob in (112, 138):
        image[120:134, knob : knob + 6] = (0.75, 0.68, 0.45)
    return image


def _bedspread(rng: Generator) -> Floats:
    """Patchwork of printed squares."""
    size, count = 512, 6
    image = np.empty((size, size, 3), np.float32)
    edges = np.linspace(0, size, count + 1).astype(int)
    prints = [_speckle(rng, size, grain) for grain in (3, 6, 12)]
    for row in range(count):
        for column in range(count):
            part = np.s_[edges[row] : edges[row + 1], edges[column] : edges[column + 1]]
            two = rng.uniform(0.2, 0.9, (2, 3))
            image[part] = two[(prints[rng.integers(3)][part] > 0).astype(int)]
    return image


def _appliance(rng: Generator) -> Floats:
    """Oven or washing machine: a round glass, a row of knobs, a display."""
    size = 256
    u, v = _turns(size)
    image = _colored(1 + 0.01 * _speckle(rng, size, 3), (0.84, 0.85, 0.86))
    radius = np.hypot(u - 0.5, v - 0.6)
    image[radius < 0.32] = 0.55
    image[radius < 0.27] = (0.13, 0.15, 0.18)
    image[np.abs(radius - 0.18) < 0.01] = 0.35
    for knob in rng.choice(8, 4, replace=False):
        image[np.hypot(u - 0.1 - 0.07 * knob, v - 0.13) < 0.025] = 0.2
    image[20:44, 180:240] = (0.1, 0.25, 0.2)
    return image


def _logo(rng: Generator) -> Floats:
    """Badge that hides the tripod: a ring, a disc and marks like letters round it."""
    size = 512
    u, v = _turns(size)
    x, y = 2 * u - 1, 2 * v - 1
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    image = np.tile(rng.uniform(0.05, 0.3, 3).astype(np.float32), (size, size, 1))
    image[radius < 0.92] = 0.93
    image[radius < 0.60] = rng.uniform((0.6, 0.1, 0.1), (0.9, 0.5, 0.3))
    sector = ((angle + np.pi) / (2 * np.pi) * 28).astype(int) % 28
    for letter in np.flatnonzero(rng.random(28) < 0.2):
        inner, outer = np.sort(rng.uniform(0.64, 0.88, 2))
        image[(sector == letter) & (radius > inner) & (radius < outer + 0.03)] = 0.08
    image[radius < 0.25] = (0.95, 0.9, 0.75)
    return image


HOME_PAINTERS: dict[str, Callable[[Generator], Floats]] = {
    **PAINTERS,
    "carpet": _carpet,
    "laminate": _laminate,
    "wall": _wall,
    "tiles": _tiles,
    "walltiles": _wall_tiles,
    "blinds": _blinds,
    "paneldoor": _panel_door,
    "wallpaper": _wallpaper,
    "front": _front,
    "bedspread": _bedspread,
    "appliance": _appliance,
    "logo": _logo,
}


def home_atlas(seed: int, names: Iterable[str]) -> TextureAtlas:
    """Textures of a home; ``poster1#7`` is the seventh version of what ``poster1`` paints.

    Parameters
    ----------
    seed : int
        Each texture has its own random stream of this seed and its name.
    names : iterable of str
        Keys of `HOME_PAINTERS`, with or without a version.

    Returns
    -------
    atlas : TextureAtlas
    """
    images = {}
    for name in names:
        rng = np.random.Generator(np.random.PCG64([seed, zlib.crc32(name.encode())]))
        picture = HOME_PAINTERS[name.partition("#")[0]](rng)
        images[name] = np.clip(picture, 0, 1).astype(np.float32) ** np.float32(GAMMA)
    return atlas_of_images(images)
