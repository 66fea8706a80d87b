# SPDX-License-Identifier: BSD-3-Clause
"""Size and metadata of image files from their headers, which Pillow reads, without decoding them.

Its formats are opened by their own classes: `PIL.Image.open` would refuse panoramas that it takes
for decompression bombs, by a limit of the whole process, before their size is known.
"""

import contextlib
import os
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO, Any

from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngStream
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from epi360.runs.input_files import check_is_file

JPEG_SIGNATURE, PNG_SIGNATURE = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
TIFF_SIGNATURES = (b"II*\0", b"MM\0*")
LARGEST_XMP = 2**20  # a JPEG holds 64 kB of it, the longest seen in panoramas is 4 kB
_WIDTH, _HEIGHT, _ORIENTATION, _XMP = 256, 257, 274, 700  # tags of TIFF and Exif
_PNG_METADATA = (b"IHDR", b"tRNS", b"eXIf", b"iTXt")
_TRANSPOSED = (5, 6, 7, 8)  # orientations that exchange width and height


@dataclass(frozen=True)
class ImageHeader:
    """What the header of an image file says; ``size`` is None if only decoding tells."""

    size: tuple[int, int] | None = None
    xmp: bytes | None = None
    may_have_alpha: bool = field(default=True, compare=False)


def read_image_header(path: str | os.PathLike[str]) -> ImageHeader:
    """Header of any file; ``OSError`` if it cannot be read, ``ValueError`` for a device or pipe."""
    # Unbuffered: a buffer would read all of a large PNG while its chunks are skipped.
    check_is_file(path)
    with open(path, "rb", buffering=0) as file:
        return parse_image_header(file)


def parse_image_header(file: IO[bytes]) -> ImageHeader:
    """Header of a file that is open at its start; ``OSError`` if it cannot be read."""
    start = file.read(8)
    file.seek(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged metadata
            if start.startswith(JPEG_SIGNATURE):
                return _jpeg_header(JpegImageFile(file))
            if start == PNG_SIGNATURE:
                return _png_header(file)
            if start.startswith(TIFF_SIGNATURES):
                return _tiff_header(file)
    except Exception as error:  # what damaged headers make Pillow raise is not documented
        if isinstance(error, OSError) and error.errno is not None:
            raise
    return ImageHeader()  # decoding says what is wrong


def _jpeg_header(image: JpegImageFile) -> ImageHeader:
    size = image.size[::-1] if _orientation(image.info) in _TRANSPOSED else image.size
    return ImageHeader(size if all(size) else None, image.info.get("xmp"), may_have_alpha=False)


def _png_header(file: IO[bytes]) -> ImageHeader:
    chunks = PngStream(file)
    file.seek(len(PNG_SIGNATURE))
    try:
        while (chunk := chunks.read())[0] != b"IEND":  # those behind the picture count too
            kind, start, length = chunk
            if kind in _PNG_METADATA:
                with contextlib.suppress(ValueError):  # a text that is too long once unpacked
                    chunks.call(kind, start, length)
            file.seek(start + length + 4)
    except (struct.error, SyntaxError):
        pass  # cut or damaged: what came before it counts
    xmp = chunks.im_info.get("xmp")
    # Whether OpenCV turns a PNG depends on transparency and on its version.
    known = all(chunks.im_size) and _orientation(chunks.im_info) not in _TRANSPOSED
    may_have_alpha = chunks.im_mode in ("LA", "RGBA") or "transparency" in chunks.im_info
    return ImageHeader(
        chunks.im_size if known else None,
        xmp.encode() if isinstance(xmp, str) else xmp,
        may_have_alpha,
    )


def _tiff_header(file: IO[bytes]) -> ImageHeader:
    tags = ImageFileDirectory_v2(file.read(8))
    file.seek(tags.next)
    tags.load(file)
    size = (tags.get(_WIDTH, 0), tags.get(_HEIGHT, 0))
    known = min(size) > 0 and tags.get(_ORIENTATION, 1) not in _TRANSPOSED
    xmp: Any = tags.get(_XMP)
    usable = isinstance(xmp, bytes) and len(xmp) <= LARGEST_XMP
    return ImageHeader(size if known else None, xmp if usable else None)


def _orientation(info: Mapping[Any, Any]) -> int:
    exif = Image.Exif()
    try:
        exif.load(info.get("exif", b""))
    except Exception:  # as above
        return 1
    return int(exif.get(_ORIENTATION, 1))
