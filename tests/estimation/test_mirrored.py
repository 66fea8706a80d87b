# SPDX-License-Identifier: BSD-3-Clause
"""A mirrored image has no pose: many of its matches would lie behind the cameras."""

import numpy as np
import pytest
from noisy_problems import noisy_scene

from epi360 import estimate_relative_pose


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_a_mirrored_image_has_no_pose_and_is_named(axis, seed):
    scene = noisy_scene(seed, 0.06, 0.3)
    mirror = np.ones(3)
    mirror[axis] = -1.0
    assert estimate_relative_pose(scene.bearings1, scene.bearings2).success
    result = estimate_relative_pose(scene.bearings1, mirror * scene.bearings2)
    assert not result.success and np.isnan(result.cam2_from_cam1.matrix()).any()
    if result.status == "too_few_inliers" and result.warnings:
        assert "may be mirrored" in result.warnings[-1]


def test_most_mirrored_images_are_named():
    scenes = [noisy_scene(seed, 0.06, 0.2) for seed in range(10)]
    found = [estimate_relative_pose(each.bearings1, each.bearings2 * (-1, 1, 1)) for each in scenes]
    named = [each for each in found if any("may be mirrored" in w for w in each.warnings)]
    assert len(named) >= 8
