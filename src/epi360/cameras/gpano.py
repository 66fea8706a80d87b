# SPDX-License-Identifier: BSD-3-Clause
"""GPano metadata: which part of a panorama an image is, and how its camera was held.

Source: Google, Photo Sphere XMP Metadata,
https://developers.google.com/streetview/spherical-metadata.
"""

import math
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from epi360.cameras.equirectangular import Equirectangular

NAMESPACE = "http://ns.google.com/photos/1.0/panorama/"
SHAPE_TOLERANCE = 0.005  # a resized file rounds its sides; as `Equirectangular.for_image`


@dataclass(frozen=True)
class PanoramaPart:
    """Part of a panorama that an image shows, in pixels of the whole panorama."""

    width: int
    height: int
    left: int
    top: int
    full_width: int
    full_height: int

    def check(self) -> None:
        """Raise ``ValueError`` if the part lies outside the whole, or the whole is not 2:1."""
        inside = (
            0 <= self.left < self.left + self.width <= self.full_width
            and 0 <= self.top < self.top + self.height <= self.full_height
        )
        if not inside:
            raise ValueError(
                f"GPano metadata must describe a part inside the panorama, got {self.width}x"
                f"{self.height} at {self.left},{self.top} of {self.full_width}x{self.full_height}; "
                "correct or remove them, or give a camera file"
            )
        Equirectangular.for_image(self.full_width, self.full_height)


PART_NAMES = (  # in the order of the fields
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

    The angles are those of the whole panorama: cropping it does not change them. What the file does
    not state, or states as no number, is None; so is a part without all of its six numbers. The
    heading is clockwise from north. With a pitch of 10 degrees the horizon runs below the centre of
    the image; with a roll of 10 the right side of the camera hangs down, and the horizon is turned
    counter-clockwise in the picture.
    """

    projection: str = "equirectangular"
    part: PanoramaPart | None = None
    heading_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None

    @property
    def down(self) -> NDArray[np.float64] | None:
        """Unit direction (3,) of gravity in the camera frame; None without pitch and roll.

        If the file has one of them, the other counts as 0. Many programs write 0 for both without
        knowing.
        """
        if self.pitch_deg is None and self.roll_deg is None:
            return None
        # The camera is turned by heading, pitch and roll, each about its axes after the one before.
        pitch, roll = math.radians(self.pitch_deg or 0.0), math.radians(self.roll_deg or 0.0)
        level = math.cos(pitch)
        return np.array([level * math.sin(roll), level * math.cos(roll), -math.sin(pitch)])

    def camera(self, width: int, height: int) -> Equirectangular:
        """Camera of the image, of its size in pixels; a resized part still shows the same angles.

        It is that of the part. It is that of a whole panorama if the file states no part, or if the
        image is 2:1 and the part has another shape: then somebody filled the rest in and left the
        metadata.

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
        part.check()
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


def panorama_camera(width: int, height: int, gpano: GPano | None) -> Equirectangular:
    """Camera of an image without a calibration: a part of a panorama if it says so, or a whole."""
    return (gpano or GPano()).camera(width, height)


def parse_gpano(xmp: bytes | None) -> GPano | None:
    """GPano metadata of an XMP packet; None if it has none or cannot be read."""
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
    numbers = [_number(values.get(name)) for name in PART_NAMES]
    integers = [int(number) for number in numbers if number is not None and number.is_integer()]
    return GPano(
        projection=values.get("ProjectionType") or "equirectangular",
        part=PanoramaPart(*integers) if len(integers) == len(PART_NAMES) else None,
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
