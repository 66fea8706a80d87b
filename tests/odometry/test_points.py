# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from seen_points import directions, noisy, points_around

from epi360.odometry.points import triangulate_tracks
from epi360.poses import rotation_from_vector


def triangulate_rays(centers, rays):
    """Point of one track, and its parallax."""
    found = triangulate_tracks(centers, rays, np.zeros(len(rays), dtype=np.int64), 1)
    return found.points[0], found.parallax_rad[0]


def tracks(seed, num_tracks=50, noise_rad=0.0):
    """Centers, rays and track of each, shuffled, with the points."""
    rng = np.random.default_rng(seed)
    points = points_around(rng, num_tracks)
    track = rng.permutation(np.repeat(np.arange(num_tracks), rng.integers(2, 8, num_tracks)))
    centers = rng.normal(size=(len(track), 3))
    rays = points[track] - centers
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return centers, noisy(rng, rays, noise_rad), track, points


@pytest.mark.parametrize("seed", range(5))
def test_exact_rays_meet_in_their_points(seed):
    centers, rays, track, points = tracks(seed)
    found = triangulate_tracks(centers, rays, track, len(points))
    np.testing.assert_allclose(found.points, points, atol=1e-9)
    assert found.in_front.all() and found.residual_rad.max() < 1e-9


def test_one_track_alone_is_the_same():
    centers, rays, track, points = tracks(1, noise_rad=1e-3)
    found = triangulate_tracks(centers, rays, track, len(points))
    for k in range(len(points)):
        point, parallax = triangulate_rays(centers[track == k], rays[track == k])
        np.testing.assert_allclose(point, found.points[k], rtol=1e-9)
        np.testing.assert_allclose(parallax, found.parallax_rad[k], rtol=1e-9)


def test_right_angle_is_a_parallax_of_a_right_angle():
    point, parallax = triangulate_rays([[1, 0, 0], [0, 1, 0]], [[0, 1, 0], [1, 0, 0]])
    np.testing.assert_allclose(point, [1, 1, 0], atol=1e-12)
    np.testing.assert_allclose(parallax, np.pi / 2)


def test_widest_parallax_is_that_of_the_widest_pair():
    centers, rays, track, points = tracks(2)
    found = triangulate_tracks(centers, rays, track, len(points))
    for k in range(len(points)):
        own = rays[track == k]
        cosines = np.clip(own @ own.T, -1, 1)
        np.testing.assert_allclose(found.parallax_rad[k], np.arccos(cosines.min()), atol=1e-7)


def test_turned_shifted_and_scaled_world_moves_the_points():
    centers, rays, track, points = tracks(3, noise_rad=1e-3)
    R, shift, scale = rotation_from_vector([1.0, -2.0, 0.5]), np.array([100.0, 200, 50]), 7.0
    before = triangulate_tracks(centers, rays, track, len(points))
    after = triangulate_tracks(scale * centers @ R.T + shift, rays @ R.T, track, len(points))
    np.testing.assert_allclose(
        after.points, scale * before.points @ R.T + shift, rtol=1e-9, atol=1e-8
    )
    np.testing.assert_allclose(after.residual_rad, before.residual_rad, atol=1e-11)


def test_noise_of_rays_is_the_residual():
    centers, rays, track, points = tracks(4, 2000, noise_rad=1e-3)
    found = triangulate_tracks(centers, rays, track, len(points))
    assert np.median(np.linalg.norm(found.points - points, axis=1)) < 0.03
    assert 3e-4 < np.median(found.residual_rad) < 2e-3


def test_near_rays_count_more_than_far_ones():
    # Two rays from near and one from far away that misses by the same angle as they do.
    centers = np.array([[0.0, 0, 0], [1, 0, 0], [0, 100, 1]])
    target = np.array([0.0, 0, 1.0])
    rays = target - centers
    rays[2, 0] = 1.0
    point, _ = triangulate_rays(centers, rays)
    assert np.linalg.norm(point - target) < 0.05


def test_parallel_rays_and_single_rays_have_no_point():
    rays = np.tile([0.0, 0, 1], (3, 1))
    found = triangulate_tracks([[0, 0, 0], [1, 0, 0], [2, 0, 0]], rays, [0, 0, 1], 3)
    assert np.isnan(found.points).all() and not found.in_front.any()
    assert found.parallax_rad[0] == 0.0 and np.isnan(found.parallax_rad[1:]).all()


def test_rays_that_meet_behind_are_not_in_front():
    centers, rays, track, points = tracks(5)
    found = triangulate_tracks(centers, -rays, track, len(points))
    np.testing.assert_allclose(found.points, points, atol=1e-9)
    assert not found.in_front.any()


def test_missing_rays_are_left_out():
    centers, rays, track, points = tracks(6)
    rng = np.random.default_rng(0)
    more = np.full((30, 3), np.nan)
    found = triangulate_tracks(
        np.vstack([centers, rng.normal(size=(30, 3))]), np.vstack([rays, more]),
        np.append(track, rng.integers(0, len(points), 30)), len(points),
    )  # fmt: skip
    np.testing.assert_allclose(found.points, points, atol=1e-9)


def test_no_rays_give_no_points():
    found = triangulate_tracks(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=int), 2)
    assert np.isnan(found.points).all() and found.points.shape == (2, 3)


def test_tiny_parallax_gives_a_far_point_in_the_right_direction():
    rng = np.random.default_rng(7)
    for direction in directions(rng, 20):
        side = np.cross(direction, [0.3, 0.5, 0.8])
        centers = np.array([0 * side, 1e-4 * side])
        point, parallax = triangulate_rays(centers, direction - centers)
        assert parallax < 1e-4
        np.testing.assert_allclose(point, direction, atol=1e-6)


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match="one row a ray"):
        triangulate_tracks(np.zeros((2, 3)), np.ones((3, 3)), [0, 0, 0], 1)
    with pytest.raises(ValueError, match="track_index must hold whole numbers from 0 to 0"):
        triangulate_tracks(np.zeros((2, 3)), np.ones((2, 3)), [0, 1], 1)
