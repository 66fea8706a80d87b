# SPDX-License-Identifier: BSD-3-Clause
"""Surfaces are recognised at the place where another panorama must show them."""

from functools import cache

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.features.sphere_cells import even_directions
from epi360.features.warped_patches import Panorama, likeness
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

CAMERA = Equirectangular(768, 384)
WORLD_FROM_CAM = [
    Pose(rotation_from_vector([0.0, 0.3, 0.0]), np.array([0.1, -1.5, -0.35])),
    Pose(rotation_from_vector([0.1, -1.2, 0.05]), np.array([0.45, -1.45, 0.1])),
]
SECOND_FROM_FIRST = WORLD_FROM_CAM[1].inverse() @ WORLD_FROM_CAM[0]


@cache
def renderings():
    room = furnished_room(1)
    return [room.render(CAMERA, pose) for pose in WORLD_FROM_CAM]


def visible_points():
    """Points of the first view that nothing hides in the second, and their distances."""
    directions = even_directions(1500)
    directions = directions[np.abs(directions[:, 1]) < 0.8]
    depths = [rendering.depth for rendering in renderings()]
    points = directions * depth_at(depths[0], directions)[:, None]
    seen = points @ SECOND_FROM_FIRST.rotation.T + SECOND_FROM_FIRST.translation
    distances = np.linalg.norm(seen, axis=1)
    shown = depth_at(depths[1], seen / distances[:, None])
    return points[np.abs(distances / shown - 1) < 0.02]


def depth_at(depth, directions):
    u, v = CAMERA.pixels_from_bearings(directions).T.astype(int)
    return depth[np.clip(v, 0, CAMERA.height - 1), u % CAMERA.width]


def facing(points):
    return (points / np.linalg.norm(points, axis=1, keepdims=True))[None]


def textured(points, pose=SECOND_FROM_FIRST, *, gain=1.0):
    """Likeness of all points that do not lie on bare walls."""
    first, second = (one.image for one in renderings())
    changed = np.clip(gain * second, 0, 255).astype(np.uint8)
    alike, contrast = likeness(
        Panorama.of(first), Panorama.of(changed), points, pose, facing(points)
    )
    return alike[contrast > 8]


@pytest.mark.parametrize("gain", [1.0, 0.6])
def test_what_both_see_is_found_whatever_the_exposure(gain):
    alike = textured(visible_points(), gain=gain)
    assert len(alike) > 200
    assert np.mean(alike > 0.7) > 0.85


def test_other_places_do_not_look_the_same():
    turned = Pose(rotation_from_vector([0.0, 0.7, 0.0]), np.zeros(3)) @ SECOND_FROM_FIRST
    assert np.mean(textured(visible_points(), turned) > 0.7) < 0.25


def test_at_another_distance_less_is_found():
    points = visible_points()
    assert np.mean(textured(0.6 * points) > 0.7) < np.mean(textured(points) > 0.7) - 0.3


def test_units_do_not_matter():
    points, pose = visible_points(), SECOND_FROM_FIRST
    larger = Pose(pose.rotation, 7.0 * pose.translation)
    np.testing.assert_allclose(textured(7.0 * points, larger), textured(points), atol=1e-3)


def test_no_points_are_no_trouble():
    assert len(textured(np.empty((0, 3)))) == 0
