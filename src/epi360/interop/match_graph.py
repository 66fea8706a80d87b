# SPDX-License-Identifier: BSD-3-Clause
"""Images, key points and matched pairs: every match database is read into these."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.interop.reconstruction import check_image
from epi360.poses import Pose

REFUSED = "refused"  # the status of a pair with a pose that the folder speaks against


@dataclass(frozen=True, eq=False)
class MatchedImage:
    """An image with its key points.

    ``name`` is the path of the image below the folder of the images, with "/" between its parts,
    and ``camera`` a key in the graph's cameras, or None if the file does not say. ``keypoints`` (N,
    2) are continuous pixels, where the centre of the top-left pixel is (0.5, 0.5); ``descriptors``
    (N, D) are as in the file. Images of a rig that share a ``frame`` were taken at one moment; None
    is a frame of its own.
    """

    name: str
    camera: str | None
    keypoints: NDArray[np.float64]
    descriptors: NDArray[np.float32] | None = None
    frame: str | None = None


@dataclass(frozen=True, eq=False)
class TwoViewGeometry:
    """Relative pose of a pair of images and the matches that agree with it.

    ``status`` is one of those of ``RelativePoseResult``, or REFUSED: other pairs of the folder, or
    what surrounds the matches, speak against the pose. ``cam2_from_cam1`` has |t| = 1, or is NaN if
    the pair does not determine it. ``inliers`` (K, 2) are the matches that agree with the pose:
    (key point in image 1, key point in image 2).
    """

    status: str
    cam2_from_cam1: Pose
    inliers: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MatchedPair:
    """Two images, named in the order that the pose has, and the matches between them.

    Each row of ``matches`` (M, 2) is (key point in image 1, key point in image 2); ``geometry`` is
    None if the pair was not verified.
    """

    image1: str
    image2: str
    matches: NDArray[np.int64]
    geometry: TwoViewGeometry | None = None


@dataclass(frozen=True, eq=False)
class MatchGraph:
    """Images and matched pairs.

    Cameras and images are by name; the order of the images counts. Two images are a pair only once,
    in either order. ``cam_from_rig`` has the pose of each camera on its rig, by the camera's name.
    If it is empty there is no rig, and every image is a frame of its own. Images and pairs may be
    made each time that they are asked for, as those of `load_matches` are.

    Raises
    ------
    ValueError
        If a pair names an unknown image, is listed twice or matches a key point that does not
        exist, an image names an unknown camera, a name is empty or no text, or key points or
        matches have another shape.
    """

    cameras: Mapping[str, Camera]
    images: Mapping[str, MatchedImage]
    pairs: Sequence[MatchedPair]
    cam_from_rig: Mapping[str, Pose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        num_keypoints = {}
        for name, image in self.images.items():
            check_image(image.name, image.camera, self.cameras)
            if image.keypoints.ndim != 2 or image.keypoints.shape[1] != 2:
                raise ValueError(
                    f"image {name}: key points must be pixels of shape (N, 2), got "
                    f"{image.keypoints.shape}"
                )
            num_keypoints[name] = len(image.keypoints)
        listed: set[frozenset[str]] = set()
        for pair in self.pairs:
            names = frozenset((pair.image1, pair.image2))
            what = f"pair {pair.image1} {pair.image2}"
            if len(names) < 2:
                raise ValueError(f"{what} must name two images")
            if names in listed:
                raise ValueError(f"{what} is there twice")
            listed.add(names)
            _check_matches(what, pair.matches)
            for column, name in enumerate((pair.image1, pair.image2)):
                if name not in num_keypoints:
                    raise ValueError(f"{what}: there is no image {name}")
                indices, count = pair.matches[:, column], num_keypoints[name]
                if len(indices) and not 0 <= indices.min() <= indices.max() < count:
                    raise ValueError(
                        f"{what} must match key points 0 to {count - 1} of {name}, "
                        f"got {indices.min()} to {indices.max()}"
                    )


def _check_matches(what: str, matches: NDArray[np.int64]) -> None:
    if matches.ndim != 2 or matches.shape[1] != 2 or not np.issubdtype(matches.dtype, np.integer):
        raise ValueError(
            f"{what}: matches must be numbers of key points, whole and of shape (M, 2), got "
            f"{matches.dtype} {matches.shape}"
        )
