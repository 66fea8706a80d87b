# SPDX-License-Identifier: BSD-3-Clause
"""The images of a folder with everything that is known of each."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.cameras.gpano import GPano, panorama_camera, parse_gpano
from epi360.features.image_files import MAX_PIXELS, decode_image_file
from epi360.features.image_headers import read_image_header
from epi360.image_folders import IMAGE_SUFFIXES, existing_folder
from epi360.interop.video import VIDEO_SUFFIXES
from epi360.jobs.folder.folder_files import files_below
from epi360.jobs.folder.given_cameras import GivenCameras, read_given_cameras
from epi360.jobs.folder.masks import MaskSource
from epi360.poses import Pose

RAW_SUFFIXES = (".insp", ".dng")  # refused by the decoder, which says what to do with them
# Pictures that are not read: they are named among what is not used, not passed over in silence.
OTHER_SUFFIXES = (".avif", ".gif", ".heic", ".heif", ".jp2", ".jxl")


@dataclass(frozen=True, eq=False)
class SourceImage:
    """An image file and what is known of it."""

    # Path below the folder of the images with "/" between its parts, spelt as on disk: an accent is
    # one character or two as the file system has it.
    name: str
    path: Path
    camera: str  # key in the cameras of the set
    mask: Path | None = None  # white = use; its content is checked when it is read
    frame: str | None = None  # images of a rig that share it were taken at one moment
    down: NDArray[np.float64] | None = None  # gravity in the camera frame, if the file states it
    is_stated: bool = False  # the file (GPano), or a calibration that was given, says what it is


@dataclass(frozen=True, eq=False)
class ImageSet:
    """The images of a folder, in natural order: its own first, then its sub-folders one by one."""

    folder: Path  # the names of the images start from it
    cameras: dict[str, Camera]  # those of the camera file, or one for each size of panorama
    images: tuple[SourceImage, ...]  # at least one
    cam_from_rig: dict[str, Pose] = field(default_factory=dict)  # empty: no rig
    skipped: tuple[tuple[str, str], ...] = ()  # name and reason of each picture of no use


def find_images(
    folder: str | os.PathLike[str], *, camera: str | None = None, mask: Path | None = None
) -> ImageSet:
    """Images of a folder and its sub-folders, with camera, mask and gravity of each.

    Parameters
    ----------
    folder : path-like
        Its JPEG, PNG, TIFF, WebP and BMP files are taken, those of sub-folders too. Hidden files
        and folders, folders that this package wrote, and the masks are left out. Pictures of other
        formats, such as GIF and HEIC, are among ``skipped``.
    camera : str, optional
        Calibration file, ``FILE`` or ``FILE:NAME``. Where it holds several cameras, the sub-folder
        of an image names its camera; where it says how they sit on a rig, images that have the
        same name below these folders were taken at one moment. Without a file, an image is a 2:1
        panorama, or the part of one that its GPano metadata describe.
    mask : Path, optional
        Mask of all images, white = use; or a folder of masks, see `MaskSource`. Images without one
        there are used whole.

    Raises
    ------
    FileNotFoundError
        If the folder, the camera file or the mask does not exist, or the folder has no images.
    ValueError
        If none of the images can be used, a sub-folder names no camera, the masks belong to no
        image or lie in the folder of the images itself, or a file cannot be read.

    Notes
    -----
    Sizes come from the headers of the files: 0.2 ms a JPEG or TIFF of any size, up to 30 ms a PNG
    of 11040x5520. WebP and BMP are decoded. A file that is damaged behind its header, and a raw
    dual fisheye frame, are only noticed when they are decoded.
    """
    folder = existing_folder(folder, "image folder")
    _check_mask_is_elsewhere(folder, mask)
    chosen = _PanoramaCameras() if camera is None else _FileCameras(read_given_cameras(camera))
    masks = MaskSource(mask)
    images: list[SourceImage] = []
    skipped: list[tuple[str, str]] = []
    for name, path in _picture_files(folder, mask):
        try:
            images.append(_source_image(name, path, chosen, masks))
        except _Unusable as unusable:
            skipped.append((_printable(name), str(unusable)))
    if not images and not skipped:
        raise FileNotFoundError(
            f"image folder {folder} has no JPEG, PNG, TIFF, WebP or BMP files{_video_hint(folder)}"
        )
    if not images:
        name, reason = skipped[0]
        more = f" (and {len(skipped) - 1} more)" if len(skipped) > 1 else ""
        raise ValueError(f"image folder {folder} has no usable image: {name}{more} {reason}")
    masks.check_used([image.mask for image in images])
    return ImageSet(folder, chosen.cameras, tuple(images), chosen.cam_from_rig, tuple(skipped))


def _video_hint(folder: Path) -> str:
    videos = [path.name for path in folder.iterdir() if path.suffix.lower() in VIDEO_SUFFIXES]
    return f"; give the video {videos[0]} itself" if videos else ""


class _Unusable(Exception):  # noqa: N818 - a reason, not an error
    """Why one image cannot be used."""


class _Cameras(Protocol):
    """Where the cameras of the images come from."""

    cameras: dict[str, Camera]
    cam_from_rig: dict[str, Pose]

    def of(self, name: str, size: tuple[int, int], gpano: GPano | None) -> tuple[str, str | None]:
        """Name of the camera of an image, and its frame."""


class _PanoramaCameras:
    """One camera for each size of panorama, and for each part of one."""

    def __init__(self) -> None:
        self.cameras: dict[str, Camera] = {}
        self.cam_from_rig: dict[str, Pose] = {}
        self._names: dict[Camera, str] = {}

    def of(self, name: str, size: tuple[int, int], gpano: GPano | None) -> tuple[str, str | None]:
        try:
            camera = panorama_camera(*size, gpano)
        except ValueError as error:
            if gpano is None or gpano.part is None:
                raise _Unusable(
                    f"is no panorama: {size[0]}x{size[1]} is not 2:1; give its camera "
                    "(--camera FILE)"
                ) from None
            raise _Unusable(f"cannot be used: {error}") from None
        if camera not in self._names:
            called = f"panorama {size[0]}x{size[1]}"
            if camera != Equirectangular(*size):
                parts = sum(known.startswith(f"{called} part ") for known in self.cameras)
                called += f" part {parts + 1}"
            self._names[camera] = called
            self.cameras[called] = camera
        return self._names[camera], None


class _FileCameras:
    """The cameras of a calibration file."""

    def __init__(self, given: GivenCameras) -> None:
        self._given = given
        self.cameras = dict(given.cameras)
        self.cam_from_rig = dict(given.cam_from_rig)

    def of(self, name: str, size: tuple[int, int], gpano: GPano | None) -> tuple[str, str | None]:
        called = self._given.name_of(name)
        camera = self.cameras[called]
        if (camera.width, camera.height) != size:
            raise _Unusable(
                f"is {size[0]}x{size[1]} but its camera is {camera.width}x{camera.height}; give "
                "the camera of this image size"
            )
        return called, name.removeprefix(f"{called}/") if self.cam_from_rig else None


def _source_image(name: str, path: Path, chosen: _Cameras, masks: MaskSource) -> SourceImage:
    if _printable(name) != name:
        raise _Unusable("has a name that is not valid Unicode; rename it")
    size, gpano = _size_and_gpano(path)
    camera, frame = chosen.of(name, size, gpano)
    mask = masks.mask_of(name)
    wrong = "" if mask is None else masks.wrong_size(mask, size)
    if wrong:
        raise _Unusable(wrong)
    down = None if gpano is None else gpano.down
    is_stated = gpano is not None or isinstance(chosen, _FileCameras)
    return SourceImage(name, path, camera, mask, frame, down, is_stated)


def _size_and_gpano(path: Path) -> tuple[tuple[int, int], GPano | None]:
    if not path.is_file():
        raise _Unusable("is no file: a broken link or a device")
    try:
        header = read_image_header(path)
    except OSError as error:
        raise _Unusable(f"cannot be read: {error.strerror}") from None
    size = header.size
    is_raw = path.suffix.lower() in RAW_SUFFIXES
    if is_raw or size is None or size[0] * size[1] > MAX_PIXELS:
        size = _decoded_size(path)
    return size, parse_gpano(header.xmp)


def _decoded_size(path: Path) -> tuple[int, int]:
    try:
        pixels = decode_image_file(path, MAX_PIXELS, "image")
    except (FileNotFoundError, ValueError) as error:
        raise _Unusable(str(error).removeprefix(f"image {path} ")) from None
    return pixels.shape[1], pixels.shape[0]


def _picture_files(folder: Path, mask: Path | None) -> list[tuple[str, Path]]:
    """Files that look like pictures and are no masks."""
    suffixes = (*IMAGE_SUFFIXES, *RAW_SUFFIXES, *OTHER_SUFFIXES)
    files = [file for file in files_below(folder) if file[1].suffix.lower() in suffixes]
    if mask is None:
        return files
    return [(name, path) for name, path in files if not _is_within(path, mask)]


def _check_mask_is_elsewhere(folder: Path, mask: Path | None) -> None:
    if mask is not None and mask.is_dir() and _is_within(folder, mask):
        raise ValueError(
            f"mask folder {mask} holds the images themselves; put the masks into a folder of "
            "their own"
        )


def _is_within(path: Path, other: Path) -> bool:
    """Whether a path is another or lies below it, links followed."""
    resolved, wanted = Path(os.path.realpath(path)), Path(os.path.realpath(other))
    return wanted in (resolved, *resolved.parents)


def _printable(name: str) -> str:
    return name.encode("utf-8", "replace").decode()
