# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from exact_matches import any_turn, disturbed, exact_matches

from epi360.epipolar import (
    eight_point,
    essential_from_pose,
    observation_matrix,
    pose_from_essential,
)


def assert_same_up_to_sign(E, expected, atol):
    np.testing.assert_allclose(np.sign((E * expected).sum()) * E, expected, atol=atol)


def test_row_of_the_observation_matrix_by_hand():
    A = observation_matrix([[1, 0, 0], [0, 0, 2]], [[0, 1, 0], [3, 0, 0]])
    np.testing.assert_array_equal(A, [[0, 0, 0, 1, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0, 0, 0, 0]])


@pytest.mark.parametrize("layout", ["sphere", "room", "behind"])
def test_observation_matrix_annihilates_the_essential_matrix(layout):
    b1, b2, pose, _ = exact_matches(0, layout=layout)
    A = observation_matrix(b1, b2)
    assert A.shape == (40, 9)
    np.testing.assert_allclose(A @ essential_from_pose(pose).ravel(), 0.0, atol=1e-14)


@pytest.mark.parametrize("layout", ["sphere", "room", "behind"])
@pytest.mark.parametrize("num_matches", [8, 9, 100])
def test_eight_point_is_exact_without_noise(layout, num_matches):
    for seed in range(5):
        b1, b2, pose, _ = exact_matches(seed, num_matches, layout)
        solution = eight_point(b1, b2)
        # Amplified by sigma_1 / sigma_8, at worst some 1e5 for eight matches.
        assert_same_up_to_sign(solution.E, essential_from_pose(pose), atol=1e-9)


@pytest.mark.parametrize("num_matches", [8, 9, 100])
def test_singular_values_are_nine_descending_and_the_ninth_is_the_misfit(num_matches):
    b1, b2, _, _ = exact_matches(2, num_matches)
    singular = eight_point(b1, b2).singular_values
    assert singular.shape == (9,)
    assert (np.diff(singular[:8]) <= 0.0).all() and singular[7] > 1e-4
    if num_matches == 8:
        assert np.isnan(singular[8])
    else:
        np.testing.assert_allclose(singular[8], 0.0, atol=1e-13)
        assert eight_point(b1, disturbed(b2, 1.0, 0)).singular_values[8] > 1e-4


def test_eight_point_has_rank_two_and_norm_root_two_with_noise():
    b1, b2, _, _ = exact_matches(4, 100)
    E = eight_point(b1, disturbed(b2, 1.0, 0)).E
    np.testing.assert_allclose(np.linalg.svd(E, compute_uv=False)[2], 0.0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(E), np.sqrt(2.0), atol=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_eight_point_follows_turned_cameras_and_swapped_views(seed):
    b1, b2, _, _ = exact_matches(seed, 60)
    b2 = disturbed(b2, 0.5, seed)
    E, turn = eight_point(b1, b2).E, any_turn(seed)
    assert_same_up_to_sign(eight_point(b1, b2 @ turn.T).E, turn @ E, atol=1e-9)
    assert_same_up_to_sign(eight_point(b1 @ turn.T, b2).E, E @ turn.T, atol=1e-9)
    assert_same_up_to_sign(eight_point(b2, b1).E, E.T, atol=1e-9)


def test_weights_of_zero_remove_outliers():
    b1, b2, pose, _ = exact_matches(5, 60)
    b2[:20] = np.roll(b2[:20], 1, axis=0)
    weights = np.repeat([0.0, 1.0], [20, 40])
    assert_same_up_to_sign(
        eight_point(b1, b2, weights=weights).E, essential_from_pose(pose), atol=1e-9
    )
    assert np.abs(np.abs(eight_point(b1, b2).E) - np.abs(essential_from_pose(pose))).max() > 1e-2


def test_a_weight_of_three_counts_like_three_copies():
    b1, b2, _, _ = exact_matches(6, 30)
    b2 = disturbed(b2, 1.0, 6)
    copies = np.where(np.arange(30) < 10, 3, 1)
    weighted = eight_point(b1, b2, weights=copies).E
    repeated = eight_point(np.repeat(b1, copies, axis=0), np.repeat(b2, copies, axis=0)).E
    assert_same_up_to_sign(weighted, repeated, atol=1e-9)


def test_missing_rows_and_lengths_do_not_matter():
    b1, b2, pose, _ = exact_matches(8, 50)
    b1[3], b2[11, 2] = np.nan, np.nan
    lengths = np.linspace(0.01, 100.0, 50)[:, None]
    E = eight_point(lengths * b1, b2 / lengths).E
    assert_same_up_to_sign(E, essential_from_pose(pose), atol=1e-9)


def test_eight_point_and_cheirality_give_the_pose_with_every_point_behind():
    b1, b2, pose, _ = exact_matches(9, 50, "behind")
    assert (b1[:, 2] < 0.0).all() and (b2[:, 2] < 0.0).all()
    found = pose_from_essential(eight_point(b1, b2).E, b1, b2)
    np.testing.assert_allclose(found.matrix(), pose.matrix(), atol=1e-9)


def test_fewer_than_eight_usable_matches_are_refused():
    b1, b2, _, _ = exact_matches(0, 9)
    b1[[2, 6]] = np.nan
    with pytest.raises(ValueError, match="needs at least 8 matches, got 7"):
        eight_point(b1, b2)
