# SPDX-License-Identifier: BSD-3-Clause
"""Image files to pixels, refusing what OpenCV would decode in part, noisily or without a limit."""

import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.features.complete_files import check_complete
from epi360.features.image_headers import (
    JPEG_SIGNATURE,
    PNG_SIGNATURE,
    TIFF_SIGNATURES,
    parse_image_header,
)
from epi360.features.jpeg_files import check_jpeg, decode_jpeg, read_jpeg_header
from epi360.runs.input_files import check_is_file

MAX_PIXELS = 2**28
"""23170 x 11585: larger than any camera; 0.8 GB once decoded."""

_SIGNATURES = (JPEG_SIGNATURE, PNG_SIGNATURE, *TIFF_SIGNATURES, b"RIFF", b"BM")
_RAW_FILES = {
    ".insp": "a raw dual fisheye file; export a stitched panorama first",
    ".insv": "a raw dual fisheye video; export stitched panoramas first",
    ".360": "a raw 360 video; export stitched panoramas first",
    ".dng": "a camera raw file; export a JPEG, PNG or TIFF first",
}


def decode_image_file(path: Path, max_pixels: int, name: str) -> NDArray[Any]:
    """Pixels of a complete file, (H, W, 3) BGR or (H, W, 4) BGRA of the file's own type.

    They are upright, but for WebP with transparency. The errors are those of `read_image`.
    """
    data = _read_bytes(path, name)
    try:
        header = parse_image_header(io.BytesIO(data))
        _check_size(header.size, max_pixels)
        if data.startswith(JPEG_SIGNATURE):
            pixels = _decoded_jpeg(data, header.orientation, max_pixels)
        else:
            check_complete(data)
            pixels = _decoded(data, header.may_have_alpha)
            if data.startswith(PNG_SIGNATURE):
                pixels = _turned(pixels, header.orientation)
        _check_size((pixels.shape[1], pixels.shape[0]), max_pixels)
    except ValueError as error:
        raise ValueError(f"{name} {path} {error}") from None
    return pixels


def check_image_start(path: Path, name: str) -> None:
    """Raise for a file that is raw, or whose first bytes are those of no picture.

    The errors are those of `read_image`.
    """
    if not path.exists():
        raise FileNotFoundError(f"{name} {path} does not exist")
    if path.is_dir():
        raise ValueError(f"{name} {path} is a folder, expected an image file")
    check_is_file(path)
    if path.suffix.lower() in _RAW_FILES:
        raise ValueError(f"{name} {path} is {_RAW_FILES[path.suffix.lower()]}")
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError as error:
        raise ValueError(f"{name} {path} cannot be read: {error.strerror}") from None
    if not start:
        raise ValueError(f"{name} {path} is empty, expected an image file")
    is_video = start.startswith(b"RIFF") and start[8:12] != b"WEBP"
    if is_video or not start.startswith(_SIGNATURES):
        raise ValueError(f"{name} {path} is not a JPEG, PNG, TIFF, WebP or BMP image")


def _read_bytes(path: Path, name: str) -> bytes:
    """Content of a file that may be a picture; OpenCV's own reader fails on non-ASCII paths."""
    check_image_start(path, name)  # before its gigabytes are read
    try:
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{name} {path} cannot be read: {error.strerror}") from None


def _check_size(size: tuple[int, int] | None, max_pixels: int) -> None:
    width, height = size or (0, 0)
    if width * height > max_pixels:
        raise ValueError(
            f"has {width}x{height} = {width * height} pixels, more than the limit of {max_pixels};"
            " reduce it or raise max_pixels"
        )


def _decoded_jpeg(data: bytes, orientation: int, max_pixels: int) -> NDArray[Any]:
    """Pixels BGR, upright."""
    header = read_jpeg_header(data)
    _check_size(header.size, max_pixels)
    if header.has_inks:
        check_jpeg(data)
        return _decoded(data, may_have_alpha=False)
    return _turned(decode_jpeg(data), orientation)


def _turned(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Pixels as an orientation tag (Exif) wants them shown."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.transpose(1, 0, 2)
    mirrored_rows, mirrored_columns = orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7)
    pixels = pixels[:: -1 if mirrored_rows else 1, :: -1 if mirrored_columns else 1]
    return np.ascontiguousarray(pixels)


def _decoded(data: bytes, may_have_alpha: bool) -> NDArray[Any]:
    """Pixels as OpenCV orders them: BGR, or BGRA when some are transparent; PNG not yet turned."""
    # Unlike IMREAD_UNCHANGED this applies the orientation tag, to PNG in some versions only.
    opaque = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
    if data.startswith(PNG_SIGNATURE):
        opaque |= cv2.IMREAD_IGNORE_ORIENTATION
    encoded = np.frombuffer(data, dtype=np.uint8)
    try:
        pixels = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if may_have_alpha else None
        if pixels is None or pixels.ndim != 3 or pixels.shape[2] != 4:
            pixels = cv2.imdecode(encoded, opaque)
    except cv2.error as error:
        if "CV_IO_MAX_IMAGE" in str(error):
            raise ValueError(
                "is larger than OpenCV decodes; reduce it or set OPENCV_IO_MAX_IMAGE_PIXELS"
            ) from None
        pixels = None
    if pixels is None:
        raise ValueError("is a damaged image file that OpenCV cannot decode; export it again")
    return pixels
