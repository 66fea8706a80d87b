# SPDX-License-Identifier: BSD-3-Clause
"""Cameras that give the bearings of others with changed angles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from epi360.cameras.base import Array, Camera, FocalCamera
from epi360.cameras.changed_angles import AngleModel, angles_of
from epi360.cameras.equirectangular import Equirectangular
from epi360.cameras.kannala_brandt import KannalaBrandt
from epi360.cameras.pinhole import Pinhole

_GRID = 41  # pixels along each side, of which some are in the circle of a fisheye
_MOST_ERROR_PX = 0.5
_EDGES = (1.0, 0.9, 0.8, 0.75)  # of the widest angle
_ANGLES_DEG = (90, 60, 30, 15, 5)  # from the axis of a lens, to say what they are
_SAME_DEG = 1e-9
OF_LENS = ("degrees from the axis", "focal length")  # in what is said of a lens, and of no panorama


def changed_panorama(camera: Equirectangular, changes: Array) -> Equirectangular:
    """Panorama whose longitudes and latitudes are changed, as far as the sphere goes.

    ``changes`` (3,) are those of `AngleModel.directions`.
    """
    around = min(camera.horizontal_fov_deg * (1.0 + float(changes[0])), 360.0)
    high = min(camera.vertical_fov_deg * (1.0 + float(changes[1])), 180.0)
    room = 90.0 - high / 2.0
    middle = camera.center_latitude_deg - float(np.degrees(changes[2]))
    return replace(
        camera,
        horizontal_fov_deg=around,
        vertical_fov_deg=high,
        center_latitude_deg=min(max(middle, -room), room),
    )


def changed_lens(camera: Camera, changes: Array) -> KannalaBrandt | Pinhole | None:
    """Lens of the same principal point whose angles from the axis are changed, and their curve.

    ``changes`` (1, 2 or 3,) are those of `AngleModel.directions`; two where the curve may change,
    three where it may at the edge. Another focal length of a pinhole makes a pinhole. Other lenses
    may end up to a quarter before the given one, as that of a calibration that does not say where
    the lens ends. None if no `KannalaBrandt` is within half a pixel of the changed rays, or the
    camera is no lens.
    """
    if not isinstance(camera, FocalCamera):
        return None
    model = AngleModel.of(camera, is_curved=len(changes) == 2, is_bent=len(changes) == 3)
    if model.angles == "focal" and isinstance(camera, Pinhole):
        # Rounded to a millionth of a pixel, so that another processor makes no other camera.
        fx, fy = (round(focal / (1.0 + float(changes[0])), 6) for focal in (camera.fx, camera.fy))
        return replace(camera, fx=fx, fy=fy)
    pixels = _pixels_all_over(camera)
    bearings = camera.bearings_from_pixels(pixels)
    seen = np.isfinite(bearings).all(axis=1)
    x, y, z = angles_of(model, bearings[seen]).changed(changes).bearings.T
    angles = np.arctan2(np.hypot(x, y), z)
    middle, focal = np.array([camera.cx, camera.cy]), np.array([camera.fx, camera.fy])
    radii = np.hypot(*((pixels[seen] - middle) / focal).T)
    for edge in angles.max() * np.array(_EDGES):
        inside = angles <= edge
        powers = angles[inside, None] ** np.arange(1, 10, 2)
        solved = np.linalg.lstsq(powers, radii[inside], rcond=None)[0]
        scale, errors = float(solved[0]), powers @ solved - radii[inside]
        if scale > 0.0 and np.abs(errors).max() * focal.max() < _MOST_ERROR_PX:
            break
    else:
        return None
    k1, k2, k3, k4 = np.round(solved[1:] / scale, 9).tolist()
    edge_deg = min(math.degrees(edge) + 1e-6, 180.0)
    return KannalaBrandt(
        camera.width,
        camera.height,
        round(camera.fx * scale, 6),
        round(camera.fy * scale, 6),
        camera.cx,
        camera.cy,
        k1,
        k2,
        k3,
        k4,
        max_angle_deg=round(edge_deg, 6),
    )


def what_changed(given: Camera, now: Camera) -> str:
    """What the angles of a camera are now, and not, in words."""
    if isinstance(given, Equirectangular) and isinstance(now, Equirectangular):
        parts = [
            (now.horizontal_fov_deg, given.horizontal_fov_deg, "{:.1f} degrees around, not {:.6g}"),
            (now.vertical_fov_deg, given.vertical_fov_deg, "{:.1f} degrees high, not {:.6g}"),
            (
                now.center_latitude_deg,
                given.center_latitude_deg,
                "its middle row at a latitude of {:.1f} degrees, not {:.6g}",
            ),
        ]
        return ", ".join(
            words.format(*both) for *both, words in parts if abs(both[0] - both[1]) > _SAME_DEG
        )
    if isinstance(given, Pinhole) and isinstance(now, Pinhole):
        return f"a focal length of {now.fx:.1f} pixels, not {given.fx:.6g}"
    bearings = given.bearings_from_pixels(_pixels_all_over(given))
    widest = bearings[np.nanargmin(bearings[:, 2])]  # towards there most angles are in the picture
    out = np.array([*widest[:2], 0.0]) / np.hypot(*widest[:2])
    taken = np.radians(_ANGLES_DEG)[:, None]
    pixels = given.pixels_from_bearings(np.sin(taken) * out + np.cos(taken) * [0.0, 0.0, 1.0])
    x, y, z = now.bearings_from_pixels(pixels).T
    seen = np.degrees(np.arctan2(np.hypot(x, y), z))
    shown = [each for each in zip(seen, _ANGLES_DEG, strict=True) if np.isfinite(each[0])][1::-1]
    are = " and ".join(f"{angle:.1f}" for angle, _ in shown)
    return f"{are} degrees from the axis, not {' and '.join(str(angle) for _, angle in shown)}"


def _pixels_all_over(camera: Camera) -> Array:
    across, down = (
        np.linspace(0.5, size - 0.5, _GRID, dtype=np.float64)
        for size in (camera.width, camera.height)
    )
    return np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
