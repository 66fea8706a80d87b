# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from exact_matches import any_pose, any_turn, exact_matches

from epi360.epipolar import (
    cheirality_mask,
    decompose_essential,
    essential_from_pose,
    pose_from_essential,
    project_to_essential,
    triangulate,
)
from epi360.poses import Pose

RIGHT = Pose(np.eye(3), [1.0, 0.0, 0.0])  # points move one unit to the right
LAYOUTS = ["room", "sphere", "behind", "cone"]


@pytest.mark.parametrize(
    ("translation", "expected"),
    [
        ([1, 0, 0], [[0, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ([0, 0, 1], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]),
        ([0, 7, 0], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]]),
    ],
)
def test_essential_matrix_of_a_shift_along_one_axis_is_its_cross_product(translation, expected):
    E = essential_from_pose(Pose(np.eye(3), translation))
    np.testing.assert_array_equal(E, expected)


def test_half_a_turn_about_the_vertical_negates_two_columns_of_the_essential_matrix():
    E = essential_from_pose(Pose(np.diag([-1.0, 1.0, -1.0]), [1, 0, 0]))
    np.testing.assert_array_equal(E, [[0, 0, 0], [0, 0, 1], [0, 1, 0]])


def test_essential_matrix_without_translation_is_nan():
    assert np.isnan(essential_from_pose(Pose(np.eye(3), np.zeros(3)))).all()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_exact_matches_satisfy_the_epipolar_constraint(layout):
    b1, b2, pose, _ = exact_matches(0, layout=layout)
    constraint = np.einsum("ni,ij,nj->n", b2, essential_from_pose(pose), b1)
    np.testing.assert_allclose(constraint, 0.0, atol=1e-14)


@pytest.mark.parametrize("seed", range(10))
def test_swapping_the_views_transposes_the_essential_matrix(seed):
    pose = any_pose(seed)
    swapped = essential_from_pose(pose.inverse())
    np.testing.assert_allclose(swapped, essential_from_pose(pose).T, atol=1e-14)


@pytest.mark.parametrize("seed", range(10))
def test_turning_a_camera_turns_its_side_of_the_essential_matrix(seed):
    pose, turn = any_pose(seed), Pose(any_turn(seed + 50), np.zeros(3))
    E = essential_from_pose(pose)
    turned2 = essential_from_pose(turn @ pose)
    np.testing.assert_allclose(turned2, turn.rotation @ E, atol=1e-14)
    turned1 = essential_from_pose(pose @ turn.inverse())
    np.testing.assert_allclose(turned1, E @ turn.rotation.T, atol=1e-14)


@pytest.mark.parametrize("seed", range(10))
def test_projection_gives_singular_values_1_1_0_and_keeps_essential_matrices(seed):
    E = essential_from_pose(any_pose(seed))
    np.testing.assert_allclose(project_to_essential(3.0 * E), E, atol=1e-14)
    anything = np.random.default_rng(seed).normal(size=(3, 3))
    singular = np.linalg.svd(project_to_essential(anything), compute_uv=False)
    np.testing.assert_allclose(singular, [1.0, 1.0, 0.0], atol=1e-14)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("scale", [1.0, -1.0, 1e-5, -300.0])
def test_one_of_the_four_poses_is_the_one_that_made_the_matrix(seed, scale):
    truth = any_pose(seed)
    poses = decompose_essential(scale * essential_from_pose(truth))
    distances = [np.abs(pose.matrix() - truth.matrix()).max() for pose in poses]
    np.testing.assert_allclose(sorted(distances)[0], 0.0, atol=1e-12)
    assert sorted(distances)[1] > 1e-3  # the other three are different poses


@pytest.mark.parametrize("seed", range(10))
def test_all_four_poses_compose_to_the_same_matrix_up_to_sign(seed):
    E = essential_from_pose(any_pose(seed))
    poses = decompose_essential(E)
    assert len(poses) == 4
    for pose in poses:
        composed = essential_from_pose(pose)
        sign = np.sign((composed * E).sum())
        np.testing.assert_allclose(sign * composed, E, atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(pose.rotation), 1.0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(pose.translation), 1.0, atol=1e-12)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", range(5))
def test_exactly_one_of_the_four_poses_has_all_points_in_front(layout, seed):
    b1, b2, pose, _ = exact_matches(seed, layout=layout)
    counts = [
        cheirality_mask(b1, b2, candidate).sum()
        for candidate in decompose_essential(essential_from_pose(pose))
    ]
    assert sorted(counts)[-1] == 40
    assert sorted(counts)[-2] < 40


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", range(5))
def test_pose_from_essential_is_the_truth_wherever_the_points_lie(layout, seed):
    b1, b2, pose, _ = exact_matches(seed, layout=layout)
    found = pose_from_essential(-2.0 * essential_from_pose(pose), b1, b2)
    np.testing.assert_allclose(found.matrix(), pose.matrix(), atol=1e-12)


def test_pose_from_essential_goes_with_the_majority_and_leaves_missing_rows_out():
    b1, b2, pose, _ = exact_matches(3)
    b2[:12] *= -1.0  # behind camera 2
    b1[12:15] = np.nan
    found = pose_from_essential(essential_from_pose(pose), b1, b2)
    np.testing.assert_allclose(found.matrix(), pose.matrix(), atol=1e-12)
    assert not cheirality_mask(b1, b2, pose)[:15].any()
    assert cheirality_mask(b1, b2, pose)[15:].all()


def test_triangulation_of_one_point_by_hand():
    # (0, 0, 2) becomes (1, 0, 2) in camera 2.
    points, depths1, depths2 = triangulate([[0, 0, 1]], [[1, 0, 2]], RIGHT)
    np.testing.assert_allclose(points, [[0, 0, 2]], atol=1e-14)
    np.testing.assert_allclose(depths1, [2.0], atol=1e-14)
    np.testing.assert_allclose(depths2, [np.sqrt(5.0)], atol=1e-14)


def test_rays_that_meet_behind_the_cameras_have_negative_depths():
    points, depths1, depths2 = triangulate([[0, 0, -1]], [[-1, 0, -2]], RIGHT)
    np.testing.assert_allclose(points, [[0, 0, 2]], atol=1e-14)
    np.testing.assert_allclose([*depths1, *depths2], [-2.0, -np.sqrt(5.0)], atol=1e-14)
    assert not cheirality_mask([[0, 0, -1]], [[-1, 0, -2]], RIGHT)[0]


def test_a_point_with_negative_z_is_in_front_when_its_ray_points_at_it():
    points, depths1, depths2 = triangulate([[0, 0, -1]], [[1, 0, -2]], RIGHT)
    np.testing.assert_allclose(points, [[0, 0, -2]], atol=1e-14)
    assert depths1[0] > 0.0 and depths2[0] > 0.0
    assert cheirality_mask([[0, 0, -1]], [[1, 0, -2]], RIGHT)[0]


def test_skew_rays_triangulate_to_the_middle_between_them():
    # Ray 1 is the z axis; ray 2 meets it at (0, 0, 2), lifted by 0.2 in y at both of its ends.
    lifted = np.array([[1.0, 0.2, 2.0]])
    points, depths1, depths2 = triangulate([[0, 0, 1]], lifted, RIGHT)
    on_ray1 = np.array([0, 0, depths1[0]])
    on_ray2 = depths2[0] * lifted[0] / np.linalg.norm(lifted) - RIGHT.translation
    between = on_ray2 - on_ray1
    np.testing.assert_allclose(points[0], 0.5 * (on_ray1 + on_ray2), atol=1e-14)
    np.testing.assert_allclose([between[2], between @ lifted[0]], 0.0, atol=1e-14)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_triangulation_returns_the_points_in_the_unit_of_the_translation(layout):
    b1, b2, pose, points = exact_matches(7, layout=layout)
    metric = Pose(pose.rotation, 2.5 * pose.translation)
    found, depths1, depths2 = triangulate(b1, b2, metric)
    points2 = 2.5 * (points @ pose.rotation.T + pose.translation)
    # Rounding of a bearing, 1e-16, over the smallest parallax of these scenes, 1e-2, squared.
    np.testing.assert_allclose(found, 2.5 * points, atol=1e-9)
    np.testing.assert_allclose(depths1, np.linalg.norm(2.5 * points, axis=1), atol=1e-9)
    np.testing.assert_allclose(depths2, np.linalg.norm(points2, axis=1), atol=1e-9)


@pytest.mark.parametrize("direction", [[0, 0, 1], [0, 1, 2], [0, -3, 4]])
def test_parallel_rays_meet_at_infinity(direction):
    _, depths1, depths2 = triangulate([direction], [direction], RIGHT)
    assert np.isinf(depths1[0]) and np.isinf(depths2[0])


def test_parallel_rays_are_not_in_front():
    assert not cheirality_mask([[0, 1, 2]], [[0, 1, 2]], RIGHT)[0]


def test_missing_rows_triangulate_to_nan_and_leave_the_others_alone():
    b1, b2, pose, points = exact_matches(1, 10)
    b1[4, 1] = np.nan
    b2[7] = np.nan
    found, depths1, depths2 = triangulate(b1, b2, pose)
    missing = np.isin(np.arange(10), [4, 7])
    assert np.isnan(depths1[missing]).all() and np.isnan(depths2[missing]).all()
    np.testing.assert_allclose(found[~missing], points[~missing], atol=1e-9)


@pytest.mark.parametrize("E", [np.zeros((3, 4)), np.full((3, 3), np.nan), np.full((3, 3), np.inf)])
def test_what_is_no_matrix_is_refused(E):
    for function in (decompose_essential, project_to_essential):
        with pytest.raises(ValueError, match=r"E must be a finite \(3, 3\) matrix"):
            function(E)
