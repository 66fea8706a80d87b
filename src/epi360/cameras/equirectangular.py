# SPDX-License-Identifier: BSD-3-Clause
"""The equirectangular panorama, the whole sphere or a part of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from epi360.cameras.base import Array, Camera, check_positive

RANGE_TOLERANCE_DEG = 1e-9
ASPECT_TOLERANCE = 0.005  # of 2:1; exporters round the size to multiples of 8 or 16 pixels
POLE_TOLERANCE = 1e-15  # below this distance from the axis the longitude is rounding error


@dataclass(frozen=True)
class Equirectangular(Camera):
    """Panorama whose columns are longitudes and whose rows are latitudes.

    The defaults make it the full sphere: the longitude is 2 pi u / W - pi, the latitude
    pi / 2 - pi v / H and the bearing (cos lat sin lon, -sin lat, cos lat cos lon), so that the
    image centre looks along +z. A part of a panorama keeps the frame of the whole one: longitude 0
    is +z wherever the part lies, and a pixel has the same bearing in the part and in the whole.

    A panorama that is 360 degrees wide wraps: any finite u has a ray, and ``pixels_from_bearings``
    gives u in [0, width). Rows above and below the image have no ray; if the panorama is narrower,
    nothing outside the image has one. At a pole, where every longitude is right,
    ``pixels_from_bearings`` gives the column of longitude 0, or the column nearest to it.

    Parameters
    ----------
    width, height : int
        Size of the image in pixels.
    horizontal_fov_deg, vertical_fov_deg : float
        Longitudes and latitudes that the image spans, up to 360 and 180.
    center_longitude_deg, center_latitude_deg : float
        Direction of the image centre; longitudes grow to the right, latitudes upwards.

    Raises
    ------
    ValueError
        If a size or field of view is out of range, or latitudes go beyond a pole.
    """

    horizontal_fov_deg: float = 360.0
    vertical_fov_deg: float = 180.0
    center_longitude_deg: float = 0.0
    center_latitude_deg: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "horizontal_fov_deg", "vertical_fov_deg")
        for name, limit in (("horizontal_fov_deg", 360), ("vertical_fov_deg", 180)):
            if getattr(self, name) > limit:
                raise ValueError(f"{name} must be at most {limit}, got {getattr(self, name)}")
        lowest = self.center_latitude_deg - self.vertical_fov_deg / 2
        highest = self.center_latitude_deg + self.vertical_fov_deg / 2
        if max(-lowest, highest) > 90 + RANGE_TOLERANCE_DEG:
            raise ValueError(
                "latitudes must stay between the poles, -90 to 90, but center_latitude_deg="
                f"{self.center_latitude_deg} and vertical_fov_deg={self.vertical_fov_deg} "
                f"span {lowest} to {highest}"
            )

    @classmethod
    def for_image(cls, width: int, height: int) -> Equirectangular:
        """Return the camera of a full panorama of this size in pixels; 2:1 within half a percent.

        Raises
        ------
        ValueError
            If the image is not 2:1, and so no full panorama with square pixels.
        """
        camera = cls(width, height)
        if abs(width - 2 * height) > ASPECT_TOLERANCE * 2 * height:
            raise ValueError(
                f"equirectangular image must be 2:1, got {width}x{height}; give its field of view "
                "with a camera file, or use KannalaBrandt for a fisheye"
            )
        return camera

    @property
    def wraps(self) -> bool:
        """Whether a pixel row goes all around, so that its right end continues at the left."""
        return self.horizontal_fov_deg >= 360

    @property
    def _rad_per_px(self) -> tuple[float, float]:
        return (
            np.deg2rad(self.horizontal_fov_deg) / self.width,
            np.deg2rad(self.vertical_fov_deg) / self.height,
        )

    def _angles(self, u: Array, v: Array) -> tuple[Array, Array]:
        """Longitudes and latitudes in radians, NaN where the image has no such pixel."""
        per_column, per_row = self._rad_per_px
        longitudes = (u - self.width / 2) * per_column
        longitudes += np.deg2rad(self.center_longitude_deg)
        latitudes = (self.height / 2 - v) * per_row
        latitudes += np.deg2rad(self.center_latitude_deg)
        outside = (v < 0) | (v > self.height)
        if not self.wraps:
            outside |= (u < 0) | (u > self.width)
        latitudes[outside] = np.nan
        longitudes[outside] = np.nan
        return longitudes, latitudes

    def _bearings(self, u: Array, v: Array) -> Array:
        longitudes, latitudes = self._angles(u, v)
        cos_latitudes = np.cos(latitudes)
        bearings = np.empty((len(u), 3))
        np.multiply(cos_latitudes, np.sin(longitudes), out=bearings[:, 0])
        np.negative(np.sin(latitudes), out=bearings[:, 1])
        np.multiply(cos_latitudes, np.cos(longitudes), out=bearings[:, 2])
        return bearings

    def _pixels(self, x: Array, y: Array, z: Array) -> Array:
        per_column, per_row = self._rad_per_px
        axis_distances = np.hypot(x, z)
        z += 0.0  # -0.0 becomes 0.0: the longitude of a pole is 0, not pi
        longitudes = np.arctan2(x, z)
        if self.center_longitude_deg != 0:
            longitudes -= np.deg2rad(self.center_longitude_deg)
            longitudes -= 2 * np.pi * np.round(longitudes / (2 * np.pi))
        latitudes = np.arctan2(-y, axis_distances)
        latitudes -= np.deg2rad(self.center_latitude_deg)
        pixels = np.empty((len(x), 2))
        pixels[:, 0] = longitudes / per_column + self.width / 2
        pixels[:, 1] = self.height / 2 - latitudes / per_row
        if self.wraps:
            columns = pixels[:, 0]
            columns[columns < 0] += self.width
            columns[columns >= self.width] -= self.width
        else:
            at_pole = axis_distances <= POLE_TOLERANCE * np.abs(y)
            pixels[at_pole, 0] = np.clip(pixels[at_pole, 0], 0, self.width)
        return self._keep_inside(pixels)

    def _jacobians(self, u: Array, v: Array) -> Array:
        per_column, per_row = self._rad_per_px
        longitudes, latitudes = self._angles(u, v)
        sin_longitudes, cos_longitudes = np.sin(longitudes), np.cos(longitudes)
        sin_latitudes, cos_latitudes = per_row * np.sin(latitudes), np.cos(latitudes)
        jacobians = np.empty((len(u), 3, 2))
        jacobians[:, 0, 0] = per_column * cos_latitudes * cos_longitudes
        jacobians[:, 1, 0] = 0.0 * latitudes  # NaN stays NaN
        jacobians[:, 2, 0] = -per_column * cos_latitudes * sin_longitudes
        jacobians[:, 0, 1] = sin_latitudes * sin_longitudes
        jacobians[:, 1, 1] = per_row * cos_latitudes
        jacobians[:, 2, 1] = sin_latitudes * cos_longitudes
        return jacobians
