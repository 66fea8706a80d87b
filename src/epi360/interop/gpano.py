# SPDX-License-Identifier: BSD-3-Clause
"""GPano metadata: which part of a panorama an image is, and how its camera was held.

Source: Google, Photo Sphere XMP Metadata, https://developers.google.com/streetview/spherical-metadata.
"""

from __future__ import annotations

import io
import math
import os
import struct
import zlib
from dataclasses import astuple, dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Equirectangular
from epi360.features.image_headers import (
    XMP_IN_JPEG,
    XMP_IN_PNG,
    parse_image_header,
    read_image_header,
)

NAMESPACE = "http://ns.google.com/photos/1.0/panorama/"
SHAPE_TOLERANCE = 0.005  # a resized file rounds its sides; as `Equirectangular.for_image`


@dataclass(frozen=True)
class PanoramaPart:
    """Part of a panorama that an image shows, in pixels of the whole.

    Attributes
    ----------
    width, height : int
        Of the part.
    left, top : int
        Column and row of the whole where the part begins.
    full_width, full_height : int
        Of the whole.
    """

    width: int
    height: int
    left: int
    top: int
    full_width: int
    full_height: int


_PART_NAMES = (  # in the order of the fields
    "CroppedAreaImageWidthPixels",
    "CroppedAreaImageHeightPixels",
    "CroppedAreaLeftPixels",
    "CroppedAreaTopPixels",
    "FullPanoWidthPixels",
    "FullPanoHeightPixels",
)


@dataclass(frozen=True)
class GPano:
    """GPano metadata of an image.

    The angles are those of the whole panorama, whichever part of it the image shows: cropping does
    not change them. Where a number is missing or none, it is None.

    Attributes
    ----------
    projection : str
        "equirectangular" where the file does not say.
    part : PanoramaPart or None
        None: the file does not say, or not all of it.
    heading_deg : float or None
        Compass heading of the centre, clockwise from north.
    pitch_deg : float or None
        Of the centre above the horizon: with 10, the horizon runs below the centre.
    roll_deg : float or None
        Clockwise turn of the camera: with 10 its right side hangs down, and the horizon is turned
        counter-clockwise in the picture.
    """

    projection: str = "equirectangular"
    part: PanoramaPart | None = None
    heading_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None

    @property
    def down(self) -> NDArray[np.float64] | None:
        """Unit direction of gravity in the camera frame, shape (3,).

        None where the file has neither pitch nor roll; one of them alone makes the other 0. Many
        programs write 0 for both without knowing.
        """
        if self.pitch_deg is None and self.roll_deg is None:
            return None
        # The camera is turned by heading, pitch and roll, each about its axes after the one before.
        pitch, roll = math.radians(self.pitch_deg or 0.0), math.radians(self.roll_deg or 0.0)
        level = math.cos(pitch)
        return np.array([level * math.sin(roll), level * math.cos(roll), -math.sin(pitch)])

    def camera(self, width: int, height: int) -> Equirectangular:
        """Camera of the image.

        Parameters
        ----------
        width, height : int
            Size of the image; a resized part still shows the same angles.

        Returns
        -------
        camera : Equirectangular
            Of the whole panorama where the file does not say, or where the image is 2:1 and has
            not the shape of the part: somebody filled the rest in and left the metadata.

        Raises
        ------
        ValueError
            If the projection is another, the part lies outside the whole, the whole is not 2:1, or
            the image has another shape than its part.
        """
        if self.projection.lower() != "equirectangular":
            raise ValueError(
                f"GPano metadata must say projection equirectangular, got {self.projection!r:.40}; "
                "give a camera file"
            )
        part = self.part
        if part is None:
            return Equirectangular.for_image(width, height)
        _check_part(part)
        expected_height = width * part.height / part.width
        if abs(height - expected_height) > max(1.0, SHAPE_TOLERANCE * expected_height):
            try:
                return Equirectangular.for_image(width, height)
            except ValueError:
                raise ValueError(
                    f"the image is {width}x{height} but its GPano metadata say {part.width}x"
                    f"{part.height}, another shape; correct or remove them, or give a camera file"
                ) from None
        return Equirectangular(
            width,
            height,
            horizontal_fov_deg=360 * part.width / part.full_width,
            vertical_fov_deg=180 * part.height / part.full_height,
            center_longitude_deg=360 * ((part.left + part.width / 2) / part.full_width - 0.5),
            center_latitude_deg=180 * (0.5 - (part.top + part.height / 2) / part.full_height),
        )


def _check_part(part: PanoramaPart) -> None:
    inside = (
        0 <= part.left < part.left + part.width <= part.full_width
        and 0 <= part.top < part.top + part.height <= part.full_height
    )
    if not inside:
        raise ValueError(
            f"GPano metadata must describe a part inside the panorama, got {part.width}x"
            f"{part.height} at {part.left},{part.top} of {part.full_width}x{part.full_height}; "
            "correct or remove them, or give a camera file"
        )
    Equirectangular.for_image(part.full_width, part.full_height)


def read_gpano(path: str | os.PathLike[str]) -> GPano | None:
    """GPano metadata of a JPEG, PNG or TIFF file.

    Parameters
    ----------
    path : path-like
        Only its header is read.

    Returns
    -------
    gpano : GPano or None
        None where the file has none, or a packet that cannot be read.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    return parse_gpano(read_image_header(path).xmp)


def parse_gpano(xmp: bytes | None) -> GPano | None:
    """GPano metadata of an XMP packet.

    Parameters
    ----------
    xmp : bytes or None
        The packet.

    Returns
    -------
    gpano : GPano or None
        None where it has none or cannot be read.
    """
    try:
        text = (xmp or b"").decode("utf-8-sig").strip("\0 \t\r\n")
        if "<!DOCTYPE" in text:  # its entities could make a small packet expand without end
            return None
        root = ElementTree.fromstring(text)
    except (UnicodeDecodeError, ElementTree.ParseError):
        return None
    values: dict[str, str] = {}
    for element in root.iter():  # properties are attributes or elements, as the writer likes
        for name, value in ((element.tag, element.text or ""), *element.items()):
            if name.startswith(f"{{{NAMESPACE}}}"):
                values.setdefault(name.partition("}")[2], value.strip())
    return _gpano(values) if values else None


def _gpano(values: dict[str, str]) -> GPano:
    numbers = [_number(values.get(name)) for name in _PART_NAMES]
    integers = [int(number) for number in numbers if number is not None and number.is_integer()]
    return GPano(
        projection=values.get("ProjectionType") or "equirectangular",
        part=PanoramaPart(*integers) if len(integers) == len(_PART_NAMES) else None,
        heading_deg=_number(values.get("PoseHeadingDegrees")),
        pitch_deg=_number(values.get("PosePitchDegrees")),
        roll_deg=_number(values.get("PoseRollDegrees")),
    )


def _number(text: str | None) -> float | None:
    try:
        number = float(text or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def gpano_packet(
    camera: Equirectangular,
    *,
    heading_deg: float | None = None,
    pitch_deg: float | None = None,
    roll_deg: float | None = None,
) -> bytes:
    """XMP packet with the GPano metadata of a panorama or a part of one.

    Parameters
    ----------
    camera : Equirectangular
        Of the image.
    heading_deg, pitch_deg, roll_deg : float, optional
        How it was held, see `GPano`; left out where None.

    Returns
    -------
    packet : bytes
        For `with_gpano`. Its numbers are whole pixels: the camera that it describes is off by up to
        half a pixel where this one's borders are not.

    Raises
    ------
    ValueError
        If the camera does not lie inside the whole panorama: it crosses the seam.
    """
    part = _part_of(camera)
    _check_part(part)
    angles = {
        "PoseHeadingDegrees": heading_deg,
        "PosePitchDegrees": pitch_deg,
        "PoseRollDegrees": roll_deg,
    }
    properties = {
        "ProjectionType": "equirectangular",
        **dict(zip(_PART_NAMES, astuple(part), strict=True)),
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
    """Content of an image file with an XMP packet in it.

    Parameters
    ----------
    image : bytes
        Content of a JPEG or PNG file without XMP.
    packet : bytes
        Of `gpano_packet`.

    Returns
    -------
    image : bytes
        The same picture, to be written to a file.

    Raises
    ------
    ValueError
        If the image is no JPEG or PNG, or has an XMP packet already.
    """
    if parse_image_header(io.BytesIO(image)).xmp is not None:
        raise ValueError("the image must have no XMP packet yet, but it has one; export it without")
    if image.startswith(b"\xff\xd8\xff"):
        at = 4 + int.from_bytes(image[4:6], "big") if image[3] == 0xE0 else 2  # behind JFIF's
        data = XMP_IN_JPEG + packet
        chunk = b"\xff\xe1" + struct.pack(">H", len(data) + 2) + data
    elif image.startswith(b"\x89PNG\r\n\x1a\n"):
        at = 33  # behind IHDR, which has 25 bytes
        data = b"iTXt" + XMP_IN_PNG + b"\0\0\0\0" + packet
        chunk = struct.pack(">I", len(data) - 4) + data + struct.pack(">I", zlib.crc32(data))
    else:
        raise ValueError("the image must be the content of a JPEG or PNG file")
    return image[:at] + chunk + image[at:]
