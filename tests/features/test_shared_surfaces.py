# SPDX-License-Identifier: BSD-3-Clause
"""Surfaces grow over all that two panoramas of a room share, and over little else."""

from functools import cache

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.features.shared_surfaces import LEAST_CONTRAST, grid, grow_surfaces, likeness_of
from epi360.features.shared_surfaces_reference import (
    grow_surfaces_reference,
    likeness_of_reference,
)
from epi360.features.warped_patches import Panorama
from epi360.poses import Pose, rotation_from_vector
from epi360_scenes import furnished_room

CAMERA = Equirectangular(1024, 512)
WORLD_FROM_CAM = [
    Pose(rotation_from_vector([0.0, 0.3, 0.0]), np.array([0.1, -1.5, -0.35])),
    Pose(rotation_from_vector([0.1, -1.2, 0.05]), np.array([0.45, -1.45, 0.1])),
]
SECOND_FROM_FIRST = WORLD_FROM_CAM[1].inverse() @ WORLD_FROM_CAM[0]
NUM_SEEDS = 40


@cache
def renderings():
    room = furnished_room(1)
    return [room.render(CAMERA, pose) for pose in WORLD_FROM_CAM]


@cache
def panoramas():
    return [Panorama.of(one.image) for one in renderings()]


def depth_at(side, directions):
    u, v = CAMERA.pixels_from_bearings(directions).T.astype(int)
    return renderings()[side].depth[np.clip(v, 0, CAMERA.height - 1), u % CAMERA.width]


def seen_by_both(side):
    """Cells that nothing hides in the other view, and their true depths."""
    pose = SECOND_FROM_FIRST if side == 0 else SECOND_FROM_FIRST.inverse()
    directions = grid().directions.astype(float)
    depths = depth_at(side, directions)
    seen = (depths[:, None] * directions) @ pose.rotation.T + pose.translation
    ranges = np.linalg.norm(seen, axis=1)
    return np.abs(depth_at(1 - side, seen / ranges[:, None]) / ranges - 1) < 0.03, depths


def seeds(side):
    visible, depths = seen_by_both(side)
    (cells,) = np.nonzero(visible)
    cells = cells[np.linspace(0, len(cells) - 1, NUM_SEEDS).astype(int)]
    return depths[cells, None] * grid().directions[cells]


@cache
def grown(side=0):
    pose = SECOND_FROM_FIRST if side == 0 else SECOND_FROM_FIRST.inverse()
    return grow_surfaces(panoramas()[side], panoramas()[1 - side], pose, seeds(side))


@pytest.mark.parametrize("side", [0, 1])
def test_a_few_points_grow_over_what_both_views_show(side):
    visible, depths = seen_by_both(side)
    surfaces = grown(side)
    textured = visible & (surfaces.contrasts > 2 * LEAST_CONTRAST)
    assert np.mean(surfaces.found[textured]) > 0.75
    right = np.abs(np.log(surfaces.depths[surfaces.found] / depths[surfaces.found])) < 0.1
    assert np.mean(right) > 0.85


def test_what_is_expected_lies_where_it_is_and_looks_the_same():
    visible, depths = seen_by_both(0)
    surfaces = grown()
    known = visible & (surfaces.expected_depths > 0)
    assert np.mean(np.abs(np.log(surfaces.expected_depths[known] / depths[known])) < 0.1) > 0.85
    assert np.mean(surfaces.expected_likeness[known] > 0.7) > 0.85


def test_of_a_wrong_pose_little_grows():
    turned = Pose(rotation_from_vector([0.0, 0.7, 0.0]), np.zeros(3)) @ SECOND_FROM_FIRST
    wrong = grow_surfaces(*panoramas(), turned, seeds(0))
    assert wrong.found.sum() < 0.3 * grown().found.sum()


def test_units_do_not_matter():
    larger = Pose(SECOND_FROM_FIRST.rotation, 8.0 * SECOND_FROM_FIRST.translation)
    surfaces = grow_surfaces(*panoramas(), larger, 8.0 * seeds(0))
    both = surfaces.found & grown().found
    assert np.mean(surfaces.found == grown().found) > 0.99
    gaps = np.log(surfaces.depths[both] / 8.0 / grown().depths[both])
    assert np.mean(np.abs(gaps) < 1e-5) > 0.99


def test_nothing_grows_on_a_bare_wall():
    bare = Panorama.of(np.full((512, 1024, 3), 128, np.uint8))
    assert not grow_surfaces(bare, panoramas()[1], SECOND_FROM_FIRST, seeds(0)).found.any()


def test_no_seeds_and_no_cells_are_no_trouble():
    assert not grow_surfaces(*panoramas(), SECOND_FROM_FIRST, np.empty((0, 3))).found.any()
    nothing = np.empty(0, np.int64), np.empty(0), np.empty((0, 3))
    assert len(likeness_of(*panoramas(), SECOND_FROM_FIRST, *nothing)) == 0


def test_the_core_compares_patches_as_the_equations_do():
    cells = np.arange(0, 6000, 37)
    _, depths = seen_by_both(0)
    normals = np.tile([0.0, 1.0, 0.0], (len(cells), 1))
    arguments = (*panoramas(), SECOND_FROM_FIRST, cells, depths[cells], normals)
    found, expected = likeness_of(*arguments), likeness_of_reference(*arguments)
    textured = grown().contrasts[cells] > 2 * LEAST_CONTRAST
    np.testing.assert_allclose(found[textured], expected[textured], atol=0.02)


def test_the_core_grows_as_the_equations_do():
    start = seeds(0)[:6]
    found = grow_surfaces(*panoramas(), SECOND_FROM_FIRST, start)
    expected = grow_surfaces_reference(*panoramas(), SECOND_FROM_FIRST, start, most_cells=250)
    agree = found.depths[expected.found] / expected.depths[expected.found]
    assert expected.found.sum() > 200
    assert np.mean(np.abs(np.log(np.maximum(agree, 1e-9))) < 0.05) > 0.9
