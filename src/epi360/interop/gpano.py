# SPDX-License-Identifier: BSD-3-Clause
"""GPano metadata in image files; what they mean for a camera is in `epi360.cameras.gpano`."""

import io
import struct
import zlib
from dataclasses import astuple

from epi360.cameras import Equirectangular
from epi360.cameras.gpano import NAMESPACE, PART_NAMES, GPano, PanoramaPart, parse_gpano
from epi360.features.image_headers import (
    JPEG_SIGNATURE,
    PNG_SIGNATURE,
    parse_image_header,
    read_image_header,
)
from epi360.runs.whole_files import PathLike

__all__ = ["GPano", "PanoramaPart", "gpano_packet", "parse_gpano", "read_gpano", "with_gpano"]

# Adobe, XMP Specification Part 3
_XMP_IN_JPEG = b"http://ns.adobe.com/xap/1.0/\0"
_XMP_IN_PNG = b"XML:com.adobe.xmp\0"


def read_gpano(path: PathLike) -> GPano | None:
    """GPano metadata of a JPEG, PNG or TIFF file, of which only the header is read.

    None if the file has none, or an XMP packet that cannot be read. ``OSError`` if the file
    cannot be read.
    """
    return parse_gpano(read_image_header(path).xmp)


def gpano_packet(
    camera: Equirectangular,
    *,
    heading_deg: float | None = None,
    pitch_deg: float | None = None,
    roll_deg: float | None = None,
) -> bytes:
    """XMP packet with the GPano metadata of a panorama or a part of one, for `with_gpano`.

    It states whole pixels: if the borders of this camera lie between pixels, the camera that it
    describes is off by up to half a pixel. The angles say how the camera was held, see `GPano`;
    None is not written.

    Raises
    ------
    ValueError
        If the part crosses the seam of the whole panorama.
    """
    part = _part_of(camera)
    part.check()
    angles = {
        "PoseHeadingDegrees": heading_deg,
        "PosePitchDegrees": pitch_deg,
        "PoseRollDegrees": roll_deg,
    }
    properties = {
        "ProjectionType": "equirectangular",
        **dict(zip(PART_NAMES, astuple(part), strict=True)),
        **{name: float(angle) for name, angle in angles.items() if angle is not None},
    }
    written = " ".join(f'GPano:{name}="{value}"' for name, value in properties.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'
        '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        f'<rdf:Description rdf:about="" xmlns:GPano="{NAMESPACE}" {written}/>'
        '</rdf:RDF></x:xmpmeta><?xpacket end="w"?>'
    ).encode()


def _part_of(camera: Equirectangular) -> PanoramaPart:
    full_width = round(360 * camera.width / camera.horizontal_fov_deg)
    full_height = round(180 * camera.height / camera.vertical_fov_deg)
    centre_column = full_width * (camera.center_longitude_deg / 360 + 0.5)
    centre_row = full_height * (0.5 - camera.center_latitude_deg / 180)
    return PanoramaPart(
        width=camera.width,
        height=camera.height,
        left=round(centre_column - camera.width / 2),
        top=round(centre_row - camera.height / 2),
        full_width=full_width,
        full_height=full_height,
    )


def with_gpano(image: bytes, packet: bytes) -> bytes:
    """Content of an image file, JPEG or PNG, with a packet of `gpano_packet` in it.

    Raises
    ------
    ValueError
        If the image is no JPEG or PNG, or has an XMP packet already.
    """
    if parse_image_header(io.BytesIO(image)).xmp is not None:
        raise ValueError("the image must have no XMP packet yet, but it has one; export it without")
    if image.startswith(JPEG_SIGNATURE):
        at = 4 + int.from_bytes(image[4:6], "big") if image[3] == 0xE0 else 2  # behind JFIF's
        data = _XMP_IN_JPEG + packet
        chunk = b"\xff\xe1" + struct.pack(">H", len(data) + 2) + data
    elif image.startswith(PNG_SIGNATURE):
        at = 33  # behind IHDR, which has 25 bytes
        data = b"iTXt" + _XMP_IN_PNG + b"\0\0\0\0" + packet
        chunk = struct.pack(">I", len(data) - 4) + data + struct.pack(">I", zlib.crc32(data))
    else:
        raise ValueError("the image must be the content of a JPEG or PNG file")
    return image[:at] + chunk + image[at:]
