# SPDX-License-Identifier: BSD-3-Clause
"""How uncertain the points of a map are, by the rays that see them."""

import numpy as np

from epi360.cameras import Equirectangular
from epi360.interop.reconstruction import Observations, PosedImage, Reconstruction
from epi360.jobs.localization.point_errors import point_covariances
from epi360.poses import Pose

CAMERA = Equirectangular(2048, 1024)


def model_of(points, seen):
    """Images at (k, 0, 0) that see points (pairs of rows), half a pixel off."""
    images = [
        PosedImage(str(k), "1", Pose(np.eye(3), np.array([-float(k), 0.0, 0.0]))) for k in range(2)
    ]
    rows, owners = np.array(seen).T
    rays = points[rows] - np.column_stack([owners, 0 * owners, 0 * owners])
    pixels = CAMERA.pixels_from_bearings(rays) + [0.3, -0.4]
    colors = np.zeros((len(points), 3), np.uint8)
    observations = Observations(rows, owners, pixels)
    return Reconstruction({"1": CAMERA}, tuple(images), points, colors, observations)


def test_the_depth_of_points_that_one_image_sees_is_open():
    points = np.random.default_rng(0).normal(size=(300, 3)) * [2.0, 3.0, 4.0]
    model = model_of(points, [(k, 0) for k in range(300)])
    covariances = point_covariances(model)
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    along = np.einsum("ni,nij,nj->n", rays, covariances, rays)
    assert (along > 1e9 * (np.trace(covariances, axis1=1, axis2=2) - along)).all()


def test_two_rays_that_meet_know_the_point_and_nothing_is_known_of_others():
    points = np.array([[0.5, 0.0, 1.0], [0.0, 5.0, 0.0]])
    with np.errstate(all="raise"):
        covariances = point_covariances(model_of(points, [(0, 0), (0, 1)]))
    assert 0.0 < np.trace(covariances[0]) < 1e-4
    assert not covariances[1].any()
