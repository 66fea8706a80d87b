# SPDX-License-Identifier: BSD-3-Clause
"""The pictures of a folder as they are compared."""

from __future__ import annotations

import cv2
import numpy as np

from epi360.cameras import Equirectangular
from epi360.features import nadir_mask, read_image, read_mask
from epi360.features.warped_patches import WIDTH, Panorama
from epi360.jobs.folder.image_set import SourceImage


def read_panorama(image: SourceImage, mask_nadir_deg: float) -> Panorama:
    """A full panorama, bare where nothing is to be used: its mask, or around straight down.

    ``OSError`` or ``ValueError`` where the picture or the mask cannot be read.
    """
    picture = read_image(image.path)
    if image.mask is None and mask_nadir_deg == 0.0:
        return Panorama.of(picture)
    usable = nadir_mask(Equirectangular(WIDTH, WIDTH // 2), mask_nadir_deg)
    if image.mask is not None:
        mask = read_mask(image.mask, picture.shape[:2]).astype(np.uint8)
        usable &= cv2.resize(mask, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_NEAREST) > 0
    return Panorama.of(picture, usable)
