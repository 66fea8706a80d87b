# SPDX-License-Identifier: BSD-3-Clause
"""Which part of the sphere a video shows, by its metadata."""

import struct
from dataclasses import dataclass
from xml.etree import ElementTree

from epi360.cameras.gpano import PART_NAMES, PanoramaPart
from epi360.interop.video_boxes import SphereBoxes

NAMESPACE = "http://ns.google.com/videos/1.0/spherical/"
_PROJECTIONS = {  # AVSphericalProjection of FFmpeg
    0: "equirectangular", 1: "cubemap", 2: "equirectangular", 3: "half equirectangular",
    4: "rectilinear", 5: "fisheye", 6: "parametric immersive",
}  # fmt: skip
_MOST_DIGITS = 9  # of a number of pixels


@dataclass(frozen=True)
class VideoSphere:
    """What a video's metadata say; None where they do not say it.

    ``projection`` is "equirectangular" or the name of another; ``stereo`` is "mono" or how two
    eyes share a frame; ``part`` is the part of a panorama that is shown.
    """

    projection: str | None = None
    stereo: str | None = None
    part: PanoramaPart | None = None


def sphere_of_boxes(boxes: SphereBoxes, width: int, height: int) -> VideoSphere:
    """Sphere of an MP4 file's boxes: Spherical Video V2 counts before V1."""
    older = _sphere_of_xmp(boxes.xmp)
    if boxes.projection is None:
        return VideoSphere(older.projection, boxes.stereo or older.stereo, older.part)
    part = _part(boxes.cut_off, width, height)
    return VideoSphere(boxes.projection, boxes.stereo or older.stereo, part)


def sphere_of_side_data(spherical: bytes | None, width: int, height: int) -> VideoSphere:
    """Sphere of FFmpeg's ``AVSphericalMapping``, which containers without such boxes have."""
    if spherical is None or len(spherical) < 32:
        return VideoSphere()
    number, *_, left, top, right, bottom = struct.unpack("=i3i4I", spherical[:32])
    shares = (top / 2**32, bottom / 2**32, left / 2**32, right / 2**32)
    part = _part(shares, width, height) if number == 2 else None
    return VideoSphere(_PROJECTIONS.get(number, "unknown"), None, part)


def _sphere_of_xmp(xmp: bytes | None) -> VideoSphere:
    try:
        text = (xmp or b"").decode("utf-8-sig").strip("\0 \t\r\n")
        if "<!DOCTYPE" in text:  # its entities could make a small packet expand without end
            return VideoSphere()
        root = ElementTree.fromstring(text)
    except (UnicodeDecodeError, ElementTree.ParseError):
        return VideoSphere()
    values = {
        name.partition("}")[2]: value.strip()
        for element in root.iter()
        for name, value in ((element.tag, element.text or ""), *element.items())
        if name.startswith(f"{{{NAMESPACE}}}")
    }
    if values.get("Spherical", "").lower() != "true":
        return VideoSphere()
    sizes = [values.get(name, "") for name in PART_NAMES]
    numbers = [int(size) for size in sizes if size.isdecimal() and len(size) <= _MOST_DIGITS]
    part = PanoramaPart(*numbers) if len(numbers) == len(PART_NAMES) else None
    projection = values.get("ProjectionType", "equirectangular").lower()
    return VideoSphere(projection, values.get("StereoMode", "").lower() or None, part)


def _part(
    cut_off: tuple[float, float, float, float], width: int, height: int
) -> PanoramaPart | None:
    top, bottom, left, right = cut_off
    if not any(cut_off) or left + right >= 1 or top + bottom >= 1:
        return None
    full_width, full_height = round(width / (1 - left - right)), round(height / (1 - top - bottom))
    return PanoramaPart(
        width, height, round(left * full_width), round(top * full_height), full_width, full_height
    )
