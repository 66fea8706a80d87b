# SPDX-License-Identifier: BSD-3-Clause
"""What a detector searches instead of the image itself: views without seam, poles or black rims."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular

Array = NDArray[np.float64]

# The rows around the horizon are searched as they are (pixels stretched by at most 1.5), two square
# faces see the rest: as many right matches on real pairs as six cube faces, at 0.6 of their pixels.
STRIP_LATITUDE_DEG = 47.0
FACE_LATITUDE_DEG = 43.0  # the overlap: a key point near the border is found by one of the two
_MARGIN_DEG = 9.0  # context around a view's own part, for the descriptors' windows
_SLACK_PX = 2  # by which a mask may be larger than what it stands for


@dataclass(frozen=True)
class View:
    """A picture to search, and how its pixels map back to the searched image."""

    picture: NDArray[np.uint8]
    mask: NDArray[np.uint8] | None

    def to_image(self, pixels: Array) -> tuple[Array, NDArray[np.bool_], Array]:
        """Pixels of the image, which of them this view reports, and their relative scale."""
        return pixels, np.ones(len(pixels), dtype=bool), np.ones(len(pixels))

    def reported(self) -> NDArray[np.uint8] | None:
        """Mask of the pixels that this view reports and some more, so that no others are described.

        None stands for all.
        """
        return self.mask


@dataclass(frozen=True)
class Strip(View):
    """Rows around the horizon, continued across the seam."""

    camera: Equirectangular
    padding: int
    top: int

    def to_image(self, pixels: Array) -> tuple[Array, NDArray[np.bool_], Array]:
        """Report each column once, and the latitudes around the horizon."""
        moved = pixels + [-self.padding, self.top]
        height = self.camera.height
        own = (moved[:, 0] >= 0) & (moved[:, 0] < self.camera.width)
        degrees_per_row = self.camera.vertical_fov_deg / height
        latitude = self.camera.center_latitude_deg + (height / 2 - moved[:, 1]) * degrees_per_row
        return moved, own & (np.abs(latitude) < STRIP_LATITUDE_DEG), np.ones(len(pixels))

    def reported(self) -> NDArray[np.uint8]:
        """White where `to_image` reports."""
        camera, (height, width) = self.camera, self.picture.shape
        rows_per_degree = camera.height / camera.vertical_fov_deg
        horizon = camera.height / 2 + camera.center_latitude_deg * rows_per_degree - self.top
        reach = STRIP_LATITUDE_DEG * rows_per_degree + _SLACK_PX
        mask = np.zeros((height, width), np.uint8)
        rows = slice(max(0, int(horizon - reach)), max(0, int(horizon + reach) + 1))
        columns = slice(self.padding - _SLACK_PX, self.padding + camera.width + _SLACK_PX)
        mask[rows, columns] = 255
        return mask


@dataclass(frozen=True)
class Face(View):
    """A perspective view of a pole."""

    camera: Equirectangular
    rotation: Array  # panorama from face
    focal: float

    def to_image(self, pixels: Array) -> tuple[Array, NDArray[np.bool_], Array]:
        """Report the cap beyond FACE_LATITUDE_DEG."""
        centred = (pixels - self.picture.shape[0] / 2.0) / self.focal
        rays = np.column_stack([centred, np.ones(len(centred))])
        lengths = np.linalg.norm(rays, axis=1)
        bearings = (rays / lengths[:, None]) @ self.rotation.T
        own = np.abs(bearings[:, 1]) > np.sin(np.radians(FACE_LATITUDE_DEG))
        moved = self.camera.pixels_from_bearings(bearings)
        return moved, own & np.isfinite(moved).all(axis=1), 1.0 / lengths

    def reported(self) -> NDArray[np.uint8]:
        """White where `to_image` reports."""
        size = len(self.picture)
        radius = self.focal * np.tan(np.radians(90.0 - FACE_LATITUDE_DEG)) + _SLACK_PX
        from_middle = np.square(np.arange(size) + 0.5 - size / 2.0)
        inside = from_middle[:, None] + from_middle[None, :] < radius**2
        return np.asarray(inside, np.uint8)


def search_views(grey: NDArray[np.uint8], camera: Camera) -> Iterator[View]:
    """Views that together show what the camera sees: strip and pole faces of a full panorama."""
    height, width = grey.shape
    if not isinstance(camera, Equirectangular):
        yield View(grey, _lens_mask(camera, height, width))
        return
    scaled = Equirectangular(
        width, height, camera.horizontal_fov_deg, camera.vertical_fov_deg,
        camera.center_longitude_deg, camera.center_latitude_deg,
    )  # fmt: skip
    if not camera.wraps:
        yield View(grey, None)
        return
    strip = _strip(grey, scaled)
    if strip is not None:
        yield strip
    for sign in (1.0, -1.0):
        if scaled.vertical_fov_deg / 2 + sign * scaled.center_latitude_deg > STRIP_LATITUDE_DEG:
            yield _face(grey, scaled, sign)


def _lens_mask(camera: Camera, height: int, width: int) -> NDArray[np.uint8] | None:
    """Field of view less its rim, where key points are artefacts of the lens's edge."""
    visible = camera.field_of_view_mask()
    if visible.all():
        return None
    mask = cv2.resize(255 * visible.astype(np.uint8), (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.erode(mask, np.ones((7, 7), np.uint8), borderValue=255), dtype=np.uint8)


def _strip(grey: NDArray[np.uint8], camera: Equirectangular) -> Strip | None:
    height, width = grey.shape
    rows_per_degree = height / camera.vertical_fov_deg
    reach = (STRIP_LATITUDE_DEG + _MARGIN_DEG) * rows_per_degree
    horizon = height / 2 + camera.center_latitude_deg * rows_per_degree
    top, bottom = max(0, round(horizon - reach)), min(height, round(horizon + reach))
    if bottom - top < 16:  # a panorama of the ceiling or the floor alone
        return None
    padding = max(16, round(_MARGIN_DEG * width / 360.0))
    rows = grey[top:bottom]
    strip = cv2.copyMakeBorder(rows, 0, 0, padding, padding, cv2.BORDER_WRAP)
    return Strip(np.asarray(strip, np.uint8), None, camera, padding, top)


def _face(grey: NDArray[np.uint8], camera: Equirectangular, sign: float) -> Face:
    """View of the zenith (sign +1) or the nadir (-1) at the panorama's resolution."""
    focal = camera.width / np.radians(camera.horizontal_fov_deg)
    half_angle = 90.0 - FACE_LATITUDE_DEG + _MARGIN_DEG / 2
    size = 2 * int(np.ceil(focal * np.tan(np.radians(half_angle))))
    u, v = _face_map(camera, size, focal, sign)
    picture = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    # Panorama from face: the face's z axis is the pole, its x axis the panorama's.
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -sign], [0.0, sign, 0.0]])
    return Face(np.asarray(picture, dtype=np.uint8), None, camera, rotation, focal)


@lru_cache(maxsize=4)  # both images of a pair, two poles each
def _face_map(
    camera: Equirectangular, size: int, focal: float, sign: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where each pixel of a face lies in the panorama, for cv2.remap (centres at integers)."""
    axis = (np.arange(size) + 0.5 - size / 2.0).astype(np.float32) / np.float32(focal)
    x, y = np.meshgrid(axis, axis)
    # The face's ray (x, y, 1) is (x, -sign, sign * y) in the panorama.
    longitude = np.degrees(np.arctan2(x, np.float32(sign) * y))
    latitude = np.degrees(np.arctan2(np.float32(sign), np.hypot(x, y)))
    turned = (longitude - camera.center_longitude_deg) / camera.horizontal_fov_deg
    u = (turned - np.floor(turned + 0.5) + 0.5) * camera.width - 0.5
    down = (camera.center_latitude_deg - latitude) / camera.vertical_fov_deg + 0.5
    v = np.clip(down * camera.height - 0.5, 0.0, camera.height - 1.0)
    return u.astype(np.float32), v.astype(np.float32)
