# SPDX-License-Identifier: BSD-3-Clause
"""What camera models have in common: pixels to bearings and back."""

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Every real lens has numbers within these bounds, and within them no formula overflows.
LARGEST_SIZE = 10**7
LARGEST_NUMBER = 1e12
SMALLEST_POSITIVE = 1e-9
BORDER_TOLERANCE_PX = 1e-9  # a pixel on the border stays in the image after rounding


@dataclass(frozen=True)
class Camera(ABC):
    """Central camera: each pixel looks along one direction, all through one point.

    Frame: x right, y down, z forward. Pixels are continuous: the centre of the top-left pixel is
    (0.5, 0.5), the image is the rectangle [0, width] x [0, height].

    Parameters
    ----------
    width, height : int
        Size of the image in pixels.

    Raises
    ------
    ValueError
        If a parameter is not a number or out of its range.
    """

    width: int
    height: int

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            converted = checked_size if field.name in ("width", "height") else _finite_number
            object.__setattr__(self, field.name, converted(value, field.name))

    @property
    def wraps(self) -> bool:
        """Whether a pixel row goes all around, so that its right end continues at the left."""
        return False

    def bearings_from_pixels(self, pixels: ArrayLike) -> Array:
        """Return the directions in which pixels look, as unit vectors (N, 3).

        Parameters
        ----------
        pixels : array_like, shape (N, 2)
            Continuous pixels (u, v), also outside the image; the class says which have a ray. A row
            is NaN if its pixel is not finite or has no ray.

        Raises
        ------
        ValueError
            If ``pixels`` has another shape.
        """
        u, v = _finite_columns(pixels, 2, "pixels")
        return self._bearings(u, v)

    def pixels_from_bearings(self, bearings: ArrayLike) -> Array:
        """Return the pixels (u, v) that look in given directions, shape (N, 2).

        Parameters
        ----------
        bearings : array_like, shape (N, 3)
            Directions of any length. A row of the result is NaN if its direction is outside the
            field of view, not finite or of zero length.

        Raises
        ------
        ValueError
            If ``bearings`` has another shape.
        """
        x, y, z = _finite_columns(bearings, 3, "bearings")
        no_direction = (x == 0) & (y == 0) & (z == 0)
        pixels = self._pixels(x, y, z)
        pixels[no_direction] = np.nan
        return pixels

    def bearing_jacobians(self, pixels: ArrayLike) -> Array:
        """Return the first derivatives of the unit bearings with respect to the pixels.

        ``jacobians[i, j, k]`` = d bearing_j / d pixel_k of row i in 1/px, with shape (N, 3, 2);
        NaN if the bearing is NaN. ``pixels`` of another shape than (N, 2) raise ``ValueError``.
        """
        u, v = _finite_columns(pixels, 2, "pixels")
        return self._jacobians(u, v)

    def field_of_view_mask(self) -> NDArray[np.bool_]:
        """Return whether the centre of each pixel has a ray, shape (height, width)."""
        return np.ones((self.height, self.width), dtype=np.bool_)

    @abstractmethod
    def _bearings(self, u: Array, v: Array) -> Array:
        """Bearings (N, 3), unit length, of finite or NaN pixels."""

    @abstractmethod
    def _pixels(self, x: Array, y: Array, z: Array) -> Array:
        """Pixels (N, 2) of finite or NaN directions of any length; may overwrite its input."""

    @abstractmethod
    def _jacobians(self, u: Array, v: Array) -> Array:
        """Jacobians (N, 3, 2) at finite or NaN pixels."""

    def _keep_inside(self, pixels: Array) -> Array:
        """Set pixels outside the image to NaN, in place, and move those off by rounding to it."""
        for column, size in ((pixels[:, 0], self.width), (pixels[:, 1], self.height)):
            inside = (column >= -BORDER_TOLERANCE_PX) & (column <= size + BORDER_TOLERANCE_PX)
            pixels[~inside] = np.nan
            np.clip(column, 0.0, size, out=column)
        return pixels


@dataclass(frozen=True)
class FocalCamera(Camera):
    """Camera whose pixels are points of a plane, scaled: u = fx x + cx, v = fy y + cy."""

    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive(self, "fx", "fy")

    def _plane_points(self, u: Array, v: Array) -> tuple[Array, Array]:
        return (u - self.cx) / self.fx, (v - self.cy) / self.fy

    def _plane_grid(self) -> tuple[Array, Array]:
        """Points of the plane, without distortion, of all columns (1, W) and of all rows (H, 1)."""
        u, v = (np.arange(size, dtype=np.float64) + 0.5 for size in (self.width, self.height))
        return (u[None, :] - self.cx) / self.fx, (v[:, None] - self.cy) / self.fy

    def _pixels_of_plane(self, x: Array, y: Array) -> Array:
        return np.column_stack([self.fx * x + self.cx, self.fy * y + self.cy])


def check_positive(camera: Camera, *names: str) -> None:
    """Raise ``ValueError`` if one of these parameters of ``camera`` is not positive."""
    for name in names:
        if getattr(camera, name) < SMALLEST_POSITIVE:
            raise ValueError(f"{name} must be positive, got {getattr(camera, name)}")


def checked_size(value: object, name: str) -> int:
    """Return a size in pixels as an int; raise ``ValueError`` unless it is positive."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value <= 0:
        raise ValueError(f"{name} must be a positive integer number of pixels, got {value!r}")
    size = int(value)
    if size > LARGEST_SIZE:
        raise ValueError(f"{name} must be at most {LARGEST_SIZE} pixels, got more")
    return size


def _finite_number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    number = int(value) if isinstance(value, Integral) else float(value)
    if not abs(number) <= LARGEST_NUMBER:
        too_large = isinstance(number, int) or np.isfinite(number)  # integers have no infinity
        got = f"one above {LARGEST_NUMBER:g}" if too_large else repr(number)
        raise ValueError(f"{name} must be a finite number, got {got}")
    return float(number)


def _finite_columns(array: ArrayLike, count: int, name: str) -> list[Array]:
    """Return contiguous columns of an (N, count) array.

    Rows that are not finite, or of which a masked array hides a number, become NaN.
    """
    try:
        if isinstance(array, np.ma.MaskedArray):
            array = np.ma.filled(array.astype(np.float64), np.nan)
        rows = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be numbers of shape (N, {count}): {error}") from None
    if rows.ndim != 2 or rows.shape[1] != count:
        raise ValueError(f"{name} must have shape (N, {count}), got {rows.shape}")
    columns = np.array(rows.T, order="C")
    columns[:, ~np.isfinite(columns).all(axis=0)] = np.nan
    return list(columns)
