# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360.cameras import Equirectangular, KannalaBrandt, Pinhole
from epi360.poses import Pose
from epi360.synthetic.landmarks import rotation_from_euler
from epi360_scenes import demo_pair, furnished_room
from epi360_scenes.raycast import Solids, nearest_hits
from epi360_scenes.room import _built

CAMERA = Equirectangular(width=128, height=64)


def generator(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def pixel_centers(camera):
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack([u.ravel(), v.ravel()], axis=1)


@pytest.fixture(scope="module")
def room():
    return furnished_room(0)


@pytest.fixture(scope="module")
def pair():
    return demo_pair(width=256)


def test_a_seed_makes_the_same_room_and_another_seed_another(room):
    pose = Pose(np.eye(3), np.array([0.2, -1.5, -0.4]))
    assert furnished_room(0) is room  # the last ones are kept
    _built.cache_clear()
    first, again, other = (
        r.render(CAMERA, pose) for r in (room, furnished_room(0), furnished_room(1))
    )
    np.testing.assert_array_equal(first.image, again.image)
    np.testing.assert_array_equal(first.depth, again.depth)
    assert (first.image != other.image).mean() > 0.5
    assert (first.depth != other.depth).mean() > 0.01


def test_the_number_of_threads_does_not_change_the_picture(room):
    pose = room.sample_pose(generator())
    camera = Equirectangular(width=300, height=150)  # several tiles, some of them cut
    one, five = (room.render(camera, pose, num_threads=n) for n in (1, 5))
    np.testing.assert_array_equal(one.image, five.image)
    np.testing.assert_array_equal(one.depth, five.depth)


def test_leaving_out_solids_beside_a_bundle_of_rays_changes_no_hit(room):
    origin = room.sample_pose(generator(4)).translation
    directions = CAMERA.bearings_from_pixels(pixel_centers(CAMERA))
    ranges, solid = nearest_hits(room.solids, origin, directions)  # all around: nothing left out
    for start in range(0, len(directions), 16):
        few = slice(start, start + 16)
        narrow_ranges, narrow_solid = nearest_hits(room.solids, origin, directions[few])
        np.testing.assert_array_equal(narrow_ranges, ranges[few])
        np.testing.assert_array_equal(narrow_solid, solid[few])


def test_depth_is_the_distance_to_hand_made_walls_boxes_and_balls():
    # A room of 6 x 2.7 x 5 m, a box of 1 m turned by 45 deg at z = 2, a ball of 0.5 m at x = 2.
    solids = Solids(
        box_centers=np.array([[0, -1.35, 0], [0, -1.35, 2]]),
        box_halves=np.array([[3, 1.35, 2.5], [0.5, 0.5, 0.5]]),
        box_yaws=np.array([0, np.pi / 4]),
        box_shadows=np.array([False, True]),
        ellipsoid_centers=np.array([[2, -1.35, 0]]),
        ellipsoid_radii=np.array([[0.5, 0.5, 0.5]]),
    )
    s = np.sqrt(0.5)
    directions = np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [-s, 0, -s]]
    )
    ranges, solid = nearest_hits(solids, np.array([0, -1.35, 0]), directions)
    np.testing.assert_allclose(
        ranges, [1.5, 3, 1.35, 1.35, 2 - np.sqrt(0.5), 2.5, 2.5 / s], atol=1e-6
    )
    np.testing.assert_array_equal(solid, [2, 0, 0, 0, 1, 0, 0])
    points = np.array([[0, -1.35, 0], [2, -1.35, 0], [0, -1.35, 2], [-3.5, -1.35, 0]])
    np.testing.assert_allclose(
        solids.distances(points), [2 - np.sqrt(0.5), -0.5, -0.5, -0.5], atol=0.16
    )


def test_the_floor_of_the_furnished_room_is_where_it_should_be(room):
    position = np.array([0.3, -1.5, 0.0])
    view = room.render(CAMERA, Pose(np.eye(3), position))
    bearings = CAMERA.bearings_from_pixels(pixel_centers(CAMERA))
    points = position + bearings * view.depth.reshape(-1, 1)
    # Height 0 is the floor, 12 mm the top of the rug; nothing lies below or outside the walls.
    assert abs(points[:, 1].max()) < 1e-5
    assert points[:, 1].min() > -2.7 - 1e-5
    assert np.abs(points[:, 0]).max() < 3 + 1e-5 and np.abs(points[:, 2]).max() < 2.5 + 1e-5


def warped_to_view_2(pair):
    """Pixels, bearings and ranges in view 2 of the surface points that view 1 sees."""
    camera, pose = pair.camera, pair.cam2_from_cam1
    bearings1 = camera.bearings_from_pixels(pixel_centers(camera))
    points2 = bearings1 * pair.depth1.reshape(-1, 1) @ pose.rotation.T + pose.translation
    return bearings1, points2, camera.pixels_from_bearings(points2)


def test_matches_made_from_depth_obey_the_epipolar_law(pair):
    bearings1, points2, pixels2 = warped_to_view_2(pair)
    bearings2 = pair.camera.bearings_from_pixels(pixels2)
    x, y, z = pair.cam2_from_cam1.translation
    E = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ pair.cam2_from_cam1.rotation
    residuals = np.einsum("ni,ij,nj->n", bearings2, E, bearings1)
    np.testing.assert_allclose(residuals, 0, atol=1e-6)


def test_both_views_agree_on_the_range_of_what_both_see(room):
    # Rays of camera 2 are cast exactly through the warped points, so that no interpolation of
    # depth blurs the comparison: an occluded point is nearer, no point may be farther.
    rng = generator(3)
    for _ in range(4):
        pose1, pose2 = room.sample_pose(rng), room.sample_pose(rng)
        bearings = CAMERA.bearings_from_pixels(pixel_centers(CAMERA))
        depth1 = room.render(CAMERA, pose1, supersample=1).depth.reshape(-1, 1)
        world = (bearings * depth1) @ pose1.rotation.T + pose1.translation
        rays = world - pose2.translation
        expected = np.linalg.norm(rays, axis=1)
        ranges, _ = nearest_hits(room.solids, pose2.translation, rays / expected[:, None])
        assert (ranges - expected).max() < 1e-3
        visible = np.abs(ranges - expected) < 1e-3
        occluded = ranges < expected - 0.01
        assert np.mean(visible[~occluded]) > 0.99
        assert np.mean(visible) > 0.6


def test_two_depth_images_agree_after_warping(pair):
    _, points2, pixels2 = warped_to_view_2(pair)
    column, row = np.floor(pixels2).astype(int).T
    height, width = pair.depth2.shape
    column, row = column % width, np.minimum(row, height - 1)
    # The neighbour pixel's centre is up to half a pixel (0.7 deg here) away: compare the warped
    # point with the plane through the pixel's neighbours, where they do lie on one plane.
    inverse = 1 / pair.depth2
    smooth = np.zeros(inverse.shape, bool)
    bend_u = np.abs(inverse[:, :-2] + inverse[:, 2:] - 2 * inverse[:, 1:-1])[1:-1]
    bend_v = np.abs(inverse[:-2] + inverse[2:] - 2 * inverse[1:-1])[:, 1:-1]
    smooth[1:-1, 1:-1] = (bend_u < 1e-3) & (bend_v < 1e-3)
    step_v, step_u = np.gradient(inverse)
    du, dv = (pixels2 - np.floor(pixels2) - 0.5).T
    at_point = inverse[row, column] + du * step_u[row, column] + dv * step_v[row, column]
    error = 1 / at_point - np.linalg.norm(points2, axis=1)
    comparable = smooth[row, column] & (error > -0.03)
    assert comparable.mean() > 0.5
    assert np.mean(np.abs(error[comparable]) < 0.005) > 0.95


def test_a_picture_is_the_same_seen_by_a_panorama_and_by_a_pinhole(room):
    pose = room.sample_pose(generator(5))
    pinhole = Pinhole(64, 48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)
    panorama = Equirectangular(width=1024, height=512)
    view, around = room.render(pinhole, pose), room.render(panorama, pose, supersample=1)
    pixels = panorama.pixels_from_bearings(pinhole.bearings_from_pixels(pixel_centers(pinhole)))
    column, row = np.floor(pixels).astype(int).T
    seen = around.depth[row, column].reshape(view.depth.shape)
    assert np.median(np.abs(view.depth - seen)) < 0.01
    colors = around.image[row, column].reshape(view.image.shape).astype(int)
    assert np.median(np.abs(view.image - colors)) < 6  # of 255: the filters differ in size


def test_pixels_without_a_ray_are_black_with_depth_zero(room):
    fisheye = KannalaBrandt(96, 96, fx=28.0, fy=28.0, cx=48.0, cy=48.0, max_angle_deg=97.0)
    view = room.render(fisheye, room.sample_pose(generator(1)))
    mask = fisheye.field_of_view_mask()
    assert 0.5 < mask.mean() < 0.95
    assert (view.depth[~mask] == 0).all() and (view.depth[mask] > 0).all()
    corners = np.zeros_like(mask)
    corners[:4, :4] = True
    assert (view.image[corners] == 0).all()
    bearings = fisheye.bearings_from_pixels(pixel_centers(fisheye))
    assert np.nanmin(bearings[:, 2]) < 0  # it does look behind itself


def test_turning_the_camera_about_the_vertical_moves_the_picture_sideways(room):
    pose = Pose(np.eye(3), np.array([0.2, -1.5, -0.4]))
    turn = rotation_from_euler(np.array([0.0, np.pi / 2, 0.0]))
    straight = room.render(CAMERA, pose)
    turned = room.render(CAMERA, Pose(turn, pose.translation))
    quarter = CAMERA.width // 4
    shifted = np.roll(straight.depth, -quarter, axis=1)
    # A few rays graze an edge, where rounding decides which side they see.
    assert np.mean(np.abs(turned.depth - shifted) < 1e-4) > 0.995


def test_supersampling_changes_only_pixels_at_edges(room):
    pose = room.sample_pose(generator(2))
    hard, soft = (room.render(CAMERA, pose, supersample=n) for n in (1, 3))
    np.testing.assert_array_equal(hard.depth, soft.depth)
    changed = np.any(hard.image != soft.image, axis=2).mean()
    assert 0.05 < changed < 0.8


def test_sampled_poses_keep_their_clearance(room):
    rng = generator()
    poses = [room.sample_pose(rng, clearance_m=0.6) for _ in range(50)]
    positions = np.array([pose.translation for pose in poses])
    assert room.solids.distances(positions).min() >= 0.6
    assert positions[:, 1].min() >= -1.7 and positions[:, 1].max() <= -1.2
    down = np.array([pose.rotation[1, 1] for pose in poses])
    assert np.degrees(np.arccos(down)).max() < 7.1  # sqrt(2) times 5 deg


def test_the_demo_pair_is_a_step_and_a_turn_apart(pair):
    assert pair.image1.shape == pair.image2.shape == (128, 256, 3)
    assert pair.image1.dtype == np.uint8 and pair.depth1.dtype == np.float32
    assert 0.5 < np.linalg.norm(pair.cam2_from_cam1.translation) < 1.0
    angle = np.degrees(np.arccos((np.trace(pair.cam2_from_cam1.rotation) - 1) / 2))
    assert 20 < angle < 65
    assert pair.depth1.min() > 0.3
    assert 90 < pair.image1.mean() < 200  # well exposed


def test_a_camera_in_the_wall_is_refused(room):
    with pytest.raises(ValueError, match=r"camera at \[9.0, -1.5, 0.0\], inside a solid"):
        room.render(CAMERA, Pose(np.eye(3), np.array([9.0, -1.5, 0.0])))
    with pytest.raises(ValueError, match="inside a solid or outside the room"):
        room.render(CAMERA, Pose.nan())


def test_wrong_options_are_named(room):
    pose = room.sample_pose(generator())
    with pytest.raises(ValueError, match="supersample must be 1 or more, got 0"):
        room.render(CAMERA, pose, supersample=0)
    with pytest.raises(ValueError, match="num_threads must be 1 or more, got 0"):
        room.render(CAMERA, pose, num_threads=0)
    with pytest.raises(ValueError, match="width must be a positive even number, got 101"):
        demo_pair(width=101)
    with pytest.raises(ValueError, match="no place that free"):
        room.sample_pose(generator(), clearance_m=3.0)
