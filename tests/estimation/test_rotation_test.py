# SPDX-License-Identifier: BSD-3-Clause
"""A rotation alone is rejected by what is near, where most is far away, if that is all around."""

import numpy as np
import pytest

import epi360
from epi360 import _core, estimate_relative_pose
from epi360.epipolar.residuals import pose_residuals
from epi360.estimation.around_camera import share_outside_hemisphere
from epi360.estimation.image_matches import IMAGE_OPTIONS
from epi360.estimation.rotation_test_reference import rotation_test_reference
from epi360.poses import rotation_from_vector

internals = _core.internals

NOISE_RAD = np.radians(0.05)
STEP_M = np.array([0.6, 0.05, 0.2])


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def anywhere(num, rng):
    return unit(rng.normal(size=(num, 3)))


def seen(points, rng, step=STEP_M):
    """Bearings of points in two views, the second one turned and a step further, and the turn."""
    turn = rotation_from_vector([0.02, 1.3, -0.01])
    pair = unit(points), unit((points - step) @ turn.T)
    return [unit(b + rng.normal(0.0, NOISE_RAD, b.shape)) for b in pair], turn


def far_and_near(seed, near_share, *, num=300, wrong=80, side=None):
    """Things 500 m away, some 2 m to 5 m away, all around or on one side, and wrong matches."""
    rng = np.random.default_rng(seed)
    num_near = round(near_share * num)
    near = anywhere(num_near, rng) * rng.uniform(2.0, 5.0, (num_near, 1))
    if side is not None:
        near[:, side] = np.abs(near[:, side]) + 0.2
    points = np.concatenate([500.0 * anywhere(num - num_near, rng), near])
    (b1, b2), turn = seen(points, rng)
    wrong1, wrong2 = anywhere(wrong, rng), anywhere(wrong, rng)
    return np.concatenate([b1, wrong1]), np.concatenate([b2, wrong2]), turn


@pytest.mark.parametrize("options", [epi360.RansacOptions(), IMAGE_OPTIONS])
@pytest.mark.parametrize("near_share", [0.2, 0.3, 0.4])
def test_a_step_shows_in_what_is_near(options, near_share):
    for seed in range(6):
        b1, b2, turn = far_and_near(seed, near_share)
        result = estimate_relative_pose(b1, b2, options=options)
        assert result.status == "ok"
        pose = epi360.Pose(turn, -turn @ STEP_M)
        assert epi360.rotation_error_deg(result.cam2_from_cam1, pose) < 0.2
        assert epi360.translation_error_deg(result.cam2_from_cam1, pose) < 2.0


def test_without_anything_near_the_camera_has_only_turned():
    for seed in range(6):
        result = estimate_relative_pose(*far_and_near(seed, 0.0)[:2])
        assert result.status == "pure_rotation" and not result.warnings


@pytest.mark.parametrize("side", [1, 2])
def test_what_is_displaced_on_one_side_is_a_warning_and_no_pose(side):
    for seed in range(6):
        b1, b2, turn = far_and_near(seed, 0.2, side=side)
        result = estimate_relative_pose(b1, b2, options=IMAGE_OPTIONS)
        assert result.status == "pure_rotation"
        assert epi360.rotation_error_deg(result.cam2_from_cam1, turn) < 0.1
        assert any("moved as if it had taken a step" in each for each in result.warnings)


@pytest.mark.parametrize("options", [epi360.RansacOptions(), IMAGE_OPTIONS])
@pytest.mark.parametrize("num_passing", [90, 200, 280])
def test_a_tram_that_passes_a_camera_that_stands_still_is_no_step(options, num_passing):
    """Its matches agree with a step, and so do all others, as if they were far away."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        still = anywhere(300, rng) * rng.uniform(3.0, 15.0, (300, 1))
        tram = rng.uniform([-6.0, -2.0, 4.0], [6.0, 1.5, 4.3], (num_passing, 3))
        turn = rotation_from_vector([0.02, 0.3, -0.01])
        first = np.concatenate([still, tram])
        second = np.concatenate([still, tram + [0.6, 0.0, 0.0]]) @ turn.T
        both = [np.concatenate([unit(each), anywhere(100, rng)]) for each in (first, second)]
        bearings = [unit(b + rng.normal(0.0, NOISE_RAD, b.shape)) for b in both]
        result = estimate_relative_pose(*bearings, options=options, seed=seed)
        assert result.status == "pure_rotation"
        assert epi360.rotation_error_deg(result.cam2_from_cam1, turn) < 0.1
        assert "all on one side of the camera" in result.warnings[0]


def test_a_wall_beside_a_step_may_be_a_tram():
    """Nothing but a landscape at the horizon is all around: the step is named, beside the turn."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        far = unit(rng.normal(size=(250, 3)) * [1.0, 0.1, 1.0]) * 500.0
        wall = rng.uniform([-8.0, -3.0, 3.0], [8.0, 1.5, 3.5], (200, 3))
        (b1, b2), turn = seen(np.concatenate([far, wall]), rng)
        result = estimate_relative_pose(b1, b2, seed=seed)
        named = result.cam2_from_cam1
        if result.status != "ok":
            assert result.status == "pure_rotation"
            assert any("on one side of the camera say another" in each for each in result.warnings)
            (named,) = result.alternatives
        pose = epi360.Pose(turn, -turn @ STEP_M)
        assert epi360.translation_error_deg(named, pose) < 2.0


def judged(seed, near_share=0.2, side=None, **changes):
    """The test of both twins on the inliers of the true pose."""
    b1, b2, turn = far_and_near(seed, near_share, num=150, wrong=40, side=side)
    pose = epi360.Pose(turn, -turn @ STEP_M)
    inliers = np.abs(pose_residuals(pose, b1, b2)) < 4.0 * NOISE_RAD
    given = {
        "rotation": turn,
        "scale": NOISE_RAD,
        "gate": 4.0 * NOISE_RAD,
        "independent": 1.0,
        "hidden": 0.0,
    }
    given |= changes
    return (
        internals.test_rotation(b1, b2, inliers, *given.values()),
        rotation_test_reference(b1, b2, inliers, **given),
    )


@pytest.mark.parametrize("side", [None, 1])
@pytest.mark.parametrize("near_share", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("changes", [{}, {"independent": 0.3, "hidden": 0.5}])
def test_the_core_and_its_twin_say_the_same(side, near_share, changes):
    for seed in range(4):
        found, expected = judged(seed, near_share, side, **changes)
        np.testing.assert_allclose(found[:2], expected[:2], rtol=1e-9, atol=1e-9)
        assert found[2:] == expected[2:]


def test_only_a_minority_that_is_near_escapes_the_median():
    """The median says nothing of a tenth of the matches, and what is displaced does."""
    _, test = judged(0, 0.1)
    assert test.by_median < 4.0 < test.by_displaced and test.all_around
    _, turned = judged(0, 0.0)
    assert turned.by_median < 4.0 and turned.by_displaced == 0.0


def test_errors_that_neighbours_share_are_fewer_witnesses():
    _, alone = judged(1)
    _, shared = judged(1, independent=0.25)
    assert shared.by_displaced == pytest.approx(0.5 * alone.by_displaced, rel=1e-12)


def test_things_that_move_each_their_own_way_are_no_step():
    rng = np.random.default_rng(5)
    (b1, b2), _ = seen(500.0 * anywhere(250, rng), rng)
    b2[:60] = unit(b2[:60] + rng.normal(0.0, 0.05, (60, 3)))
    result = estimate_relative_pose(b1, b2)
    assert result.status == "pure_rotation" and not result.warnings


def test_a_hemisphere_holds_what_lies_on_one_side():
    rng = np.random.default_rng(2)
    around = anywhere(60, rng)
    below = around * np.where(around[:, 1:2] < 0.0, -1.0, 1.0)
    turn = rotation_from_vector([0.4, -1.1, 0.7])
    assert share_outside_hemisphere(below @ turn.T) == 0.0
    assert share_outside_hemisphere(around @ turn.T) > 0.25
    one_above = np.concatenate([below, [[0.1, -1.0, 0.2]]])
    assert share_outside_hemisphere(one_above @ turn.T) == pytest.approx(1 / 61)
