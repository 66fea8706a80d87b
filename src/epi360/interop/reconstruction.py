# SPDX-License-Identifier: BSD-3-Clause
"""Cameras, poses and points: every reconstruction and trajectory is read into these."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.poses import Pose


@dataclass(frozen=True, eq=False)
class PosedImage:
    """An image and where it was taken.

    ``name``, ``camera`` and ``frame`` are as in `MatchedImage`; the name may also be the time stamp
    of a trajectory's row. ``cam_from_world`` has the axes x right, y down, z forward. What the file
    does not say is None.
    """

    name: str
    camera: str | None
    cam_from_world: Pose
    timestamp_s: float | None = None
    frame: str | None = None


@dataclass(frozen=True, eq=False)
class Observations:
    """Where the points are seen: row i of the three arrays is one observation.

    ``points`` (K,) are rows in the reconstruction's points, ``images`` (K,) indices in its images,
    ``pixels`` (K, 2) continuous pixels, where the centre of the top-left pixel is (0.5, 0.5).
    """

    points: NDArray[np.int64]
    images: NDArray[np.int64]
    pixels: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Posed images in the order of the file, and points if there are any.

    ``points`` (P, 3) are positions in the world, in the unit of the poses, and ``colors`` (P, 3)
    their RGB values; ``observations`` is None if the file does not say where they are seen.
    ``cameras`` and ``cam_from_rig`` are as in `MatchGraph`.

    Raises
    ------
    ValueError
        If an image is listed twice or names an unknown camera, a name is empty or no text, or the
        points do not have one color each.
    """

    cameras: Mapping[str, Camera]
    images: tuple[PosedImage, ...]
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    colors: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    observations: Observations | None = None
    cam_from_rig: Mapping[str, Pose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = set()
        for image in self.images:
            check_image(image.name, image.camera, self.cameras)
            if image.name in names:
                raise ValueError(f"image {image.name} is there twice")
            names.add(image.name)
        if self.points.shape != (len(self.colors), 3):
            raise ValueError(
                f"points must have shape ({len(self.colors)}, 3), one color each, "
                f"got {self.points.shape}"
            )


def check_image(name: str, camera: str | None, cameras: Mapping[str, Camera]) -> None:
    """Raise ``ValueError`` unless the name is text, and the camera is one of these or None."""
    check_image_name(name)
    if camera is not None and camera not in cameras:
        raise ValueError(f"image {name} has the unknown camera {camera!r}")


def check_image_name(name: str) -> None:
    """Raise ``ValueError`` for an empty name or bytes that are no text, which Linux allows."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError(f"image name {name!r} must be Unicode text; rename the file") from None
    if not name:
        raise ValueError("an image must have a name, got an empty one")
