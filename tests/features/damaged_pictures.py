# SPDX-License-Identifier: BSD-3-Clause
"""One rendered picture in every format and flavour, damaged in seeded ways."""

import io
import random
import struct
import zlib
from collections.abc import Callable, Iterator
from functools import cache

import cv2
import numpy as np
from PIL import Image

from epi360.cameras import Equirectangular
from epi360.poses import Pose
from epi360_scenes import furnished_room

SIZE = (512, 256)
TIFF_KINDS = ("raw", "tiff_lzw", "tiff_adobe_deflate", "packbits", "jpeg")


@cache
def picture():
    world_from_cam = Pose(np.eye(3), np.array([0.1, -1.5, -0.35]))
    return furnished_room(1).render(Equirectangular(*SIZE), world_from_cam).image


def encoded(pixels, kind, **options):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


def cmyk(pixels, **options):
    file = io.BytesIO()
    Image.fromarray(pixels).convert("CMYK").save(file, "JPEG", **options)
    return file.getvalue()


def interlaced_png(pixels):
    """PNG whose pixels come in the seven passes of Adam7, which Pillow does not write."""
    passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2),
              (0, 1, 1, 2)]  # fmt: skip
    rows = (b"\0" + row.tobytes() for x, y, dx, dy in passes for row in pixels[y::dy, x::dx])
    header = struct.pack(">IIBBBBB", *pixels.shape[1::-1], 8, 2, 0, 0, 1)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(b"".join(rows))), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def tiff(pixels, kind, chunk_size):
    """TIFF in strips (as wide as the picture) or in tiles, each of which Pillow compresses."""
    (width, height), (chunk_width, chunk_height) = pixels.shape[1::-1], chunk_size
    chunks, tags = [], {}
    for top in range(0, height, chunk_height):
        for left in range(0, width, chunk_width):
            chunk = pixels[top : top + chunk_height, left : left + chunk_width]
            data, tags = _compressed_chunk(np.ascontiguousarray(chunk), kind)
            chunks.append(data)
    offsets = [8 + sum(map(len, chunks[:index])) for index in range(len(chunks))]
    lengths = [len(chunk) for chunk in chunks]
    kept = {tag: tags[tag] for tag in (258, 259, 262, 277, 284, 347) if tag in tags}
    places = {322: chunk_width, 323: chunk_height, 324: offsets, 325: lengths}
    if chunk_width == width:
        places = {273: offsets, 278: chunk_height, 279: lengths}
    start = 8 + sum(lengths)
    directory = _tiff_directory({256: width, 257: height} | kept | places, start)
    return b"II*\0" + struct.pack("<I", start) + b"".join(chunks) + directory


def _tiff_directory(tags, start):
    entries, values, kinds = b"", b"", {258: (3, "H"), 347: (7, "B")}
    end = start + 2 + 12 * len(tags) + 4
    for tag, value in sorted(tags.items()):
        numbers = [value] if isinstance(value, int) else list(value)
        number, letter = kinds.get(tag, (4, "I"))
        packed = struct.pack(f"<{len(numbers)}{letter}", *numbers)
        if len(packed) > 4:
            packed, values = struct.pack("<I", end + len(values)), values + packed
        entries += struct.pack("<HHI", tag, number, len(numbers)) + packed.ljust(4, b"\0")
    return struct.pack("<H", len(tags)) + entries + bytes(4) + values


def _compressed_chunk(pixels, kind):
    file = io.BytesIO(encoded(pixels, "TIFF", compression=kind, tiffinfo={278: 2**16}))
    image = Image.open(file)
    (place,), (length,) = image.tag_v2[273], image.tag_v2[279]
    return file.getvalue()[place : place + length], image.tag_v2


@cache
def whole_files() -> dict[str, bytes]:
    """A picture in every format and flavour."""
    rgb = picture()
    deep = cv2.cvtColor(rgb.astype(np.uint16) * 257, cv2.COLOR_RGB2BGR)
    files = {
        "JPEG baseline": encoded(rgb, "JPEG", quality=90),
        "JPEG one colour": encoded(rgb[..., 1], "JPEG", quality=90),
        "JPEG progressive": encoded(rgb, "JPEG", quality=90, progressive=True),
        "JPEG restart markers": encoded(rgb, "JPEG", quality=90, restart_marker_rows=1),
        "JPEG CMYK": cmyk(rgb, quality=90),
        "PNG 8 bit": encoded(rgb, "PNG"),
        "PNG 16 bit": cv2.imencode(".png", deep)[1].tobytes(),
        "PNG interlaced": interlaced_png(rgb),
        "WebP lossy": encoded(rgb, "WEBP", quality=85),
        "WebP lossless": encoded(rgb, "WEBP", lossless=True),
        "BMP": encoded(rgb, "BMP"),
        "TIFF 16 bit LZW": cv2.imencode(".tiff", deep)[1].tobytes(),
    }
    for kind in TIFF_KINDS:
        name = kind.removeprefix("tiff_").removeprefix("adobe_")
        files[f"TIFF {name} strips"] = tiff(rgb, kind, (SIZE[0], 16))
        files[f"TIFF {name} tiles"] = tiff(rgb, kind, (128, 64))
    return files


def _cut(data, rng):
    return data[: rng.randrange(len(data) // 10, len(data) - 4)]


def _cut_with_end(data, rng):
    """The end of a file, such as an end marker, behind what a download left of its start."""
    place = rng.randrange(len(data) // 10, len(data) - 100)
    return data[:place] + data[-12:]


def _zeroed(data, rng):
    length = min(rng.choice((64, 512, 4096)), len(data) // 4)
    place = rng.randrange(len(data) // 20, len(data) - length)
    return data[:place] + bytes(length) + data[place + length :]


def _zeroed_to_the_end(data, rng):
    """What a file system keeps of a file that was being written."""
    place = rng.randrange(len(data) // 10, len(data) - 100)
    return data[:place] + bytes(len(data) - place)


def _replaced(data, rng):
    length = min(rng.choice((16, 512)), len(data) // 4)
    place = rng.randrange(len(data) // 20, len(data) - length)
    return data[:place] + rng.randbytes(length) + data[place + length :]


def _removed(data, rng):
    length = min(rng.choice((1, 64, 512)), len(data) // 4)
    place = rng.randrange(len(data) // 20, len(data) - length)
    return data[:place] + data[place + length :]


def _swapped(data, rng):
    length = min(512, len(data) // 8)
    first = rng.randrange(len(data) // 20, len(data) // 2)
    second = rng.randrange(len(data) // 2 + length, len(data) - length)
    blocks = data[first : first + length], data[second : second + length]
    middle = data[first + length : second]
    return data[:first] + blocks[1] + middle + blocks[0] + data[second + length :]


def _flipped(data, rng):
    changed = bytearray(data)
    for _ in range(rng.choice((1, 8, 64))):
        changed[rng.randrange(len(data) // 20, len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


DAMAGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "cut": _cut,
    "cut, end kept": _cut_with_end,
    "zeroed": _zeroed,
    "zeroed to end": _zeroed_to_the_end,
    "replaced": _replaced,
    "removed": _removed,
    "swapped": _swapped,
    "bits flipped": _flipped,
}


def damaged_files(data: bytes, damage: str, count: int) -> Iterator[bytes]:
    """So many files that differ from a whole one by one kind of damage."""
    for seed in range(count):
        yield DAMAGES[damage](data, random.Random(f"{damage} {seed}"))


def looks_different(pixels, whole) -> bool:
    """Whether more than a thousandth of the pixels differ by more than a compression does."""
    if pixels.shape != whole.shape:
        return True
    distance = np.abs(pixels.astype(np.int16) - whole).max(axis=2)
    return bool((distance > 8).mean() > 1e-3)
