# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt
from epi360.synthetic import landmarks_from_depth

CAMERA = Equirectangular(width=64, height=32)


def generator(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def test_landmarks_lie_on_the_rays_of_their_pixels_at_their_ranges():
    depth = generator(1).uniform(1, 5, (32, 64))
    points = landmarks_from_depth(depth, CAMERA, 300, generator())
    u, v = np.floor(CAMERA.pixels_from_bearings(points)).astype(int).T
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), depth[v, u], atol=1e-12)
    centers = CAMERA.bearings_from_pixels(np.stack([u, v], axis=1) + 0.5)
    np.testing.assert_allclose(centers * depth[v, u][:, None], points, atol=1e-12)
    assert len(np.unique(points, axis=0)) == 300  # each pixel once


def test_pixels_without_depth_or_ray_are_never_taken():
    depth = np.zeros((32, 64), np.float32)
    depth[10, 5:9], depth[20, 3], depth[21, 3] = 2.0, np.nan, np.inf
    points = landmarks_from_depth(depth, CAMERA, 4, generator())
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 2.0, atol=1e-12)
    with pytest.raises(ValueError, match="num must be between 0 and the 4 pixels of known depth"):
        landmarks_from_depth(depth, CAMERA, 5, generator())
    fisheye = KannalaBrandt(48, 48, fx=14.0, fy=14.0, cx=24.0, cy=24.0, max_angle_deg=95.0)
    seen = landmarks_from_depth(np.ones((48, 48)), fisheye, 500, generator())
    assert np.isfinite(seen).all()


def test_pixels_of_a_panorama_favour_the_poles_and_solid_angles_do_not():
    camera = Equirectangular(width=400, height=200)
    depth = np.ones((200, 400))
    high = {}
    for density in ("pixels", "sphere"):
        points = landmarks_from_depth(depth, camera, 8000, generator(), density=density)
        high[density] = np.mean(np.abs(points[:, 1]) > np.sin(np.pi / 3))
    # Above 60 deg of latitude: a third of the rows, 1 - sin(60 deg) = 13.4 % of the sphere. Drawing
    # a tenth of the pixels without replacement takes the larger ones a little less often.
    assert high["pixels"] == pytest.approx(1 / 3, abs=0.02)
    assert high["sphere"] == pytest.approx(1 - np.sin(np.pi / 3), abs=0.02)


def test_a_seed_takes_the_same_landmarks():
    depth = np.ones((32, 64))
    first, again, other = (
        landmarks_from_depth(depth, CAMERA, 20, generator(seed)) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_wrong_sizes_and_densities_are_named():
    with pytest.raises(ValueError, match=r"camera's size 64x32, got shape \(64, 32\)"):
        landmarks_from_depth(np.ones((64, 32)), CAMERA, 1, generator())
    with pytest.raises(ValueError, match="density must be 'pixels' or 'sphere', got 'rows'"):
        landmarks_from_depth(np.ones((32, 64)), CAMERA, 1, generator(), density="rows")
