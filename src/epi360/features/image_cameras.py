# SPDX-License-Identifier: BSD-3-Clause
"""The camera of an image: the one place where it is found."""

import os
import reprlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.gpano import GPano, panorama_camera, parse_gpano
from epi360.features.image_headers import read_image_header
from epi360.features.images import ImageSource, require_panorama


def find_camera(
    source: ImageSource, picture: NDArray[np.uint8], camera: Camera | None, name: str
) -> Camera:
    """Camera of a picture: the given one, or that of a panorama or of a part of one.

    A file is the part of a panorama that its GPano metadata state. What does not fit is a
    ``ValueError`` that calls it ``name``; so is a raw dual fisheye frame with the camera of a full
    panorama.
    """
    if camera is None:
        return find_panorama(source, picture, name)
    height, width = picture.shape[:2]
    check_camera(camera, f"the camera of {name}")
    if (camera.width, camera.height) != (width, height):
        raise ValueError(
            f"{name} is {width}x{height} but its camera is {camera.width}x{camera.height}; "
            "give the camera of this image size"
        )
    if camera == Equirectangular(width, height):
        require_panorama(picture, name, is_stated=True)
    return camera


def find_panorama(source: ImageSource, picture: NDArray[np.uint8], name: str) -> Equirectangular:
    """Camera of a panorama, or of a part of one; ``ValueError`` for what is none."""
    height, width = picture.shape[:2]
    gpano = gpano_of(source)
    try:
        found = panorama_camera(width, height, gpano)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if found == Equirectangular(width, height):
        require_panorama(picture, name, is_stated=gpano is not None)
    return found


def check_camera(camera: object, name: str) -> None:
    """Raise ``ValueError`` for what is no camera, such as the name of a calibration file."""
    if not isinstance(camera, Camera):
        raise ValueError(
            f"{name} must be a camera, got {reprlib.repr(camera)}; load_camera(FILE) reads one "
            "from a calibration file, and load_cameras(FILE)[NAME] one of several"
        )


def gpano_of(source: ImageSource) -> GPano | None:
    """GPano metadata of a file."""
    if not isinstance(source, str | os.PathLike) or not Path(source).is_file():
        return None  # an array; or a pipe, which can be read only once
    return parse_gpano(read_image_header(source).xmp)
