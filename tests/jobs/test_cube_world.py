# SPDX-License-Identifier: BSD-3-Clause
"""The world of the files that a cubemap has: up is up, and rigs, points and pixels go with it."""

import json

import numpy as np
import pytest
from cube_inputs import PANORAMA, direction_colors, pixel_centres, write_png

from epi360 import cli
from epi360.cameras import KannalaBrandt
from epi360.interop import (
    Observations,
    PosedImage,
    Reconstruction,
    read_colmap_model,
    read_nerfstudio,
    write_colmap_model,
)
from epi360.interop.colmap_model_rigs import keeps_rigs
from epi360.interop.upright_world import DOWN, made_upright, moved
from epi360.jobs.cubes.cube_faces import CubemapOptions
from epi360.jobs.cubes.cubemap import export_cubemap
from epi360.poses import Pose, rotation_from_vector

TILT = Pose(rotation_from_vector([0.4, 0.3, -0.5]), np.zeros(3))  # of the world
FISHEYE = KannalaBrandt(200, 200, 60.0, 60.0, 100.0, 100.0, 0, 0, 0, 0, max_angle_deg=95)
HORIZONTAL = CubemapOptions(faces=("front", "right", "back", "left"), image_format="png")


def level_panoramas():
    """Four level panoramas at different headings, and the 40 points that they see."""
    rng = np.random.default_rng(5)
    points = 3 * rng.normal(size=(40, 3))
    images, pixels = [], []
    for number in range(4):
        turn = rotation_from_vector([0.0, 0.9 * number, 0.0])
        pose = Pose(turn, -turn @ [0.4 * number, 0.0, 0.1])
        images.append(PosedImage(f"{number}.png", "p", pose))
        pixels.append(PANORAMA.pixels_from_bearings(points @ pose.rotation.T + pose.translation))
    seen = Observations(
        np.tile(np.arange(40), 4), np.repeat(np.arange(4), 40), np.concatenate(pixels)
    )
    colors = np.zeros((40, 3), np.uint8)
    return Reconstruction({"p": PANORAMA}, tuple(images), points, colors, seen)


def tilted_panoramas():
    return moved(level_panoramas(), TILT)


def exported(tmp_path, source, options=HORIZONTAL, **more):
    for image in source.images:
        camera = source.cameras[image.camera]
        picture = direction_colors(camera.bearings_from_pixels(pixel_centres(camera)), camera)
        write_png(tmp_path / "in" / image.name, picture)
    cube = export_cubemap(tmp_path / "in", source, tmp_path / "out", options, **more)
    return cube, read_colmap_model(tmp_path / "out" / "sparse" / "0")


def assert_same_world(one, other):
    for before, after in zip(one.images, other.images, strict=True):
        np.testing.assert_allclose(
            before.cam_from_world.matrix(), after.cam_from_world.matrix(), atol=1e-12
        )
    np.testing.assert_allclose(one.points, other.points, atol=1e-6)  # a PLY has single precision


def test_faces_of_a_tilted_world_stand_upright_in_the_model(tmp_path):
    """Down is +y, which COLMAP's viewers take for down: to 1e-12 in every level face."""
    cube, model = exported(tmp_path, tilted_panoramas())
    for image in model.images:
        np.testing.assert_allclose(image.cam_from_world.rotation @ DOWN, DOWN, atol=1e-12)
    assert cube.turned_deg == pytest.approx(np.degrees(np.arccos(TILT.rotation[1, 1])))


def test_model_points_and_transforms_are_in_one_world(tmp_path):
    cube, model = exported(tmp_path, tilted_panoramas())
    assert_same_world(model, cube.reconstruction)
    assert_same_world(model, read_nerfstudio(tmp_path / "out" / "transforms.json"))
    seen = model.observations
    assert len(seen.points) > 100
    for point, index, pixel in zip(seen.points, seen.images, seen.pixels, strict=True):
        pose = model.images[index].cam_from_world
        ray = pose.rotation @ model.points[point] + pose.translation
        pinhole = model.cameras[model.images[index].camera]
        np.testing.assert_allclose(pinhole.pixels_from_bearings(ray[None])[0], pixel, atol=1e-9)


def test_the_record_leads_back_to_the_given_world(tmp_path):
    source = tilted_panoramas()
    _, model = exported(tmp_path, source)
    record = json.loads((tmp_path / "out" / "cubemap.json").read_text())
    upright_from_world = np.array(record["upright_from_world"])
    assert upright_from_world.shape == (3, 4)
    back = model.points @ upright_from_world[:, :3]
    distances = np.linalg.norm(back[:, None] - source.points[None], axis=2)
    assert distances.min(axis=1).max() < 1e-12


def test_faces_stay_on_their_rig_when_the_world_turns(tmp_path):
    _, model = exported(tmp_path, tilted_panoramas())
    assert keeps_rigs(model) and len(model.cam_from_rig) == 4
    assert len({image.frame for image in model.images}) == 4


def test_lenses_of_a_rig_that_lie_on_their_side_do_not_tilt_the_world(tmp_path):
    """The first lens of a rig stands upright, the second lies on its side."""
    side = Pose(rotation_from_vector([0.0, 0.0, np.pi / 2]), np.array([0.2, 0.0, 0.0]))
    rig = {"a": Pose(np.eye(3), np.zeros(3)), "b": side}
    images = tuple(
        PosedImage(f"{name}{image.name}", name, rig[name] @ image.cam_from_world, None, image.name)
        for image in tilted_panoramas().images
        for name in rig
    )
    source = Reconstruction({"a": FISHEYE, "b": FISHEYE}, images, cam_from_rig=rig)
    _, model = exported(tmp_path, source, CubemapOptions(faces=("front",), face_size=32))
    upright = [image for image in model.images if image.name.startswith("a")]
    assert len(upright) == 4 and keeps_rigs(model)
    for image in upright:
        np.testing.assert_allclose(image.cam_from_world.rotation @ DOWN, DOWN, atol=1e-12)


def test_the_world_is_kept_on_demand(tmp_path):
    source = tilted_panoramas()
    cube, model = exported(tmp_path, source, keep_world=True)
    assert cube.turned_deg == 0.0
    front = {image.name: image.cam_from_world for image in model.images}
    for image in source.images:
        name = image.name.replace(".png", "_front.png")
        np.testing.assert_allclose(front[name].matrix(), image.cam_from_world.matrix(), atol=1e-12)
    assert_same_world(model, read_nerfstudio(tmp_path / "out" / "transforms.json"))


def test_a_world_that_is_upright_keeps_every_digit():
    source = level_panoramas()
    same, turn = made_upright(source)
    assert same is source and np.array_equal(turn.rotation, np.eye(3))
    almost = moved(source, Pose(rotation_from_vector([1e-12, 0.0, 0.0]), np.zeros(3)))
    assert made_upright(almost)[0] is almost


def test_a_world_without_a_vertical_is_kept():
    """Cameras that lie on all sides say nothing."""
    poses = [Pose(rotation_from_vector([0.0, 0.0, roll]), np.zeros(3)) for roll in range(6)]
    images = tuple(PosedImage(f"{row}.png", "p", pose) for row, pose in enumerate(poses))
    source = Reconstruction({"p": PANORAMA}, images)
    assert made_upright(source)[0] is source


def test_the_command_says_that_it_turned_the_world_and_can_leave_it(tmp_path, capsys):
    source = tilted_panoramas()
    exported(tmp_path, source)
    write_colmap_model(tmp_path / "model", source)
    words = ["cubemap", str(tmp_path / "model"), str(tmp_path / "in")]
    assert cli.main([*words, str(tmp_path / "turned")]) == 0
    assert "turned the world upright, by 36.5 degrees" in capsys.readouterr().out
    assert cli.main([*words, str(tmp_path / "kept"), "--keep-world"]) == 0
    assert "turned" not in capsys.readouterr().out
    kept = read_colmap_model(tmp_path / "kept" / "sparse" / "0")
    assert np.linalg.norm(kept.images[0].cam_from_world.rotation @ DOWN - DOWN) > 0.5
