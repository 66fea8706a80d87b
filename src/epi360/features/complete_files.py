# SPDX-License-Identifier: BSD-3-Clause
"""Whether a picture's file is complete: OpenCV decodes cut and damaged files in part.

PNG and deflated TIFF have checksums. The others must have as much data as their pixels need, and no
more; where damage leaves both as they were, nothing tells. Uncompressed files are as long as they
say. `jpeg_files` does the same for JPEG.
"""

import io
from collections.abc import Sequence

from PIL.PngImagePlugin import PngImageFile
from PIL.WebPImagePlugin import WebPImageFile

from epi360.features.image_headers import PNG_SIGNATURE, TIFF_SIGNATURES
from epi360.features.tiff_files import check_tiff

_PNG_END = b"IEND\xaeB`\x82"
_VP8_KINDS = (b"VP8 ", b"VP8L")
# An encoder pads what it writes by two bytes at most, and a decoder looks seven ahead.
_WEBP_SLACK = 16
_SHORTEST_WEBP = 1024  # bytes; of one colour, pictures may need none of their data


def check_complete(data: bytes) -> None:
    """Raise ``ValueError`` for a PNG, TIFF or WebP file that is cut or damaged."""
    if data.startswith(PNG_SIGNATURE):
        _check_png(data)
    elif data.startswith(TIFF_SIGNATURES):
        check_tiff(data)
    elif data.startswith(b"RIFF"):
        _check_webp(data)


def _check_png(data: bytes) -> None:
    try:
        PngImageFile(io.BytesIO(data)).verify()
    except Exception as error:  # what a damaged file makes Pillow raise is not documented
        if "bad header checksum" in str(error):
            raise ValueError(
                "is a damaged PNG file (wrong checksum); copy or export it again"
            ) from None
        raise ValueError("is a truncated PNG file; copy or export it again") from None
    if _PNG_END not in data:  # libpng would complain of its checksum, and Pillow does not look
        raise ValueError("is a damaged PNG file (wrong checksum); copy or export it again")


def _check_webp(data: bytes) -> None:
    """Raise where the pixels of a WebP file have more data than they need; decoding says less."""
    end = 8 + int.from_bytes(data[4:8], "little")
    if len(data) < end:
        raise ValueError("is a truncated WebP file; copy or export it again")
    chunks = [chunk for chunk in _riff_chunks(data[:end]) if chunk[0] in _VP8_KINDS]
    if len(chunks) != 1 or len(chunks[0][1]) < _SHORTEST_WEBP:
        return
    kind, coded = chunks[0]
    # libwebp does not say how much it used. Without the last bytes it must miss some.
    chunk = kind + (len(coded) - _WEBP_SLACK).to_bytes(4, "little") + coded[:-_WEBP_SLACK]
    chunk += b"\0" * (len(chunk) % 2)
    try:
        shortened = WebPImageFile(
            io.BytesIO(b"RIFF" + (4 + len(chunk)).to_bytes(4, "little") + b"WEBP" + chunk)
        )
        shortened.load()
    except Exception:  # as above
        return
    raise ValueError("is a damaged WebP file; copy or export it again")


def _riff_chunks(data: bytes) -> Sequence[tuple[bytes, bytes]]:
    chunks, at = [], 12
    while at + 8 <= len(data):
        length = int.from_bytes(data[at + 4 : at + 8], "little")
        chunks.append((data[at : at + 4], data[at + 8 : at + 8 + length]))
        at += 8 + length + length % 2
    return chunks
