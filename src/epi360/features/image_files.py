# SPDX-License-Identifier: BSD-3-Clause
"""Image files to pixels, refusing what OpenCV would decode in part, noisily or without a limit."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

MAX_PIXELS = 2**28
"""23170 x 11585: larger than any camera; 0.8 GB once decoded."""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_JPEG_SIGNATURE = b"\xff\xd8\xff"
_SIGNATURES = (_JPEG_SIGNATURE, _PNG_SIGNATURE, b"II*\0", b"MM\0*", b"RIFF", b"BM")
_RAW_FILES = {
    ".insp": "a raw dual fisheye file; export a stitched panorama first",
    ".insv": "a raw dual fisheye video; export stitched panoramas first",
    ".360": "a raw 360 video; export stitched panoramas first",
    ".dng": "a camera raw file; export a JPEG, PNG or TIFF first",
}
# The next marker inside JPEG scan data: FF 00 is a stuffed byte, FF D0..D7 restart, FF FF filling.
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")


def decode_image_file(path: Path, max_pixels: int, name: str) -> NDArray[Any]:
    """Pixels of a complete file in OpenCV's order, upright unless some are transparent.

    Parameters
    ----------
    path : Path
        JPEG, PNG, TIFF, WebP or BMP file.
    max_pixels : int
        Limit on width x height, checked before decoding for JPEG and PNG.
    name : str
        What error messages call the image.

    Returns
    -------
    pixels : ndarray, shape (H, W, 3) BGR or (H, W, 4) BGRA
        Of the file's own type.

    Raises
    ------
    FileNotFoundError
        If the file does not exist.
    ValueError
        If it is no complete image file or larger than ``max_pixels``.
    """
    data = _read_bytes(path, name)
    try:
        _check_complete(data, max_pixels)
        pixels = _decode(data)
        _check_size((pixels.shape[1], pixels.shape[0]), max_pixels)
    except ValueError as error:
        raise ValueError(f"{name} {path} {error}") from None
    return pixels


def _read_bytes(path: Path, name: str) -> bytes:
    """Content of a file that may be a picture; OpenCV's own reader fails on non-ASCII paths."""
    if not path.exists():
        raise FileNotFoundError(f"{name} {path} does not exist")
    if path.is_dir():
        raise ValueError(f"{name} {path} is a folder, expected an image file")
    if path.suffix.lower() in _RAW_FILES:
        raise ValueError(f"{name} {path} is {_RAW_FILES[path.suffix.lower()]}")
    try:
        with path.open("rb") as file:
            start = file.read(16)
            if not start:
                raise ValueError(f"{name} {path} is empty, expected an image file")
            is_video = start.startswith(b"RIFF") and start[8:12] != b"WEBP"
            if is_video or not start.startswith(_SIGNATURES):  # before its gigabytes are read
                raise ValueError(f"{name} {path} is not a JPEG, PNG, TIFF, WebP or BMP image")
            return start + file.read()
    except OSError as error:
        raise ValueError(f"{name} {path} cannot be read: {error.strerror}") from None


def _check_complete(data: bytes, max_pixels: int) -> None:
    """Refuse oversized, cut and damaged files: OpenCV decodes some in part, others noisily."""
    if data.startswith(_PNG_SIGNATURE):
        size = _check_png(data)
    elif data.startswith(_JPEG_SIGNATURE):
        size = _check_jpeg(data)
    elif data.startswith(b"RIFF") and len(data) < 8 + int.from_bytes(data[4:8], "little"):
        raise ValueError("is a truncated WebP file; copy or export it again")
    else:
        return
    _check_size(size, max_pixels)


def _check_size(size: tuple[int, int], max_pixels: int) -> None:
    width, height = size
    if width * height > max_pixels:
        raise ValueError(
            f"has {width}x{height} = {width * height} pixels, more than the limit of {max_pixels};"
            " reduce it or raise max_pixels"
        )


def _png_chunks(data: bytes) -> Iterator[bytes]:
    """Type of each whole chunk, its checksum verified (PNG specification, 5.3)."""
    start = 8
    while start + 12 <= len(data):
        stop = start + 12 + int.from_bytes(data[start : start + 4], "big")
        if stop > len(data):
            return
        checked = memoryview(data)[start + 4 : stop - 4]
        if zlib.crc32(checked) != int.from_bytes(data[stop - 4 : stop], "big"):
            raise ValueError("is a damaged PNG file (wrong checksum); copy or export it again")
        yield bytes(checked[:4])
        start = stop


def _check_png(data: bytes) -> tuple[int, int]:
    """Width and height of a complete PNG file."""
    for kind in _png_chunks(data):
        if kind == b"IEND" and data[12:16] == b"IHDR":
            return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    raise ValueError("is a truncated PNG file; copy or export it again")


def _check_jpeg(data: bytes) -> tuple[int, int]:
    """Width and height of a complete JPEG file; bytes after its end marker are no concern.

    The segments are walked (ITU T.81, annex B): thumbnails inside them have end markers too, and
    phones and 360 cameras append videos and their own data after the end.
    """
    size = (0, 0)
    at = 2
    while marker := _JPEG_MARKER.search(data, at):
        kind, at = data[marker.start() + 1], marker.end()
        if kind == 0xD9:
            return size
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            height, width = data[at + 3 : at + 5], data[at + 5 : at + 7]
            size = (int.from_bytes(width, "big"), int.from_bytes(height, "big"))
        at += int.from_bytes(data[at : at + 2], "big")
    raise ValueError("is a truncated JPEG file; copy or export it again")


def _decode(data: bytes) -> NDArray[Any]:
    """Pixels as OpenCV orders them: BGR, or BGRA when some are transparent."""
    encoded = np.frombuffer(data, dtype=np.uint8)
    try:
        pixels = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if _may_have_alpha(data) else None
        if pixels is None or pixels.ndim != 3 or pixels.shape[2] != 4:
            # Unlike IMREAD_UNCHANGED this applies the orientation tag.
            pixels = cv2.imdecode(encoded, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error as error:
        if "CV_IO_MAX_IMAGE" in str(error):
            raise ValueError(
                "is larger than OpenCV decodes; reduce it or set OPENCV_IO_MAX_IMAGE_PIXELS"
            ) from None
        pixels = None
    if pixels is None:
        raise ValueError("is a damaged image file that OpenCV cannot decode; export it again")
    return pixels


def _may_have_alpha(data: bytes) -> bool:
    """Whether transparency is possible: by the header for PNG, never in JPEG."""
    if data.startswith(_PNG_SIGNATURE):  # colour type bit 4, or a transparent palette entry
        return bool(data[25] & 4) or b"tRNS" in _png_chunks(data)
    return not data.startswith(_JPEG_SIGNATURE)
