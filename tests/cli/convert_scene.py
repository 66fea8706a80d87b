# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of `epi360 convert` convert, and how they look at the answer."""

import numpy as np

from epi360.cameras import Equirectangular
from epi360.interop import Observations, PosedImage, Reconstruction
from epi360.poses import Pose, rotation_from_vector

CAMERA = Equirectangular(360, 180)


def scene():
    """Three panoramas, five points around them, each seen by all."""
    rng = np.random.default_rng(0)
    images = tuple(
        PosedImage(
            f"hall/{index}.jpg",
            "1",
            Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)),
        )
        for index in range(3)
    )
    points = 5 * rng.normal(size=(5, 3))
    colors = rng.integers(0, 256, (5, 3)).astype(np.uint8)
    rows, columns = np.repeat(np.arange(5), 3), np.tile(np.arange(3), 5)
    pixels = [
        CAMERA.pixels_from_bearings(
            [images[image].cam_from_world.rotation @ points[point]
             + images[image].cam_from_world.translation]
        )[0]
        for point, image in zip(rows, columns, strict=True)
    ]  # fmt: skip
    observations = Observations(rows, columns, np.array(pixels))
    return Reconstruction({"1": CAMERA}, images, points, colors, observations)


def refused(answer, *parts):
    code, out, err = answer
    assert (code, out) == (2, "")
    assert err.startswith("epi360: error: ") and "\n" not in err
    for part in parts:
        assert part in err


def assert_same_poses(before, after):
    for one, other in zip(before.images, after.images, strict=True):
        np.testing.assert_allclose(
            one.cam_from_world.matrix(), other.cam_from_world.matrix(), atol=1e-9
        )
