# SPDX-License-Identifier: BSD-3-Clause
"""Key points followed through an image sequence: Shi-Tomasi corners, pyramidal Lucas-Kanade."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera
from epi360.features.image_cameras import find_camera
from epi360.features.images import ImageSource, read_image, read_mask
from epi360.features.lucas_kanade import erode_mask, find_corners, follow_there_and_back

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Tracks:
    """Key points followed through a sequence.

    Attributes
    ----------
    keypoints : ndarray, shape (F, N, 2)
        Continuous pixels of point n in frame f; NaN where it is not seen. A lost point stays
        lost.
    """

    keypoints: Array

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Whether point n is seen in frame f, shape (F, N)."""
        return np.isfinite(self.keypoints[:, :, 0])


@dataclass(frozen=True)
class _Options:
    max_features: int
    quality_level: float
    min_distance_rad: float
    forward_backward_px: float
    window_px: int
    pyramid_levels: int
    redetect: bool

    def __post_init__(self) -> None:
        for name in ("max_features", "quality_level", "forward_backward_px"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")
        if not 0 <= self.min_distance_rad < np.pi:
            degrees = np.degrees(self.min_distance_rad)
            raise ValueError(f"min_distance_deg must be in [0, 180), got {degrees:g}")
        if self.window_px < 3 or self.pyramid_levels < 0:
            raise ValueError(
                "window_px must be at least 3 and pyramid_levels at least 0, got "
                f"{self.window_px} and {self.pyramid_levels}"
            )


@dataclass(frozen=True)
class _View:
    camera: Camera
    mask: NDArray[np.bool_]
    margin: int  # columns repeated on both sides, 0 where the image has an edge there

    def pad(self, image: Picture) -> Picture:
        padded = cv2.copyMakeBorder(image, 0, 0, self.margin, self.margin, cv2.BORDER_WRAP)
        return np.asarray(padded, dtype=np.uint8)

    def padded_from_pixels(self, pixels: Array) -> NDArray[np.float32]:
        """OpenCV's coordinates (pixel centres at integers) in the padded image."""
        return (pixels + (self.margin - 0.5, -0.5)).astype(np.float32)

    def pixels_from_padded(self, points: NDArray[np.float32]) -> Array:
        """Inverse of `padded_from_pixels`, brought back into the image across the seam."""
        pixels = points.astype(np.float64) + (0.5 - self.margin, 0.5)
        if self.margin:
            pixels[:, 0] %= self.camera.width
        return pixels

    def is_usable(self, pixels: Array) -> NDArray[np.bool_]:
        """Whether pixels lie in the image and on the mask."""
        u, v = pixels.T
        usable: NDArray[np.bool_] = (
            (u >= 0) & (u < self.camera.width) & (v >= 0) & (v < self.camera.height)
        )
        columns, rows = pixels[usable].astype(np.intp).T
        usable[usable] = self.mask[rows, columns]
        return usable


def track_features(
    images: Iterable[ImageSource],
    camera: Camera | None = None,
    mask: ImageSource | None = None,
    *,
    max_features: int = 200,
    quality_level: float = 0.01,
    min_distance_deg: float = 3.0,
    forward_backward_px: float = 0.5,
    window_px: int = 21,
    pyramid_levels: int = 4,
    redetect: bool = False,
) -> Tracks:
    """Corners of the first image, followed through the others, also across the seam.

    Parameters
    ----------
    images : iterable of str, path or ndarray
        At least two of one size, see `read_image`; two are held at a time.
    camera : Camera, optional
        Default: full equirectangular panoramas, or the part of one that the GPano metadata of the
        first file state.
    mask : str, path or ndarray, optional
        White = use. Points that enter the black part are lost.
    max_features : int
        Most points at a time (the paper, section 5.2: around 200).
    quality_level : float
        Weakest corner, relative to the strongest (the smaller eigenvalue of Shi and Tomasi).
    min_distance_deg : float
        Least angle between two new points.
    forward_backward_px : float
        A point is lost when tracking it back misses its start by more.
    window_px : int
        Side of the window that is compared.
    pyramid_levels : int
        Halvings of the image; each doubles the reach, about ``window_px / 2`` at level 0.
    redetect : bool
        Whether new corners replace lost points; their earlier frames are NaN.

    Raises
    ------
    FileNotFoundError
        If an image or the mask does not exist.
    ValueError
        If there are fewer than two images, their sizes differ, one is no picture, panoramas are
        not 2:1 or look like raw dual fisheye frames, or an option is out of range.

    Notes
    -----
    Shi and Tomasi, "Good Features to Track" (CVPR 1994); Bouguet's pyramidal form of Lucas and
    Kanade (IJCAI 1981); Kalal, Mikolajczyk and Matas, "Forward-Backward Error" (ICPR 2010).
    Corners are thinned on the sphere, where the stretched rows near the poles count for little.
    """
    options = _Options(
        max_features,
        quality_level,
        float(np.radians(min_distance_deg)),
        forward_backward_px,
        window_px,
        pyramid_levels,
        redetect,
    )
    if isinstance(images, str | os.PathLike):
        raise ValueError(f"images must be a sequence of images, got the single path {images}")
    frames = list(_keypoints_of_frames(images, camera, mask, options))
    if len(frames) < 2:
        raise ValueError(f"images must hold at least 2 images, got {len(frames)}")
    keypoints = np.full((len(frames), len(frames[-1]), 2), np.nan)
    for row, pixels in zip(keypoints, frames, strict=True):
        row[: len(pixels)] = pixels
    return Tracks(keypoints)


def _keypoints_of_frames(
    images: Iterable[ImageSource],
    camera: Camera | None,
    mask: ImageSource | None,
    options: _Options,
) -> Iterator[Array]:
    view: _View | None = None
    previous, pixels = np.empty((0, 0), dtype=np.uint8), np.empty((0, 2))
    for index, source in enumerate(images):
        image = read_image(source, name=f"images[{index}]")
        if view is None:
            view = _make_view(find_camera(source, image, camera, "images[0]"), mask, options)
        if image.shape[:2] != view.mask.shape:
            height, width = view.mask.shape
            raise ValueError(
                f"images[{index}] must be {width}x{height} like the camera and the images before "
                f"it, got {image.shape[1]}x{image.shape[0]}; resize it or track it separately"
            )
        current = view.pad(np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8))
        if index == 0:
            pixels = _detect(current, view, options, pixels)
        else:
            pixels = _next_frame(previous, current, pixels, view, options)
        yield pixels
        previous = current


def _make_view(camera: Camera, mask: ImageSource | None, options: _Options) -> _View:
    usable = camera.field_of_view_mask()
    if mask is not None:
        usable = usable & read_mask(mask, (camera.height, camera.width))
    # At the coarsest level: half a window for the patch and about half a window of motion.
    reach = min(camera.width // 2, options.window_px << options.pyramid_levels)
    return _View(camera, usable, margin=reach if camera.wraps else 0)


def _next_frame(
    previous: Picture, current: Picture, pixels: Array, view: _View, options: _Options
) -> Array:
    """Where each point of the previous frame is now, NaN when lost; new points at the end."""
    moved = np.full_like(pixels, np.nan)
    seen = np.isfinite(pixels).all(axis=1)
    moved[seen] = _follow(previous, current, pixels[seen], view, options)
    if options.redetect:
        moved = np.concatenate([moved, _detect(current, view, options, moved)])
    return moved


def _follow(
    previous: Picture, current: Picture, pixels: Array, view: _View, options: _Options
) -> Array:
    if len(pixels) == 0:
        return pixels
    start = view.padded_from_pixels(pixels)
    end, missed_px = follow_there_and_back(
        previous, current, start, options.window_px, options.pyramid_levels
    )
    moved = view.pixels_from_padded(end)
    moved[~view.is_usable(moved) | (missed_px > options.forward_backward_px)] = np.nan
    return moved


def _detect(padded: Picture, view: _View, options: _Options, known: Array) -> Array:
    """Find new corners, best first, away from each other and from the known points."""
    known = known[np.isfinite(known).all(axis=1)]
    wanted = options.max_features - len(known)
    if wanted <= 0:
        return np.empty((0, 2))
    usable = erode_mask(view.pad(view.mask.astype(np.uint8)), options.window_px)
    usable[:, : view.margin] = 0
    usable[:, usable.shape[1] - view.margin :] = 0
    corners, _ = find_corners(padded, usable, options.quality_level)
    pixels = view.pixels_from_padded(corners)
    bearings = view.camera.bearings_from_pixels(pixels)
    taken = view.camera.bearings_from_pixels(known)
    return pixels[_spread(bearings, taken, options.min_distance_rad, wanted)]


def _spread(bearings: Array, taken: Array, distance_rad: float, count: int) -> list[int]:
    """Pick the first bearings that keep their distance from those taken and from each other."""
    # The chord of the angle: exact for small angles, where a cosine has no digits left.
    chord2 = 4 * np.sin(distance_rad / 2) ** 2
    left = np.flatnonzero(np.isfinite(bearings).all(axis=1))
    for bearing in taken:
        left = left[np.square(bearings[left] - bearing).sum(axis=1) >= chord2]
    chosen: list[int] = []
    while len(left) and len(chosen) < count:
        chosen.append(int(left[0]))
        left = left[1:]
        left = left[np.square(bearings[left] - bearings[chosen[-1]]).sum(axis=1) >= chord2]
    return chosen
