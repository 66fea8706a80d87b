# SPDX-License-Identifier: BSD-3-Clause
"""Images, their key points and the matched pairs: what every match database is read into."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.interop.reconstruction import check_image_name
from epi360.poses import Pose


@dataclass(frozen=True, eq=False)
class MatchedImage:
    """An image with its key points.

    Attributes
    ----------
    name : str
        Path of the image below the folder of the images, with "/" between its parts.
    camera : str or None
        Key in the graph's cameras; None where the file does not say.
    keypoints : ndarray, shape (N, 2)
        Continuous pixels: the centre of the top-left pixel is (0.5, 0.5).
    descriptors : ndarray, shape (N, D), optional
        As the file has them.
    frame : str or None
        Images of a rig that share a frame were taken at one moment; None: a frame of its own.
    """

    name: str
    camera: str | None
    keypoints: NDArray[np.float64]
    descriptors: NDArray[np.float32] | None = None
    frame: str | None = None


@dataclass(frozen=True, eq=False)
class TwoViewGeometry:
    """What was found of a pair.

    Attributes
    ----------
    status : str
        Of `RelativePoseResult`.
    cam2_from_cam1 : Pose
        |t| = 1; NaN where the pair does not determine it.
    inliers : ndarray, shape (K, 2), int
        Rows of the pair's matches that agree with it: (key point in image 1, in image 2).
    """

    status: str
    cam2_from_cam1: Pose
    inliers: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """Two images and what matches between them.

    Attributes
    ----------
    image1, image2 : str
        Names, in the order of the pose: never swapped.
    matches : ndarray, shape (M, 2), int
        (key point in image 1, key point in image 2).
    geometry : TwoViewGeometry, optional
        None: not verified.
    """

    image1: str
    image2: str
    matches: NDArray[np.int64]
    geometry: TwoViewGeometry | None = None


@dataclass(frozen=True, eq=False)
class MatchGraph:
    """Images and matched pairs.

    Attributes
    ----------
    cameras : mapping of str to Camera
        By name.
    images : mapping of str to MatchedImage
        By name, in order.
    pairs : tuple of MatchedPair
        Each unordered pair of images at most once.
    cam_from_rig : mapping of str to Pose
        Where each camera sits on the rig; empty: no rig, every image is a frame of its own.

    Raises
    ------
    ValueError
        If a pair names an image that is not there, occurs twice, or has a match beyond its key
        points, an image names an unknown camera, or a name is no text.
    """

    cameras: Mapping[str, Camera]
    images: Mapping[str, MatchedImage]
    pairs: tuple[MatchedPair, ...]
    cam_from_rig: Mapping[str, Pose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check that the parts fit together."""
        for image in self.images.values():
            check_image_name(image.name)
            if image.camera is not None and image.camera not in self.cameras:
                raise ValueError(f"image {image.name} has the unknown camera {image.camera!r}")
        seen: set[frozenset[str]] = set()
        for pair in self.pairs:
            names = frozenset((pair.image1, pair.image2))
            what = f"pair {pair.image1} {pair.image2}"
            if len(names) < 2:
                raise ValueError(f"{what} must name two images")
            if names in seen:
                raise ValueError(f"{what} is there twice")
            seen.add(names)
            for column, name in enumerate((pair.image1, pair.image2)):
                if name not in self.images:
                    raise ValueError(f"{what}: there is no image {name}")
                indices, count = pair.matches[:, column], len(self.images[name].keypoints)
                if len(indices) and not 0 <= indices.min() <= indices.max() < count:
                    raise ValueError(
                        f"{what} must match key points 0 to {count - 1} of {name}, "
                        f"got {indices.min()} to {indices.max()}"
                    )
