# SPDX-License-Identifier: BSD-3-Clause
"""The pictures of a folder as they are compared."""

from __future__ import annotations

from epi360.cameras import Camera
from epi360.features import read_image, read_mask
from epi360.features.warped_patches import Panorama
from epi360.jobs.folder.image_set import SourceImage


def read_panorama(image: SourceImage, camera: Camera, mask_nadir_deg: float) -> Panorama:
    """What a camera saw all around, without what its mask leaves out and what is straight down.

    ``OSError`` or ``ValueError`` where the picture or the mask cannot be read.
    """
    picture = read_image(image.path)
    mask = None if image.mask is None else read_mask(image.mask, picture.shape[:2])
    return Panorama.seen_by(camera, picture, mask, mask_nadir_deg)
