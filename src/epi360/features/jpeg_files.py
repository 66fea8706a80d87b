# SPDX-License-Identifier: BSD-3-Clause
"""JPEG files to pixels, refusing those that are cut or damaged.

Where data are missing, libjpeg makes pixels up and only warns. OpenCV prints these warnings, Pillow
drops them, and simplejpeg hands them on. Damage that leaves data as legal as they were, and as
many, is noticed by nobody.
"""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import simplejpeg
from numpy.typing import NDArray

# The next marker inside JPEG scan data: FF 00 is a stuffed byte, FF D0..D7 restart, FF FF filling.
_MARKER = re.compile(rb"\xff([^\x00\xd0-\xd7\xff])")
_START_OF_SCAN, _END = 0xDA, 0xD9
_SEQUENTIAL, _PROGRESSIVE = (0xC0, 0xC1), 0xC2
_MOST_SCANS = 100  # encoders write 10; a small file with thousands of them would take hours
# Cameras pad segments, and the scan. libjpeg's words for both, as far as no scan has begun.
_STRAY_BYTES = re.compile(r"extraneous bytes before marker 0x(d9|c[0-24]|d[bad]|e|fe)")
_FILLING = b"\x00\xff"
_HARMLESS = re.compile("JFIF revision|Adobe color transform|SOS parameters")
_DAMAGED = "is a damaged JPEG file; copy or export it again"
_TRUNCATED = "is a truncated JPEG file; copy or export it again"


class JpegHeader(NamedTuple):
    """Size (width, height) and libjpeg's name of the colours, such as YCbCr or CMYK."""

    size: tuple[int, int]
    colors: str

    @property
    def has_inks(self) -> bool:
        """Whether the colours are those of printing."""
        return self.colors in ("CMYK", "YCCK")


def read_jpeg_header(data: bytes) -> JpegHeader:
    """Header of a JPEG file; ``ValueError`` if it is cut or damaged."""
    try:
        height, width, colors, _ = simplejpeg.decode_jpeg_header(data, strict=False)
    except (ValueError, KeyError):  # KeyError: it tells neither size nor colours
        _segments(data)
        raise ValueError(_DAMAGED) from None
    return JpegHeader((width, height), colors)


def decode_jpeg(data: bytes) -> NDArray[Any]:
    """Pixels (H, W, 3) BGR, not turned by the orientation; ``ValueError`` if not all are there."""
    _check_scans(data)
    return _decoded(data, "BGR", 1)


def check_jpeg(data: bytes) -> None:
    """Raise ``ValueError`` for a JPEG file that is cut or damaged."""
    _check_scans(data)
    header = read_jpeg_header(data)
    colors = {"Gray": "GRAY", "YCbCr": "GRAY", "RGB": "BGR"}
    _decoded(data, "CMYK" if header.has_inks else colors.get(header.colors, "BGR"), 8)


def _decoded(data: bytes, colors: str, reduction: int) -> NDArray[Any]:
    try:
        return np.asarray(simplejpeg.decode_jpeg(data, colors, min_factor=reduction))
    except ValueError as error:
        reason = str(error)
    if _HARMLESS.search(reason):
        return np.asarray(simplejpeg.decode_jpeg(data, colors, min_factor=reduction, strict=False))
    for clean in _without_stray_bytes(data) if _STRAY_BYTES.search(reason) else ():
        try:
            return np.asarray(simplejpeg.decode_jpeg(clean, colors, min_factor=reduction))
        except ValueError:
            continue
    raise ValueError(_TRUNCATED if "Premature end of JPEG file" in reason else _DAMAGED)


class _Segment(NamedTuple):
    kind: int
    start: int
    end: int  # of its own length, without the data of a scan


def _segments(data: bytes) -> list[_Segment]:
    """Segments of a JPEG file up to its end marker (ITU T.81, annex B)."""
    # Thumbnails inside the segments have end markers too, and phones and 360 cameras append videos
    # and their own data after the end.
    segments: list[_Segment] = []
    at = 2
    while found := _MARKER.search(data, at):
        kind, start, end = found[1][0], found.start(), found.end()
        if kind == _END:
            return [*segments, _Segment(kind, start, end)]
        at = end + int.from_bytes(data[end : end + 2], "big")
        segments.append(_Segment(kind, start, at))
    raise ValueError(_TRUNCATED)


def _check_scans(data: bytes) -> None:
    """Raise unless the scans hold all bits of all coefficients of all colours, each once sent."""
    segments = _segments(data)
    frames = [segment for segment in segments if segment.kind in (*_SEQUENTIAL, _PROGRESSIVE)]
    scans = [segment for segment in segments if segment.kind == _START_OF_SCAN]
    if len(scans) > _MOST_SCANS:
        raise ValueError(
            f"is a JPEG file of {len(scans)} scans, expected at most {_MOST_SCANS}; export it again"
        )
    if len(frames) != 1:
        return  # of another kind, or damaged; decoding says so
    header = data[frames[0].start + 4 : frames[0].end]
    missing = {number: np.ones(64, dtype=np.uint8) for number in header[6::3]}
    for scan in scans:
        words = data[scan.start + 4 : scan.end]
        first, last, bits = (words + b"\0" * 4)[1 + 2 * words[0] :][:3] if words else (0, 63, 0)
        if frames[0].kind in _SEQUENTIAL:  # some encoders write no more than a zero here
            first, last, bits = 0, 63, 0
        for number in words[1 : 1 + 2 * words[0] : 2] if words else b"":
            missing.get(number, np.ones(64))[first : last + 1] = bits & 15
    if any(bits.any() for bits in missing.values()):
        raise ValueError("is a JPEG file without some of its scans; copy or export it again")


def _without_stray_bytes(data: bytes) -> Iterator[bytes]:
    """The file without what stands between its segments, and without filling before its end."""
    *segments, end = _segments(data)
    scans = [segment.start for segment in segments if segment.kind == _START_OF_SCAN]
    if not scans:
        return
    header = b"".join(data[part.start : part.end] for part in segments if part.start < scans[0])
    coded = data[scans[0] : end.start]
    kept = len(coded.rstrip(_FILLING))
    # A scan may end with bytes like those of filling.
    for length in range(kept, min(kept + 4, len(coded)) + 1):
        yield data[:2] + header + coded[:length] + b"\xff\xd9"
