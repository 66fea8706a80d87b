# SPDX-License-Identifier: BSD-3-Clause
"""Key points of images on disk, found again by the content of the image."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from hashlib import blake2b
from pathlib import Path

import cv2
import numpy as np

from epi360.cameras import Camera, Equirectangular
from epi360.features import read_image, require_panorama
from epi360.features.detection import FAINT_CONTRAST_THRESHOLD, SiftKeypoints, find_keypoints
from epi360.files import write_file
from epi360.jobs.array_files import Arrays, npz_bytes, read_arrays
from epi360.jobs.file_digests import FileDigests
from epi360.jobs.image_set import SourceImage

# Raise it when the same image and options give other key points than before.
EXTRACTION_VERSION = 2
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

    Parameters
    ----------
    max_width : int
        Wider images are searched at this width.
    max_features : int
        The strongest are kept.
    mask_nadir_deg : float
        Ignore this angle around straight down.
    """

    max_width: int
    max_features: int
    mask_nadir_deg: float


@dataclass(frozen=True)
class FeatureCache:
    """A folder with one file of key points for each image content that was searched.

    SIFT's descriptors are whole numbers from 0 to 255, so that a byte holds each without a loss:
    147 bytes a key point in all.

    Parameters
    ----------
    folder : Path
        It exists.
    options : ExtractionOptions
        Of all its images.
    digests : FileDigests
        Of the image files and masks.
    """

    folder: Path
    options: ExtractionOptions
    digests: FileDigests = field(default_factory=FileDigests)

    def key(self, image: SourceImage, camera: Camera) -> str:
        """Name of the key points of an image: a hash of all that they depend on.

        Parameters
        ----------
        image : SourceImage
            Its file and that of its mask are read, unless their hashes are known; its name does
            not matter.
        camera : Camera
            Of the image.

        Raises
        ------
        UnreadableImageError
            If a file cannot be read.
        """
        rules = (EXTRACTION_VERSION, cv2.__version__, FAINT_CONTRAST_THRESHOLD)
        digest = blake2b(repr((rules, self.options, camera)).encode(), digest_size=16)
        try:
            for path in (image.path, image.mask):
                digest.update(b"" if path is None else self.digests.of(path))
        except OSError as error:
            raise UnreadableImageError(f"{error.filename}: {error.strerror}") from None
        return digest.hexdigest()

    def has(self, key: str) -> bool:
        """Whether there is a whole file for a key."""
        return self._read(key) is not None

    def extract(self, key: str, image: SourceImage, camera: Camera) -> SiftKeypoints:
        """Find the key points of an image and keep them.

        Parameters
        ----------
        key : str
            Of the image.
        image : SourceImage
            Its files are read.
        camera : Camera
            Of the image.

        Returns
        -------
        keypoints : SiftKeypoints
            As `load` will give them: strongest first, down to the fainter contrast threshold.

        Raises
        ------
        UnreadableImageError
            If the image or its mask cannot be used.
        OSError
            If the key points cannot be written.
        """
        try:
            picture = read_image(image.path)
            if camera == Equirectangular(camera.width, camera.height):
                require_panorama(picture)
            found = find_keypoints(
                picture,
                camera,
                image.mask,
                **asdict(self.options),
                contrast_threshold=FAINT_CONTRAST_THRESHOLD,
            )
        except (OSError, ValueError, cv2.error) as error:
            raise UnreadableImageError(" ".join(str(error).split())) from None
        arrays: Arrays = {name: getattr(found, name).astype(t) for name, t in _TYPES.items()}
        last = camera.width - 1, camera.height - 1
        columns, rows = np.clip(found.pixels.astype(int), 0, last).T
        arrays[COLORS] = picture[rows, columns]
        write_file(self._path(key), npz_bytes(arrays))
        return _as_found(arrays)

    def load(self, key: str) -> SiftKeypoints | None:
        """Key points of a key, or None where the file is missing or damaged.

        Parameters
        ----------
        key : str
            Of the image.
        """
        arrays = self._read(key)
        return None if arrays is None else _as_found(arrays)

    def _read(self, key: str) -> Arrays | None:
        arrays = read_arrays(self._path(key))
        return arrays if arrays is not None and set(arrays) == {*_TYPES, COLORS} else None

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"


def _as_found(arrays: Arrays) -> SiftKeypoints:
    return SiftKeypoints(
        arrays["pixels"].astype(np.float64),
        arrays["sizes"].astype(np.float64),
        arrays["strengths"].astype(np.float64),
        arrays["descriptors"],
    )
