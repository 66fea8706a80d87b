# SPDX-License-Identifier: BSD-3-Clause
"""Landmarks cast from a depth image, as in section 5.1 of the Robust 360-8PA paper."""

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from epi360.cameras import Camera

Array = NDArray[np.float64]

Density = Literal["pixels", "sphere"]


def landmarks_from_depth(
    depth: ArrayLike,
    camera: Camera,
    num: int,
    rng: np.random.Generator,
    *,
    density: Density = "pixels",
) -> Array:
    """Points (num, 3) on the surfaces that a depth image shows, in metres in its camera's frame.

    Parameters
    ----------
    depth : array_like, shape (H, W)
        Range along the ray of each pixel's centre in metres; 0, NaN or infinite: none.
    camera : Camera
        Camera of the depth image.
    num : int
        Number of landmarks, of different pixels.
    rng : numpy.random.Generator
    density : {"pixels", "sphere"}
        "pixels" takes every pixel with the same probability, as the authors do: in a panorama the
        poles get more than their share. "sphere" weighs pixels by their solid angle.

    Raises
    ------
    ValueError
        If the image has another size than the camera, fewer than `num` pixels with a range, or
        `density` is unknown.
    """
    ranges = np.asarray(depth, dtype=np.float64)
    if ranges.shape != (camera.height, camera.width):
        raise ValueError(
            f"depth must have the camera's size {camera.width}x{camera.height}, "
            f"got shape {ranges.shape}"
        )
    if density not in get_args(Density):
        raise ValueError(f"density must be 'pixels' or 'sphere', got {density!r}")
    rows, columns = np.nonzero((ranges > 0) & np.isfinite(ranges) & camera.field_of_view_mask())
    if not 0 <= num <= len(rows):
        raise ValueError(f"num must be between 0 and the {len(rows)} pixels of known depth")
    weights = None if density == "pixels" else _solid_angles(camera, rows, columns)
    picked = rng.choice(len(rows), num, replace=False, p=weights)
    rows, columns = rows[picked], columns[picked]
    bearings = camera.bearings_from_pixels(np.stack([columns, rows], axis=1) + 0.5)
    return bearings * ranges[rows, columns][:, None]


def _solid_angles(camera: Camera, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
    jacobians = camera.bearing_jacobians(np.stack([columns, rows], axis=1) + 0.5)
    areas = np.linalg.norm(np.cross(jacobians[:, :, 0], jacobians[:, :, 1]), axis=1)
    return np.asarray(areas / areas.sum())
