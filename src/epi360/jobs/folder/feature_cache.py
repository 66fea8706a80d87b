# SPDX-License-Identifier: BSD-3-Clause
"""Key points of images on disk, found again by the content of the image."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import cv2
import numpy as np

from epi360.cameras import Camera, Equirectangular
from epi360.features import require_panorama
from epi360.features.detection import FAINT_CONTRAST_THRESHOLD, SiftKeypoints, find_keypoints
from epi360.features.images import read_masked_image
from epi360.jobs.folder.image_set import SourceImage
from epi360.runs.arrays import Arrays, npz_bytes, read_arrays
from epi360.runs.file_digests import FileDigests
from epi360.runs.made_from import fingerprint
from epi360.runs.remote_path import AnyPath
from epi360.runs.whole_files import write_file

# Raise it when the same image and options give other key points than before.
EXTRACTION_VERSION = 5
_TYPES = {
    "pixels": np.float32,
    "sizes": np.float32,
    "strengths": np.float32,
    "descriptors": np.uint8,
}
COLORS = "colors"  # RGB of each key point, for the points of a map


class UnreadableImageError(ValueError):
    """An image, or its mask, that cannot be used; the message is the reason."""


@dataclass(frozen=True)
class ExtractionOptions:
    """How key points are found.

    Wider images than ``max_width`` are searched at this width, the strongest ``max_features`` are
    kept, and ``mask_nadir_deg`` around straight down is ignored.
    """

    max_width: int
    max_features: int
    mask_nadir_deg: float


@dataclass(frozen=True)
class FeatureCache:
    """A folder with one file of key points for each image content that was searched.

    SIFT's descriptors are whole numbers from 0 to 255, so that a byte holds each without a loss:
    147 bytes a key point in all.
    """

    folder: AnyPath
    options: ExtractionOptions
    digests: FileDigests = field(default_factory=FileDigests)

    def key(self, image: SourceImage, camera: Camera) -> str:
        """Name of the key points of an image: a hash of all that they depend on.

        The image file and its mask are read, unless their hashes are known; names do not matter.
        """
        rules = (EXTRACTION_VERSION, cv2.__version__, FAINT_CONTRAST_THRESHOLD)
        try:
            contents = [
                b"" if path is None else self.digests.digest_of(path)
                for path in (image.path, image.mask)
            ]
        except OSError as error:
            raise UnreadableImageError(f"{error.filename}: {error.strerror}") from None
        return fingerprint((rules, self.options, camera), *contents)

    def has(self, key: str) -> bool:
        """Whether there is a whole file for a key."""
        return self.load(key) is not None

    def extract(self, key: str, image: SourceImage, camera: Camera) -> SiftKeypoints:
        """Find the key points of an image, strongest first, and keep them; as `load` gives them."""
        try:
            picture, usable = read_masked_image(image.path, image.mask)
            if camera == Equirectangular(camera.width, camera.height):
                require_panorama(picture, is_stated=image.is_stated)
            found = find_keypoints(
                picture,
                camera,
                usable,
                **asdict(self.options),
                contrast_threshold=FAINT_CONTRAST_THRESHOLD,
            )
        except (OSError, ValueError, cv2.error) as error:
            raise UnreadableImageError(" ".join(str(error).split())) from error
        arrays: Arrays = {name: getattr(found, name).astype(t) for name, t in _TYPES.items()}
        last = camera.width - 1, camera.height - 1
        columns, rows = np.clip(found.pixels.astype(int), 0, last).T
        arrays[COLORS] = picture[rows, columns]
        write_file(self.path(key), npz_bytes(arrays))
        return _as_found(arrays)

    def load(self, key: str) -> SiftKeypoints | None:
        """Key points of a key, or None where the file is missing or damaged."""
        return keypoints_in_file(self.path(key))

    def path(self, key: str) -> AnyPath:
        """Path of the file of a key."""
        return self.folder / f"{key}.npz"


def keypoints_in_file(path: AnyPath) -> SiftKeypoints | None:
    """Key points in a file of a cache, or None where it is missing or damaged."""
    arrays = read_arrays(path)
    return _as_found(arrays) if arrays is not None and set(arrays) == {*_TYPES, COLORS} else None


def _as_found(arrays: Arrays) -> SiftKeypoints:
    return SiftKeypoints(
        arrays["pixels"].astype(np.float64),
        arrays["sizes"].astype(np.float64),
        arrays["strengths"].astype(np.float64),
        arrays["descriptors"],
    )
