# SPDX-License-Identifier: BSD-3-Clause
"""What other angles of a camera are, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from epi360.cameras import Camera, Equirectangular
from epi360.estimation.angle_changes import AngleChange

Array = NDArray[np.float64]


def change_in_words(
    each: AngleChange, found: Sequence[AngleChange], images: str, camera: Camera
) -> str:
    """What is changed, and by how much, of the ``images`` of a camera, as "both images".

    ``found`` are all changes of the matches; the curve of a lens is told with its angles.
    """
    own = [one for one in found if one.view == each.view]
    if any(one.direction == "curve" for one in own):
        return angles_in_words(images, camera, np.array([one.change for one in own]))
    if each.direction == "focal":
        longer = 1.0 / (1.0 + each.change) - 1.0
        sigma = each.sigma / (1.0 + each.change) ** 2
        what = "longer" if longer > 0.0 else "shorter"
        return f"the focal length of {images} is {abs(longer):.1%} {what} (1 sigma {sigma:.1%})"
    if not isinstance(camera, Equirectangular):
        what = "larger" if each.change > 0.0 else "smaller"
        amount = f"{abs(each.change):.1%} {what} (1 sigma {each.sigma:.1%})"
        return f"angles from the axis of {images} are {amount}"
    if each.direction == "middle":
        latitude = camera.center_latitude_deg - np.degrees(each.change)
        return (
            f"the middle row of {images} is at a latitude of {latitude:.1f} degrees, not "
            f"{camera.center_latitude_deg:.6g} (1 sigma {np.degrees(each.sigma):.1f})"
        )
    is_wide = each.direction == "horizontal"
    degrees = camera.horizontal_fov_deg if is_wide else camera.vertical_fov_deg
    spans = f"{degrees * (1.0 + each.change):.1f} degrees {'around' if is_wide else 'high'}"
    sigma_deg = degrees * each.sigma
    return f"{images} {_verb(images)} {spans}, not {degrees:.6g} (1 sigma {sigma_deg:.1f})"


def angles_in_words(images: str, camera: Camera, changes: Array) -> str:
    """What all angles of the ``images`` of a camera must be, by its ``changes`` (k,)."""
    if isinstance(camera, Equirectangular):
        given = np.array([camera.horizontal_fov_deg, camera.vertical_fov_deg])
        around, high = given * (1.0 + changes[:2])
        middle = camera.center_latitude_deg - np.degrees(changes[2])
        return (
            f"{images} {_verb(images)} {around:.1f} degrees around and {high:.1f} high, with the "
            f"middle at a latitude of {middle:.1f}"
        )
    given = np.array([30.0, 60.0])
    powers = np.radians(given)[:, None] ** np.array([0.0, 2.0])
    first, second = given * (1.0 + powers @ changes)
    return (
        f"what is taken for 30 and 60 degrees from the axis of {images} is {first:.1f} and "
        f"{second:.1f} degrees"
    )


def _verb(images: str) -> str:
    return "are" if images.startswith("both") else "is"
