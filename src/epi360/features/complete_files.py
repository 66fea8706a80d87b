# SPDX-License-Identifier: BSD-3-Clause
"""Whether a picture's file is complete: OpenCV decodes cut and damaged files in part.

PNG has checksums. A sequential JPEG must have as much data as its pixels need, and no more; where
damage leaves both as they were, or the JPEG is progressive, nothing tells. WebP and uncompressed
files are as long as they say.
"""

import io
import re
from collections.abc import Sequence
from typing import NamedTuple

from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import TiffImageFile

from epi360.features.image_headers import JPEG_SIGNATURE, PNG_SIGNATURE, TIFF_SIGNATURES

# The next marker inside JPEG scan data: FF 00 is a stuffed byte, FF D0..D7 restart, FF FF filling.
_JPEG_MARKER = re.compile(rb"\xff([^\x00\xd0-\xd7\xff])")
_START_OF_SCAN, _END_OF_JPEG = 0xDA, 0xD9
_SEQUENTIAL = (0xC0, 0xC1)
# What may follow a scan: tables, another scan, a number of lines, comments, applications' data.
_AFTER_SCAN = {0xC4, 0xDA, 0xDB, 0xDC, 0xDD, 0xFE, *range(0xE0, 0xF0)}
_FILLING = {0x00, 0xFF}  # some encoders write it before the end
_SLACK = 16  # bytes; a decoder may look some ahead


def check_complete(data: bytes) -> None:
    """Raise ``ValueError`` for the file of a picture that is cut or damaged."""
    if data.startswith(PNG_SIGNATURE):
        _check_png(data)
    elif data.startswith(JPEG_SIGNATURE):
        _check_jpeg(data)
    elif data.startswith(TIFF_SIGNATURES):
        _check_tiff(data)
    elif data.startswith(b"RIFF") and len(data) < 8 + int.from_bytes(data[4:8], "little"):
        raise ValueError("is a truncated WebP file; copy or export it again")


def _check_png(data: bytes) -> None:
    try:
        PngImageFile(io.BytesIO(data)).verify()
    except Exception as error:  # what a damaged file makes Pillow raise is not documented
        if "bad header checksum" in str(error):
            raise ValueError(
                "is a damaged PNG file (wrong checksum); copy or export it again"
            ) from None
        raise ValueError("is a truncated PNG file; copy or export it again") from None


class _Marker(NamedTuple):
    kind: int
    place: int


def _check_jpeg(data: bytes) -> None:
    """Walk the segments of a JPEG file to its end (ITU T.81, annex B), then count its data."""
    # Thumbnails inside the segments have end markers too, and phones and 360 cameras append videos
    # and their own data after the end.
    markers: list[_Marker] = []
    at = 2
    while found := _JPEG_MARKER.search(data, at):
        markers.append(_Marker(found[1][0], found.start()))
        if markers[-1].kind == _END_OF_JPEG:
            break
        at = found.end() + int.from_bytes(data[found.end() : found.end() + 2], "big")
    else:
        raise ValueError("is a truncated JPEG file; copy or export it again")
    if not _scans_are_plausible([marker.kind for marker in markers]):
        raise ValueError("is a damaged JPEG file; copy or export it again")
    if [marker.kind for marker in markers[-2:]] == [_START_OF_SCAN, _END_OF_JPEG]:
        if any(marker.kind in _SEQUENTIAL for marker in markers):
            _check_amount(data, markers[-1].place)


def _scans_are_plausible(kinds: Sequence[int]) -> bool:
    if _START_OF_SCAN not in kinds:
        return True  # decoding says what is wrong
    return _AFTER_SCAN.issuperset(kinds[kinds.index(_START_OF_SCAN) : -1])


def _check_amount(data: bytes, end: int) -> None:
    """Raise where the one scan of a JPEG has less data than its pixels need, or more."""
    # libjpeg makes pixels up where data are missing, and says so only to the terminal. As long as
    # there is no end marker, it waits for more instead. An eighth as large, this takes a third of
    # the time of decoding.
    try:
        image = JpegImageFile(io.BytesIO(data))
        image.draft("L", (1, 1))
        image.load_prepare()
        codec, box, _, arguments = image.tile[0]
        decoder = Image._getdecoder(image.mode, codec, arguments, image.decoderconfig)
        decoder.setimage(image.im, box)
        most = max(end - _SLACK, 0)
        used, error = decoder.decode(data[:most])
        is_fine = error == 0 and _FILLING.issuperset(data[most:end])
        if used >= 0:
            used, error = decoder.decode(data[used:end] + bytes(_SLACK))
            is_fine = used < 0
        decoder.cleanup()
    except Exception:  # what damaged headers make Pillow raise is not documented
        return  # OpenCV's decoder says what is wrong
    if not is_fine:
        raise ValueError("is a damaged JPEG file; copy or export it again")


def _check_tiff(data: bytes) -> None:
    """Decompress a TIFF file; OpenCV goes on behind damage as if nothing were."""
    try:
        image = TiffImageFile(io.BytesIO(data))
        if image.info.get("compression", "raw") == "raw":
            return
    except Exception:  # Pillow does not know all kinds that OpenCV reads
        return
    try:
        image.load()
    except OSError as error:
        if "decoder error" in str(error):
            raise ValueError("is a damaged TIFF file; copy or export it again") from None
    except Exception:  # as above
        return
