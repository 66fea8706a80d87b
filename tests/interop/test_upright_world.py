# SPDX-License-Identifier: BSD-3-Clause
"""Where down is in a world, by the cameras that stand in it."""

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.interop import Observations, PosedImage, Reconstruction
from epi360.interop.upright_world import down_in_world, mean_down, moved, upright_from_world
from epi360.poses import Pose, rotation_from_vector

IDENTITY = Pose(np.eye(3), np.zeros(3))


def about(axis, degrees):
    return rotation_from_vector(np.radians(degrees) * np.asarray(axis, dtype=float))


@pytest.mark.parametrize("down", [(0, 1, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0.6, 0, 0.8)])
def test_down_becomes_plus_y_by_the_smallest_rotation(down):
    turn = upright_from_world(np.array(down, dtype=float))
    np.testing.assert_allclose(turn.rotation @ down, [0, 1, 0], atol=1e-15)
    angle_deg = np.degrees(np.arccos((np.trace(turn.rotation) - 1) / 2))
    assert angle_deg == pytest.approx(np.degrees(np.arccos(down[1])), abs=1e-5)


def test_cameras_that_lean_to_all_sides_agree_on_the_middle():
    """Tilted by 20 degrees to the front at headings all around: the mean is down exactly."""
    rotations = [about((1, 0, 0), 20) @ about((0, 1, 0), heading) for heading in range(0, 360, 60)]
    np.testing.assert_allclose(mean_down(rotations), [0, 1, 0], atol=1e-12)


def test_nothing_is_said_where_cameras_disagree_or_have_no_pose():
    rolled = [about((0, 0, 1), roll) for roll in range(0, 360, 60)]
    assert mean_down(rolled) is None
    assert mean_down([]) is None
    assert mean_down([np.full((3, 3), np.nan)]) is None
    np.testing.assert_array_equal(mean_down([np.full((3, 3), np.nan), np.eye(3)]), [0, 1, 0])


def test_cameras_of_a_rig_say_what_the_rig_says():
    """One camera of two lies on its side."""
    rig = {"upright": IDENTITY, "side": Pose(about((0, 0, 1), 90), np.zeros(3))}
    images = tuple(PosedImage(name, name, rig[name], frame="1") for name in rig)
    cameras = dict.fromkeys(rig, Equirectangular(100, 50))
    np.testing.assert_allclose(
        down_in_world(Reconstruction(cameras, images, cam_from_rig=rig)), [0, 1, 0], atol=1e-12
    )


def test_a_moved_world_shows_the_same_in_every_image():
    rng = np.random.default_rng(0)
    pose = Pose(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3))
    points = rng.normal(size=(5, 3))
    seen = Observations(np.arange(5), np.zeros(5, np.int64), np.ones((5, 2)))
    before = Reconstruction(
        {"p": Equirectangular(100, 50)},
        (PosedImage("a", "p", pose, 3.0),),
        points,
        np.zeros((5, 3), np.uint8),
        seen,
    )
    after = moved(before, Pose(rotation_from_vector([1, 2, 3]), np.array([4.0, 5, 6])))
    (image,) = after.images
    in_camera = after.points @ image.cam_from_world.rotation.T + image.cam_from_world.translation
    np.testing.assert_allclose(in_camera, points @ pose.rotation.T + pose.translation, atol=1e-12)
    assert image.timestamp_s == 3.0 and after.observations is seen
