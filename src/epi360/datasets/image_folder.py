# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images without poses."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from epi360.cameras import Camera
from epi360.datasets.intensities import intensity_levels
from epi360.datasets.sequence import ImageSequence
from epi360.features import read_image
from epi360.features.image_cameras import find_camera

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp")


def load_image_folder(
    folder: str | os.PathLike[str], camera: Camera | None = None, *, frames_per_s: float = 30.0
) -> ImageSequence:
    """Sequence of the images of a folder, in the order of their names.

    Parameters
    ----------
    folder : path-like
        Its JPEG, PNG, TIFF, WebP and BMP files are taken, other files are left alone. Numbers in
        the names count as numbers: 2.png comes before 10.png.
    camera : Camera, optional
        Default: full equirectangular panoramas of the first image's size, or the part of one that
        its GPano metadata state.
    frames_per_s : float
        Rate for the timestamps, which start at 0.

    Returns
    -------
    sequence : ImageSequence
        Without poses.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist or holds no images.
    ValueError
        If the first image is damaged, or no panorama where no camera is given, or the rate is
        not positive.
    """
    if not frames_per_s > 0:
        raise ValueError(f"frames_per_s must be positive, got {frames_per_s}")
    folder = existing_folder(folder, "image folder")
    paths = [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES]
    if not paths:
        raise FileNotFoundError(f"image folder {folder} has no JPEG, PNG, TIFF, WebP or BMP files")
    paths.sort(key=natural_order)
    return ImageSequence(
        name=folder.name,
        camera=camera or panorama_camera(paths[0]),
        image_paths=tuple(paths),
        timestamps_s=np.arange(len(paths)) / frames_per_s,
        world_from_cam=(None,) * len(paths),
        levels=intensity_levels(paths),
    )


def existing_folder(folder: str | os.PathLike[str], what: str) -> Path:
    """Path of a folder; ``FileNotFoundError`` or ``ValueError`` names it where it is none."""
    path = Path(folder)
    if not path.exists():
        raise FileNotFoundError(f"{what} {path} does not exist")
    if not path.is_dir():
        raise ValueError(f"{what} {path} is a file, expected a folder")
    return path


def panorama_camera(path: Path) -> Camera:
    """Camera of a panorama or of a part of one; ``ValueError`` if the image is neither."""
    return find_camera(path, read_image(path), None, f"image {path}")


def natural_order(path: Path) -> tuple[list[tuple[bool, int, str]], str]:
    """Sort key of a path by its name: digits as numbers, the rest as text."""
    parts: list[str] = []
    for character in path.stem:
        if parts and parts[-1][-1].isdecimal() == character.isdecimal():
            parts[-1] += character
        else:
            parts.append(character)
    key = [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]
    return key, path.name
