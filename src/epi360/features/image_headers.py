# SPDX-License-Identifier: BSD-3-Clause
"""Size and metadata of image files from their headers, which Pillow reads, without decoding them.

Its formats are opened by their own classes: `PIL.Image.open` would refuse panoramas that it takes
for decompression bombs, by a limit of the whole process, before their size is known.
"""

import contextlib
import os
import struct
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from threading import Lock
from typing import IO, Any

from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngStream
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from epi360.runs.input_files import check_is_file

JPEG_SIGNATURE, PNG_SIGNATURE = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
TIFF_SIGNATURES = (b"II*\0", b"MM\0*")
LARGEST_XMP = 2**20  # a JPEG holds 64 kB of it, the longest seen in panoramas is 4 kB
_WIDTH, _HEIGHT, _ORIENTATION, _XMP, _GPS = 256, 257, 274, 700, 34853  # tags of TIFF and Exif
_LATITUDE, _LONGITUDE = (1, 2, "NS"), (3, 4, "EW")  # tags of the hemisphere and of the angle
_PNG_METADATA = (b"IHDR", b"tRNS", b"eXIf", b"iTXt")
_IGNORING_WARNINGS = Lock()
_TRANSPOSED = (5, 6, 7, 8)  # orientations that exchange width and height


@contextlib.contextmanager
def ignoring_warnings() -> Iterator[None]:
    """Ignore what Pillow warns of damaged metadata.

    One thread at a time: of two, the second to stop would not restore what was there.
    """
    with _IGNORING_WARNINGS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@dataclass(frozen=True)
class ImageHeader:
    """What the header of an image file says; ``size`` is None if only decoding tells.

    ``orientation`` is that of a JPEG or PNG file. ``latitude_longitude_deg`` is that of Exif's GPS;
    None if there is none, or it is damaged.
    """

    size: tuple[int, int] | None = None
    xmp: bytes | None = None
    may_have_alpha: bool = field(default=True, compare=False)
    orientation: int = field(default=1, compare=False)
    latitude_longitude_deg: tuple[float, float] | None = None


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
        with ignoring_warnings():
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
    exif = _exif(image.info)
    orientation = _orientation(exif)
    size = image.size[::-1] if orientation in _TRANSPOSED else image.size
    known = size if all(size) else None
    place = _latitude_longitude(exif)
    return ImageHeader(known, image.info.get("xmp"), False, orientation, place)


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
    exif = _exif(chunks.im_info)
    orientation = _orientation(exif)
    size = chunks.im_size[::-1] if orientation in _TRANSPOSED else chunks.im_size
    may_have_alpha = chunks.im_mode in ("LA", "RGBA") or "transparency" in chunks.im_info
    return ImageHeader(
        size if all(size) else None,
        xmp.encode() if isinstance(xmp, str) else xmp,
        may_have_alpha,
        orientation,
        _latitude_longitude(exif),
    )


def _tiff_header(file: IO[bytes]) -> ImageHeader:
    tags = ImageFileDirectory_v2(file.read(8))
    file.seek(tags.next)
    tags.load(file)
    size = (tags.get(_WIDTH, 0), tags.get(_HEIGHT, 0))
    known = min(size) > 0 and tags.get(_ORIENTATION, 1) not in _TRANSPOSED
    xmp: Any = tags.get(_XMP)
    usable = isinstance(xmp, bytes) and len(xmp) <= LARGEST_XMP
    place = _latitude_longitude(_exif_of_tiff(file))
    return ImageHeader(
        size if known else None, xmp if usable else None, latitude_longitude_deg=place
    )


def _exif_of_tiff(file: IO[bytes]) -> Image.Exif:
    exif = Image.Exif()
    with contextlib.suppress(Exception):  # as above
        file.seek(0)
        exif.load_from_fp(file)
    return exif


def _exif(info: Mapping[Any, Any]) -> Image.Exif:
    exif = Image.Exif()
    with contextlib.suppress(Exception):  # as above
        exif.load(info.get("exif", b""))
    return exif


def _orientation(exif: Image.Exif) -> int:
    try:
        return int(exif.get(_ORIENTATION, 1))
    except Exception:  # as above
        return 1


def _latitude_longitude(exif: Image.Exif) -> tuple[float, float] | None:
    try:
        tags = exif.get_ifd(_GPS)
        latitude, longitude = (_signed_deg(tags, *names) for names in (_LATITUDE, _LONGITUDE))
    except Exception:  # as above
        return None
    # A receiver without a fix writes zeros or 0/0.
    is_known = abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and (latitude, longitude) != (0, 0)
    return (latitude, longitude) if is_known else None


def _signed_deg(tags: Mapping[int, Any], hemisphere: int, angle: int, letters: str) -> float:
    """Angle of degrees, minutes and seconds, positive in the first of two hemispheres."""
    degrees, minutes, seconds = (float(number) for number in tags[angle])
    sign = (1.0, -1.0)[letters.index(str(tags[hemisphere]).strip("\0 ").upper())]
    return sign * (degrees + minutes / 60.0 + seconds / 3600.0)
