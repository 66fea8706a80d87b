# SPDX-License-Identifier: BSD-3-Clause
"""Whether an uploaded file is a picture of a size that the demo takes, before it is decoded."""

import struct
from pathlib import Path

from epi360.features.image_files import check_image_start
from epi360.features.image_headers import parse_image_header
from epi360_demo.limits import RefusedError, as_sentence, megapixels


def check_picture(path: Path, name: str, max_pixels: int) -> None:
    """Raise `RefusedError` for a file that is no picture, is raw, or has more pixels than allowed.

    Only its header is read. Where a header does not say the size, the decoder checks it: see
    `epi360_demo.worker`.
    """
    try:
        check_image_start(path, "picture")
    except ValueError as error:
        raise RefusedError(named(str(error), "picture", path, name)) from None
    with path.open("rb", buffering=0) as file:
        size = parse_image_header(file).size
        if size is None:
            file.seek(0)
            size = _declared_size(file.read(32))
    if size is not None and size[0] * size[1] > max_pixels:
        raise RefusedError(
            f"{name} has {size[0]}x{size[1]} pixels, which are {megapixels(size[0] * size[1])}; "
            f"this demo takes {megapixels(max_pixels)} at most, so reduce the picture first."
        )


def named(message: str, role: str, path: Path, name: str) -> str:
    """Return a message of the library as a sentence that calls a file as the visitor does."""
    return as_sentence(message.replace(f"{role} {path}", name).replace(str(path), name))


def _declared_size(start: bytes) -> tuple[int, int] | None:
    """Return the size that the first 32 bytes of a WebP or BMP file state."""
    if start[:2] == b"BM" and len(start) >= 26:
        if struct.unpack("<I", start[14:18])[0] == 12:  # the header of OS/2
            width, height = struct.unpack("<HH", start[18:22])
        else:
            width, height = map(abs, struct.unpack("<ii", start[18:26]))
        return width, height
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP" and len(start) >= 30:
        return _webp_size(start)
    return None


def _webp_size(start: bytes) -> tuple[int, int] | None:
    if start[12:16] == b"VP8X":
        width, height = (int.from_bytes(start[k : k + 3], "little") + 1 for k in (24, 27))
        return width, height
    if start[12:16] == b"VP8L":
        bits = int.from_bytes(start[21:25], "little")
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if start[12:16] == b"VP8 ":
        width, height = struct.unpack("<HH", start[26:30])
        return width & 0x3FFF, height & 0x3FFF
    return None
