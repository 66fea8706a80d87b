# SPDX-License-Identifier: BSD-3-Clause
"""Whether a TIFF file is complete; OpenCV goes on behind damage as if nothing were.

Each strip or tile must lie in the file and have as much data as its pixels need, and no more.
"""

import io
import zlib
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from PIL.TiffImagePlugin import ImageFileDirectory_v2, TiffImageFile

from epi360.features.image_headers import ignoring_warnings
from epi360.features.jpeg_files import check_jpeg, read_jpeg_header

_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _COLORS = 256, 257, 258, 259, 262
_BIT_ORDER, _SAMPLES, _PLANAR, _JPEG_TABLES = 266, 277, 284, 347
_STRIP_OFFSETS, _STRIP_ROWS, _STRIP_LENGTHS = 273, 278, 279
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_LENGTHS = 322, 323, 324, 325
_LOOKED_AT = (
    *(_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _COLORS, _BIT_ORDER, _SAMPLES, _PLANAR, _JPEG_TABLES),
    *(_STRIP_OFFSETS, _STRIP_ROWS, _STRIP_LENGTHS),
    *(_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS, _TILE_LENGTHS),
)
_RAW, _JPEG, _DEFLATED, _PACK_BITS = 1, 7, (8, 32946), 32773
_YCBCR = 6  # often with fewer numbers for colours than for brightness
_BLOCK = 2**14  # bytes; inflated, they are 16 MB at most
_DAMAGED = "is a damaged TIFF file; copy or export it again"
_TRUNCATED = "is a truncated TIFF file; copy or export it again"


class _Chunk(NamedTuple):
    """A strip or tile: its compressed data, their length as stated, its bytes once decompressed.

    Encoders may fill the last strip, and fill tiles, up to ``most`` bytes.
    """

    data: memoryview
    length: int
    needed: int
    most: int


def check_tiff(data: bytes) -> None:
    """Raise ``ValueError`` for a TIFF file that is cut or damaged."""
    try:
        with ignoring_warnings():
            tags = _first_directory(data)
    except Exception:  # what damaged headers make Pillow raise is not documented
        tags = {}
    if _WIDTH not in tags or _HEIGHT not in tags:
        raise ValueError(_DAMAGED)
    try:
        chunks = list(_chunks(memoryview(data), tags))
        tables = bytes(tags.get(_JPEG_TABLES, b""))
    except Exception:  # as above; old files do not state the lengths of their strips
        return  # OpenCV's decoder says what is wrong
    if any(len(chunk.data) < chunk.length for chunk in chunks):
        raise ValueError(_TRUNCATED)
    compression = tags.get(_COMPRESSION, _RAW)
    if compression == _RAW:
        return
    if tags.get(_BIT_ORDER, 1) != 1 or tags.get(_COLORS) == _YCBCR and compression != _JPEG:
        is_whole = _is_decompressed(data)
    elif compression in _DEFLATED:
        is_whole = all(map(_is_inflated, chunks))
    elif compression == _JPEG:
        is_whole = all(_is_jpeg(chunk, tables) for chunk in chunks)
    elif compression == _PACK_BITS:
        is_whole = all(map(_is_unpacked, chunks))
    else:
        is_whole = _is_decompressed(data)
    if not is_whole:
        raise ValueError(_DAMAGED)


def _first_directory(data: bytes) -> Mapping[int, Any]:
    tags = ImageFileDirectory_v2(data[:8])
    file = io.BytesIO(data)
    file.seek(tags.next)
    tags.load(file)
    return {tag: tags[tag] for tag in _LOOKED_AT if tag in tags}


def _chunks(data: memoryview, tags: Mapping[int, Any]) -> Iterator[_Chunk]:
    """Strips or tiles of the first picture."""
    width, height = tags[_WIDTH], tags[_HEIGHT]
    planes = tags.get(_SAMPLES, 1) if tags.get(_PLANAR, 1) == 2 else 1
    bits = np.atleast_1d(tags.get(_BITS, 1))
    is_tiled = _TILE_OFFSETS in tags
    rows = tags[_TILE_HEIGHT] if is_tiled else min(tags.get(_STRIP_ROWS, height), height)
    columns = tags[_TILE_WIDTH] if is_tiled else width
    row_bytes = (columns * int(bits.sum() if planes == 1 else bits[0]) + 7) // 8
    offsets = tags[_TILE_OFFSETS if is_tiled else _STRIP_OFFSETS]
    lengths = tags[_TILE_LENGTHS if is_tiled else _STRIP_LENGTHS]
    down, across = -(-height // rows), -(-width // columns)
    for index in range(planes * down * across):
        offset, length = offsets[index], lengths[index]
        there = rows if is_tiled else min(rows, height - index % down * rows)
        part = data[offset : offset + length]
        yield _Chunk(part, length, there * row_bytes, rows * row_bytes)


def _is_inflated(chunk: _Chunk) -> bool:
    """Whether deflated data are those of their checksum; libtiff reads no further than needed."""
    inflating, size = zlib.decompressobj(), 0
    try:
        for start in range(0, len(chunk.data), _BLOCK):
            size += len(inflating.decompress(chunk.data[start : start + _BLOCK]))
            if inflating.eof or size > chunk.most:
                break
    except zlib.error:
        return False
    return inflating.eof and chunk.needed <= size <= chunk.most


def _is_jpeg(chunk: _Chunk, tables: bytes) -> bool:
    # What strips and tiles have in common is a file of its own, without picture.
    data = tables[:-2] + bytes(chunk.data[2:]) if tables else bytes(chunk.data)
    try:
        width, height = read_jpeg_header(data).size
        if width * height > chunk.most:  # it would take longer than its picture may
            return False
        check_jpeg(data)
    except ValueError:
        return False
    return True


def _is_unpacked(chunk: _Chunk) -> bool:
    """Whether the runs of PackBits are as many bytes as are needed; one more may be filling."""
    at, size, data = 0, 0, chunk.data
    while at < len(data) - 1:
        length = data[at]
        # Below 128, that many bytes and one follow; above it, one that is repeated.
        at += length + 2 if length < 128 else 2 if length > 128 else 1
        size += length + 1 if length < 128 else 257 - length if length > 128 else 0
    return at <= len(data) and size in (chunk.needed, chunk.most)


def _is_decompressed(data: bytes) -> bool:
    try:
        with ignoring_warnings():
            TiffImageFile(io.BytesIO(data)).load()
    except OSError as error:
        return "decoder error" not in str(error)
    except Exception:  # Pillow does not know all kinds that OpenCV reads
        return True
    return True
