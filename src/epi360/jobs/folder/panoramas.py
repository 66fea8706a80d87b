# SPDX-License-Identifier: BSD-3-Clause
"""The pictures of a folder as they are compared."""

from __future__ import annotations

from epi360.cameras import Camera
from epi360.features.images import read_masked_image
from epi360.features.warped_patches import Panorama
from epi360.jobs.folder.image_set import SourceImage


def read_panorama(image: SourceImage, camera: Camera, mask_nadir_deg: float) -> Panorama:
    """What a camera saw all around, without what its mask leaves out and what is straight down.

    ``OSError`` or ``ValueError`` where the picture or the mask cannot be read.
    """
    picture, usable = read_masked_image(image.path, image.mask)
    return Panorama.seen_by(camera, picture, usable, mask_nadir_deg)
