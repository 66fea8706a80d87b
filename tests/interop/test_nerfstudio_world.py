# SPDX-License-Identifier: BSD-3-Clause
"""The world of transforms.json: z is up, and nerfstudio is asked to leave it so."""

import json

import numpy as np

from epi360.cameras import Equirectangular, Pinhole
from epi360.interop.nerfstudio import read_nerfstudio, write_nerfstudio
from epi360.interop.reconstruction import PosedImage, Reconstruction
from epi360.jobs.cubes.cube_faces import CubemapOptions, cubemap_reconstruction
from epi360.poses import Pose, rotation_from_vector


def saved_poses(path):
    """World_from_camera of nerfstudio, as they stand in the file."""
    return np.array([each["transform_matrix"] for each in json.loads(path.read_text())["frames"]])


def test_tilted_worlds_are_saved_with_z_up(tmp_path):
    """Level panoramas in a world that is turned anyhow: each has its y axis (up) along z."""
    path = tmp_path / "transforms.json"
    rng = np.random.default_rng(3)
    level = [
        Pose(rotation_from_vector([0, heading, 0]), rng.normal(size=3)) for heading in range(6)
    ]
    tilt = Pose(rotation_from_vector([0.9, 0.5, -0.4]), np.zeros(3))
    images = tuple(PosedImage(f"{row}.jpg", "p", pose @ tilt) for row, pose in enumerate(level))
    write_nerfstudio(path, Reconstruction({"p": Equirectangular(360, 180)}, images))
    np.testing.assert_allclose(saved_poses(path)[:, :3, 1], [[0, 0, 1]] * 6, atol=1e-12)
    for before, after in zip(images, read_nerfstudio(path).images, strict=True):
        np.testing.assert_allclose(
            before.cam_from_world.matrix(), after.cam_from_world.matrix(), atol=1e-12
        )


def test_a_face_that_looks_down_does_not_tilt_the_scene(tmp_path):
    """Without "up", the mean of the five faces' own y axes would be off by 14 degrees."""
    path = tmp_path / "transforms.json"
    source = Reconstruction(
        {"p": Equirectangular(360, 180)},
        tuple(
            PosedImage(
                f"{heading}.jpg", "p", Pose(rotation_from_vector([0, heading, 0]), [0, 0, 1])
            )
            for heading in range(5)
        ),
    )
    faces = ("down", "front", "right", "back", "left")
    write_nerfstudio(path, cubemap_reconstruction(source, CubemapOptions(faces=faces)))
    poses = saved_poses(path)
    ups = poses[:, :3, 1].reshape(5, 5, 3)
    np.testing.assert_allclose(ups[:, 1:], np.broadcast_to([0, 0, 1], (5, 4, 3)), atol=1e-12)
    np.testing.assert_allclose(ups[:, 0, 2], 0, atol=1e-12)  # "down" looks along -z
    np.testing.assert_allclose(poses.reshape(5, 5, 4, 4)[:, 0, :3, 2], [[0, 0, 1]] * 5, atol=1e-12)


def test_cameras_that_agree_on_no_vertical_leave_the_world_to_nerfstudio(tmp_path):
    """A camera that looks straight down and turns about its axis has its y axis anywhere."""
    path = tmp_path / "transforms.json"
    images = tuple(
        PosedImage(
            f"{turn}.jpg", "p", Pose(rotation_from_vector([0, 0, turn * np.pi / 3]), [0, 0, 1])
        )
        for turn in range(6)
    )
    write_nerfstudio(path, Reconstruction({"p": Pinhole(64, 48, 50, 50, 32, 24)}, images))
    document = json.loads(path.read_text())
    assert "orientation_override" not in document
    assert document["applied_transform"] == np.eye(4)[:3].tolist()
