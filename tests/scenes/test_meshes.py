# SPDX-License-Identifier: BSD-3-Clause
import sys

import numpy as np
import pytest

from epi360.cameras import Equirectangular, Pinhole
from epi360.poses import Pose
from epi360.synthetic.landmarks import rotation_from_euler
from epi360_scenes import handheld_path
from epi360_scenes.meshes import load_mesh_scene

trimesh = pytest.importorskip("trimesh", reason="needs the extra render")
pytest.importorskip("embreex", reason="needs the extra render")

CAMERA = Equirectangular(width=128, height=64)
SIZE = np.array([5.0, 4.0, 2.6])  # a room with z up, its floor at 0
CENTER, RADIUS = np.array([1.2, 0.9, 0.7]), 0.4


def textured_room():
    """Box seen from inside; on every face a texture with four quadrants, stretched over it."""
    from PIL import Image

    box = trimesh.creation.box(extents=SIZE)
    box.apply_translation((0, 0, SIZE[2] / 2))
    corners = box.triangles.reshape(-1, 3)
    uv = []
    for triangle in box.triangles:
        flat = int(np.argmin(np.ptp(triangle, axis=0)))
        across, along = (axis for axis in range(3) if axis != flat)
        shares = (triangle - box.bounds[0]) / SIZE
        uv += [(share[across], share[along]) for share in shares]
    quadrants = np.zeros((64, 64, 3), np.uint8)
    quadrants[:32, :32], quadrants[:32, 32:] = (255, 0, 0), (0, 255, 0)
    quadrants[32:, :32], quadrants[32:, 32:] = (0, 0, 255), (255, 255, 0)
    looks = trimesh.visual.TextureVisuals(uv=np.array(uv), image=Image.fromarray(quadrants))
    faces = np.arange(len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners, faces, visual=looks, process=False)


def colored_ball():
    ball = trimesh.creation.icosphere(radius=RADIUS, subdivisions=4)
    colors = np.full((len(ball.vertices), 4), 255, np.uint8)
    colors[:, :3] = np.round(127.5 + 127.5 * ball.vertices / RADIUS)
    ball.visual.vertex_colors = colors
    ball.apply_translation(CENTER)
    return ball


@pytest.fixture(scope="module", params=["glb", "obj"])
def room(request, tmp_path_factory):
    """Room with a ball in it; OBJ files have one material here, so it is empty there."""
    folder = tmp_path_factory.mktemp("mesh")
    parts = [textured_room()] + ([colored_ball()] if request.param == "glb" else [])
    whole = trimesh.Scene(parts)
    path = folder / f"room.{request.param}"
    whole.export(path)
    return load_mesh_scene(path, up="+z")


def pixel_centers(camera):
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    return np.stack([u.ravel(), v.ravel()], axis=1)


def rays(camera, pose):
    return camera.bearings_from_pixels(pixel_centers(camera)) @ pose.rotation.T


def wall_ranges(position, directions):
    """Ranges to the inside of the room."""
    high = SIZE * (0.5, 0.5, 1.0)
    low = high - SIZE
    with np.errstate(divide="ignore"):
        ends = np.where(directions > 0, high - position, low - position) / directions
    return ends.min(axis=1)


def ball_ranges(position, directions):
    offset = position - CENTER
    b = directions @ offset
    discriminant = b * b - offset @ offset + RADIUS**2
    with np.errstate(invalid="ignore"):
        return np.where((discriminant > 0) & (b < 0), -b - np.sqrt(discriminant), np.inf)


POSE = Pose(rotation_from_euler(np.array([1.1, -0.4, 0.7])), np.array([-0.6, -0.3, 1.4]))


def test_ranges_are_those_of_the_walls_and_the_ball(room):
    depth = room.render(CAMERA, POSE).depth.ravel()
    position, directions = POSE.translation, rays(CAMERA, POSE)
    walls, ball = wall_ranges(position, directions), ball_ranges(position, directions)
    has_ball = len(room.faces) > 12
    on_ball = np.isfinite(ball) & has_ball
    # A ball of flat triangles: they lie up to 0.6 mm inside of it, more along grazing rays.
    passing = np.linalg.norm(np.cross(directions, CENTER - position), axis=1)
    clear = np.abs(passing - RADIUS) > 0.02
    np.testing.assert_allclose(depth[~on_ball & clear], walls[~on_ball & clear], atol=1e-5)
    if has_ball:
        assert np.sum(on_ball & clear) > 10
        np.testing.assert_allclose(depth[on_ball & clear], ball[on_ball & clear], atol=0.004)


def test_textures_are_the_right_way_up(room):
    # At z up, the wall at x = +2.5 shows v = height: the picture's upper half is high, y to u.
    hits = {(0.3, 0.7): (0, 255, 0), (-0.3, 0.7): (255, 0, 0), (-0.3, -0.7): (0, 0, 255)}
    position = np.array([1.9, 0.0, SIZE[2] / 2])
    for (y, z), color in hits.items():
        forward = np.array([0.6, y, z]) / np.linalg.norm([0.6, y, z])
        right = np.cross(forward, (0, 0, 1.0))
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        lens = Pinhole(9, 9, fx=90.0, fy=90.0, cx=4.5, cy=4.5)
        view = room.render(lens, Pose(rotation, position))
        # glTF multiplies with the material's factor, trimesh writes 40 %: compare directions.
        seen = view.image[4, 4] / view.image[4, 4].max()
        np.testing.assert_allclose(seen, np.array(color) / 255, atol=0.02)


def test_vertex_colors_are_interpolated(room):
    if len(room.faces) == 12:
        pytest.skip("the OBJ file holds no ball")
    view = room.render(CAMERA, POSE, supersample=1)
    directions = rays(CAMERA, POSE)
    points = POSE.translation + directions * view.depth.reshape(-1, 1)
    normals = (points - CENTER) / RADIUS
    on_ball = np.abs(np.linalg.norm(normals, axis=1) - 1) < 0.01
    expected = 127.5 + 127.5 * normals[on_ball]
    np.testing.assert_allclose(view.image.reshape(-1, 3)[on_ball], expected, atol=4)


def test_the_number_of_threads_does_not_change_a_picture(room):
    one, three = (room.render(CAMERA, POSE, num_threads=n) for n in (1, 3))
    np.testing.assert_array_equal(one.image, three.image)
    np.testing.assert_array_equal(one.depth, three.depth)


def test_rays_that_meet_nothing_are_black_with_depth_zero(tmp_path):
    colored_ball().export(tmp_path / "ball.ply")
    ball = load_mesh_scene(tmp_path / "ball.ply")
    pose = Pose(np.eye(3), CENTER - (0, 0, 2.0))
    view = ball.render(CAMERA, pose)
    hit = view.depth > 0
    expected = ball_ranges(pose.translation, rays(CAMERA, pose)).reshape(hit.shape)[hit]
    assert 0.005 < hit.mean() < 0.05  # a cap of 11.5 deg: 1 % of the sphere, more in pixels
    assert np.median(view.depth[hit] - expected) == pytest.approx(0, abs=0.002)
    # Smoothed edges bleed by one pixel.
    assert (view.image[~hit] == 0).mean() > 0.99


def test_distances_are_those_to_the_walls_and_negative_outside(room):
    points = np.array([[-2.0, 0.0, 1.3], [-1.0, -1.7, 1.0], [9.0, 0.0, 1.0]])
    near, corner, outside = room.distances(points)
    # The feelers are 15 deg apart: a wall may be missed by 8 deg, one percent of the range.
    assert near == pytest.approx(0.5, abs=0.01) and corner == pytest.approx(0.3, abs=0.01)
    assert outside < 0


def test_a_camera_is_carried_upright_through_a_mesh(room):
    path = handheld_path(room, 25, 1)
    positions = np.array([pose.translation for pose in path])
    assert room.distances(positions).min() >= 0.35
    assert abs(positions[:, 2].mean() - 1.5) < 0.2
    down = np.array([pose.rotation[:, 1] for pose in path])
    assert (down[:, 2] < -0.9).all()
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() <= 0.04 + 1e-12


@pytest.mark.parametrize("up, axis", [("+y", (0, 1, 0)), ("-z", (0, 0, -1))])
def test_the_axis_that_points_up_is_an_option(up, axis, tmp_path):
    colored_ball().export(tmp_path / "ball.ply")
    np.testing.assert_array_equal(load_mesh_scene(tmp_path / "ball.ply", up=up).up, axis)


def test_files_that_hold_no_mesh_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"mesh file .*none.glb does not exist"):
        load_mesh_scene(tmp_path / "none.glb")
    (tmp_path / "text.obj").write_text("v 0 0 0\n")
    with pytest.raises(ValueError, match=r"mesh file .*text.obj (holds no faces|cannot be read)"):
        load_mesh_scene(tmp_path / "text.obj")
    with pytest.raises(ValueError, match=r"up must be one of \+x, .* got 'z'"):
        load_mesh_scene(tmp_path / "text.obj", up="z")


def test_a_missing_extra_says_how_to_install_it(tmp_path, monkeypatch):
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match=r"need trimesh: pip install 'epi360\[render\]'"):
        load_mesh_scene(tmp_path / "a.obj")
