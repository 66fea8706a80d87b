# SPDX-License-Identifier: BSD-3-Clause
"""Size and metadata of image files from their first bytes, without decoding them.

Layouts: JPEG ITU T.81 annex B, PNG specification 5.3 and 11.3, TIFF 6.0 section 2; where the
metadata (XMP) sits in each: Adobe, XMP Specification Part 3.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

LARGEST_XMP = 2**20  # a JPEG holds 64 kB of it, the longest seen in panoramas is 4 kB
XMP_IN_JPEG = b"http://ns.adobe.com/xap/1.0/\0"
XMP_IN_PNG = b"XML:com.adobe.xmp\0"
_EXIF_IN_JPEG = b"Exif\0\0"
_WIDTH, _HEIGHT, _ORIENTATION, _XMP = 256, 257, 274, 700  # tags of TIFF and Exif
_TRANSPOSED = (5, 6, 7, 8)  # orientations that exchange width and height


@dataclass(frozen=True)
class ImageHeader:
    """What the header of an image file says.

    Attributes
    ----------
    size : (int, int) or None
        Width and height of the upright picture, as `read_image` returns it; None where only
        decoding tells: WebP, BMP, unusual orientations and files that are damaged or no images.
    xmp : bytes or None
        XMP packet of a JPEG, PNG or TIFF file.
    """

    size: tuple[int, int] | None = None
    xmp: bytes | None = None


def read_image_header(path: str | os.PathLike[str]) -> ImageHeader:
    """Header of an image file.

    Parameters
    ----------
    path : path-like
        Any file.

    Returns
    -------
    header : ImageHeader

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    # Unbuffered: a buffer would read all of a large PNG while its chunks are skipped.
    with open(path, "rb", buffering=0) as file:
        return parse_image_header(file)


def parse_image_header(file: BinaryIO | io.FileIO) -> ImageHeader:
    """Header of an image file that is open for reading, at its start.

    Parameters
    ----------
    file : binary file

    Returns
    -------
    header : ImageHeader

    Raises
    ------
    OSError
        If it cannot be read.
    """
    start = file.read(8)
    file.seek(0)
    try:
        if start.startswith(b"\xff\xd8\xff"):
            return _jpeg_header(file)
        if start == b"\x89PNG\r\n\x1a\n":
            return _png_header(file)
        if start.startswith((b"II*\0", b"MM\0*")):
            return _tiff_header(file)
    except (struct.error, zlib.error):  # cut or damaged: decoding says how
        pass
    return ImageHeader()


def _jpeg_header(file: BinaryIO | io.FileIO) -> ImageHeader:
    width, height, orientation, xmp = 0, 0, 1, None
    for kind, data in _jpeg_segments(file):
        if kind == 0xE1 and data.startswith(XMP_IN_JPEG):
            xmp = xmp or data[len(XMP_IN_JPEG) :]
        elif kind == 0xE1 and data.startswith(_EXIF_IN_JPEG):
            orientation = _exif_orientation(data[len(_EXIF_IN_JPEG) :])
        elif kind != 0xE1:
            height, width = struct.unpack(">HH", data[1:5])
    if orientation in _TRANSPOSED:
        width, height = height, width
    return ImageHeader((width, height) if width and height else None, xmp)


def _jpeg_segments(file: BinaryIO | io.FileIO) -> Iterator[tuple[int, bytes]]:
    """Metadata (APP1) and frame segments before the picture begins."""
    file.seek(2)
    while True:
        filling, kind = struct.unpack("BB", file.read(2))
        while filling == kind == 0xFF:  # any number of filling bytes
            (kind,) = struct.unpack("B", file.read(1))
        (length,) = struct.unpack(">H", file.read(2))
        if filling != 0xFF or kind in (0xD9, 0xDA) or length < 2:
            return
        is_frame = 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC)
        if is_frame or kind == 0xE1:
            yield kind, file.read(length - 2)
        else:
            file.seek(length - 2, os.SEEK_CUR)


def _png_header(file: BinaryIO | io.FileIO) -> ImageHeader:
    size, xmp = None, None
    for kind, data in _png_chunks(file):
        if kind == b"IHDR":
            size = struct.unpack(">II", data[:8])
        elif kind == b"eXIf" and _exif_orientation(data) in _TRANSPOSED:
            size = None  # whether that is applied depends on transparency and on OpenCV's version
        elif kind == b"iTXt" and data.startswith(XMP_IN_PNG):
            xmp = xmp or _international_text(data[len(XMP_IN_PNG) :])
    return ImageHeader(size, xmp)


def _png_chunks(file: BinaryIO | io.FileIO) -> Iterator[tuple[bytes, bytes]]:
    """Chunks of metadata; those behind the picture count, tools append them."""
    file.seek(8)
    while len(start := file.read(8)) == 8:
        length, kind = struct.unpack(">I4s", start)
        if kind == b"IEND":
            return
        if kind in (b"IHDR", b"eXIf", b"iTXt") and length <= LARGEST_XMP:
            yield kind, file.read(length)
            length = 0
        file.seek(length + 4, os.SEEK_CUR)


def _international_text(data: bytes) -> bytes | None:
    """Text of an iTXt chunk after its keyword."""
    compressed, parts = data[:1] == b"\1", data[2:].split(b"\0", 2)
    if len(parts) < 3:
        return None
    if not compressed:
        return parts[2]
    unpacking = zlib.decompressobj()
    text = unpacking.decompress(parts[2], LARGEST_XMP)
    return text if unpacking.eof else None


def _tiff_header(file: BinaryIO | io.FileIO) -> ImageHeader:
    tags = _tiff_tags(file)
    _, width = tags.get(_WIDTH, (0, 0))
    _, height = tags.get(_HEIGHT, (0, 0))
    _, orientation = tags.get(_ORIENTATION, (1, 1))
    known = min(width, height) > 0 and orientation not in _TRANSPOSED
    length, offset = tags.get(_XMP, (0, 0))
    xmp = None
    if 4 < length <= LARGEST_XMP:
        file.seek(offset)
        xmp = file.read(length)
    return ImageHeader((width, height) if known else None, xmp)


def _exif_orientation(data: bytes) -> int:
    try:
        return _tiff_tags(io.BytesIO(data)).get(_ORIENTATION, (1, 1))[1]
    except struct.error:
        return 1


def _tiff_tags(file: BinaryIO | io.FileIO) -> dict[int, tuple[int, int]]:
    """Count and value (or its offset) of each tag of the first picture."""
    order = "<" if file.read(4)[:2] == b"II" else ">"
    (offset,) = struct.unpack(order + "I", file.read(4))
    file.seek(offset)
    (count,) = struct.unpack(order + "H", file.read(2))
    tags = {}
    for tag, kind, length, value in struct.iter_unpack(order + "HHI4s", file.read(12 * count)):
        is_short = kind == 3
        tags[tag] = (
            length,
            struct.unpack(
                order + "H" if is_short else order + "I", value[:2] if is_short else value
            )[0],
        )
    return tags
