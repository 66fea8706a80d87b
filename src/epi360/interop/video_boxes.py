# SPDX-License-Identifier: BSD-3-Clause
"""What the boxes of an MP4 or MOV file say about its sphere, read without decoding anything.

Sources: ISO/IEC 14496-12; Google, Spherical Video V1 (an XMP packet in a ``uuid`` box of the track)
and V2 (``st3d`` and ``sv3d`` boxes in the sample entry),
https://github.com/google/spatial-media/tree/master/docs.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from epi360.features.image_headers import LARGEST_XMP

SPHERICAL_UUID = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")
# Boxes whose content is boxes, and how many bytes of their own they have before those.
_HOLD_BOXES = {
    b"moov": 0, b"trak": 0, b"mdia": 0, b"minf": 0, b"stbl": 0, b"stsd": 8, b"sv3d": 0, b"proj": 0,
    **dict.fromkeys((b"avc1", b"avc3", b"hvc1", b"hev1", b"av01", b"vp09", b"mp4v", b"apcn"), 78),
}  # fmt: skip
_LARGEST_SMALL_BOX = 64
_MOST_BOXES = 10_000  # of a damaged file; a film has about a hundred without its media
_DEEPEST_BOX = 16  # of a damaged file; the boxes that are read are nine deep at most
_STEREO = {0: "mono", 1: "top-bottom", 2: "left-right"}


@dataclass
class SphereBoxes:
    """What was found; None where the file does not say it."""

    has_media: bool = False
    has_index: bool = False
    xmp: bytes | None = None
    projection: str | None = None  # "equirectangular", "cubemap" or "mesh"
    stereo: str | None = None  # "mono", "top-bottom", "left-right"
    # Shares of the whole panorama that are cut off: top, bottom, left, right.
    cut_off: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def read_sphere_boxes(path: Path) -> SphereBoxes:
    """Boxes of any file; nothing is found in one that is no MP4. ``OSError`` if it is unreadable.

    Only headers of boxes and small boxes are read, so the size of the file does not matter.
    """
    found = SphereBoxes()
    with path.open("rb") as file:
        file.seek(0, 2)
        size = file.tell()
        file.seek(0)
        if size < 12 or file.read(8)[4:] not in (b"ftyp", b"moov", b"mdat", b"free", b"wide"):
            return found
        for count, (kind, start, end) in enumerate(_boxes(file, 0, size)):
            if count > _MOST_BOXES:
                break
            _note(found, kind, file, start, end)
    return found


def _boxes(
    file: IO[bytes], start: int, end: int, depth: int = 0
) -> Iterator[tuple[bytes, int, int]]:
    """Kind, start and end of the content of each box between two places, depth first."""
    while start + 8 <= end:
        file.seek(start)
        size, kind = struct.unpack(">I4s", file.read(8))
        content = start + 8
        if size == 1:  # the size follows in 64 bits
            wide = file.read(8)
            if len(wide) < 8:
                return
            size, content = int.from_bytes(wide, "big"), content + 8
        stop = end if size == 0 else min(start + size, end)
        if stop < content:
            return  # damaged
        if kind == b"moov" and start + size > end:
            return  # cut off: what is left of the index is of no use
        yield kind, content, stop
        if kind in _HOLD_BOXES and depth < _DEEPEST_BOX:
            yield from _boxes(file, content + _HOLD_BOXES[kind], stop, depth + 1)
        start = stop


def _note(found: SphereBoxes, kind: bytes, file: IO[bytes], start: int, end: int) -> None:
    if kind == b"mdat":
        found.has_media = True
    elif kind == b"moov":
        found.has_index = True
    elif kind == b"uuid" and 16 < end - start <= 16 + LARGEST_XMP:
        file.seek(start)
        if file.read(16) == SPHERICAL_UUID:
            found.xmp = file.read(end - start - 16)
    elif kind in (b"cbmp", b"mshp"):
        found.projection = "cubemap" if kind == b"cbmp" else "mesh"
    elif kind in (b"st3d", b"equi") and end - start <= _LARGEST_SMALL_BOX:
        file.seek(start + 4)  # behind version and flags
        content = file.read(end - start - 4)
        if kind == b"st3d" and content:
            found.stereo = _STEREO.get(content[0], "another form of stereo")
        elif kind == b"equi" and len(content) >= 16:
            found.projection = "equirectangular"
            top, bottom, left, right = (part / 2**32 for part in struct.unpack(">4I", content[:16]))
            found.cut_off = top, bottom, left, right
