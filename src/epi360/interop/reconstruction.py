# SPDX-License-Identifier: BSD-3-Clause
"""Cameras, poses and points: what every reconstruction and trajectory is read into."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.poses import Pose


@dataclass(frozen=True, eq=False)
class PosedImage:
    """An image and where it was taken.

    Attributes
    ----------
    name : str
        Path of the image below the folder of the images; of a trajectory: its time stamp as text.
    camera : str or None
        Key in the reconstruction's cameras; None where the file does not say.
    cam_from_world : Pose
        Camera axes x right, y down, z forward.
    timestamp_s : float, optional
        Seconds; None where the file does not say.
    frame : str or None
        Images of a rig that share a frame were taken at one moment; None: a frame of its own.
    """

    name: str
    camera: str | None
    cam_from_world: Pose
    timestamp_s: float | None = None
    frame: str | None = None


@dataclass(frozen=True, eq=False)
class Observations:
    """Where the points are seen, one row an observation.

    Attributes
    ----------
    points : ndarray, shape (K,), int
        Row in the reconstruction's points.
    images : ndarray, shape (K,), int
        Index in the reconstruction's images.
    pixels : ndarray, shape (K, 2)
        Continuous pixels.
    """

    points: NDArray[np.int64]
    images: NDArray[np.int64]
    pixels: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Posed images, and points where there are any.

    Attributes
    ----------
    cameras : mapping of str to Camera
        By name.
    images : tuple of PosedImage
        In the order of the file.
    points : ndarray, shape (P, 3)
        In the world.
    colors : ndarray, shape (P, 3), uint8
        RGB of the points.
    observations : Observations, optional
        None where the file has none.
    cam_from_rig : mapping of str to Pose
        Where each camera sits on its rig; empty: no rig, every image is a frame of its own.

    Raises
    ------
    ValueError
        If an image is there twice or names an unknown camera, a name is no text, or there is not
        one color a point.
    """

    cameras: Mapping[str, Camera]
    images: tuple[PosedImage, ...]
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    colors: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 3), np.uint8))
    observations: Observations | None = None
    cam_from_rig: Mapping[str, Pose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the parts fit together."""
        names = set()
        for image in self.images:
            check_image_name(image.name)
            if image.name in names:
                raise ValueError(f"image {image.name} is there twice")
            names.add(image.name)
            if image.camera is not None and image.camera not in self.cameras:
                raise ValueError(f"image {image.name} has the unknown camera {image.camera!r}")
        if self.points.shape != (len(self.colors), 3):
            raise ValueError(
                f"points must have shape ({len(self.colors)}, 3), one color each, "
                f"got {self.points.shape}"
            )


def check_image_name(name: str) -> None:
    """Raise ``ValueError`` unless a file of another tool can hold the name.

    Parameters
    ----------
    name : str
        Of an image; Linux lets names of files be bytes that are no text.
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raise ValueError(f"image name {name!r} must be Unicode text; rename the file") from None
    if not name:
        raise ValueError("an image must have a name, got an empty one")
