# SPDX-License-Identifier: BSD-3-Clause
"""A folder of images without poses."""

from pathlib import Path

import numpy as np

from epi360.cameras import Camera
from epi360.features import read_image
from epi360.features.image_cameras import find_camera
from epi360.image_folders import IMAGE_SUFFIXES, existing_folder, natural_order
from epi360.runs.whole_files import PathLike
from epi360_paper.datasets.intensities import intensity_levels
from epi360_paper.datasets.sequence import ImageSequence


def load_image_folder(
    folder: PathLike, camera: Camera | None = None, *, frames_per_s: float = 30.0
) -> ImageSequence:
    """Sequence, without poses, of the images of a folder, in the order of their names.

    Numbers in the names count as numbers: 2.png comes before 10.png. By default the images are full
    panoramas of the first one's size, or the part of one that its GPano metadata state.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist or holds no images.
    ValueError
        If the first image is damaged, if it is no panorama and no camera is given, or if the rate
        is not positive.
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


def panorama_camera(path: Path) -> Camera:
    """Camera of a panorama or of a part of one; ``ValueError`` if the image is neither."""
    return find_camera(path, read_image(path), None, f"image {path}")
