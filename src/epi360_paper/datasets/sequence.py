# SPDX-License-Identifier: BSD-3-Clause
"""What every reader returns: the images of one moving camera and what is known of each."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.poses import Pose
from epi360.runs.input_files import read_file
from epi360_paper.datasets.intensities import eight_bit_image


@dataclass(frozen=True, eq=False)
class ImageSequence:
    """Images of one moving camera, in the order of time; pixels are read when asked for."""

    name: str  # of the scene, for tables
    camera: Camera
    image_paths: tuple[Path, ...]
    # (F,): those of TUM-VI count from 1970, to a quarter of a microsecond.
    timestamps_s: NDArray[np.float64]
    world_from_cam: tuple[Pose | None, ...]  # true poses in metres, None where not known
    depth_paths: tuple[Path, ...] = ()  # of each frame, or empty
    mask: NDArray[np.bool_] | None = None  # (H, W): pixels to use
    # Values of 16-bit images that become black and white, see `intensity_levels`.
    levels: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        counts = {
            "images": len(self.image_paths),
            "timestamps": len(self.timestamps_s),
            "poses": len(self.world_from_cam),
        }
        if self.depth_paths:
            counts["depth maps"] = len(self.depth_paths)
        if len(set(counts.values())) > 1:
            found = ", ".join(f"{count} {what}" for what, count in counts.items())
            raise ValueError(f"{self.name} must have one of each per frame, got {found}")

    def __len__(self) -> int:
        return len(self.image_paths)

    def image(self, index: int) -> NDArray[np.uint8]:
        """Picture of a frame as 8-bit RGB, (H, W, 3); ``ValueError`` if it is damaged."""
        path = self.image_paths[index]
        image = eight_bit_image(path, self.levels)
        self._check_size(image.shape, path)
        return image

    def depth(self, index: int) -> NDArray[np.float32]:
        """Range along the ray of each pixel of a frame in metres, (H, W); 0 where there is none.

        ``ValueError`` if the sequence has no depth, or the file is no float image of the camera's
        size.
        """
        if not self.depth_paths:
            raise ValueError(f"{self.name} has no depth maps; only MP3D-VO scenes have them")
        path = self.depth_paths[index]
        encoded = np.frombuffer(read_file(path), np.uint8)
        depth = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED) if len(encoded) else None
        if depth is None or depth.ndim != 2 or not np.issubdtype(depth.dtype, np.floating):
            raise ValueError(f"depth map {path} must be a TIFF of one float channel")
        self._check_size(depth.shape, path)
        return np.asarray(depth, dtype=np.float32)

    def _check_size(self, shape: tuple[int, ...], path: Path) -> None:
        camera = self.camera
        if shape[:2] != (camera.height, camera.width):
            raise ValueError(
                f"{path} must have the camera's size {camera.width}x{camera.height}, got "
                f"{shape[1]}x{shape[0]}; use the calibration of these images"
            )
