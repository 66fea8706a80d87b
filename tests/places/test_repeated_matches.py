# SPDX-License-Identifier: BSD-3-Clause
"""Directions on which matches agree that are no inliers, in made places that repeat themselves."""

import numpy as np
import pytest

from epi360.places.repeated_matches import DirectionVotes, is_in_the_open, which_repeat
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector

TURN = rotation_from_vector([0.1, 0.8, -0.05])
STEP = Pose(TURN, np.array([0.6, 0.0, 0.8]))
NUM_RIGHT, NUM_WRONG = 100, 100


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def matches(num_shifted, seed=0):
    """Bearings of right matches, of such as put a thing upon the next, and of wrong ones."""
    rng = np.random.default_rng(seed)
    num_true = NUM_RIGHT + num_shifted
    points = unit(rng.normal(size=(num_true, 3))) * rng.uniform(2.0, 5.0, (num_true, 1))
    matched = points.copy()
    matched[NUM_RIGHT:] += [2.0, 0.0, 0.0]  # the same thing once more
    first = np.concatenate([points, rng.normal(size=(NUM_WRONG, 3))])
    seen = matched @ TURN.T + STEP.translation
    second = np.concatenate([seen, rng.normal(size=(NUM_WRONG, 3))])
    inlier_mask = np.arange(len(first)) < NUM_RIGHT
    return unit(first), unit(second), inlier_mask


def votes_on(first, second, inlier_mask, pose=STEP):
    return DirectionVotes.of(pose, (first, second), inlier_mask)


def test_things_that_repeat_agree_on_another_direction():
    votes = votes_on(*matches(40))
    assert 95 <= votes.num_own <= 115
    assert 38 <= votes.num_other <= 50
    assert votes.num_left == 140
    assert votes.are_for_another(0.3) and not votes.are_for_another(0.6)


def test_what_passes_on_one_side_speaks_against_no_pose():
    """A vehicle six metres away drives two metres while the camera moves by one."""
    rng = np.random.default_rng(0)
    still = unit(rng.normal(size=(NUM_RIGHT, 3))) * rng.uniform(4.0, 20.0, (NUM_RIGHT, 1))
    vehicle = rng.uniform([-5.0, -1.5, 5.0], [5.0, 1.0, 7.5], (60, 3))
    before, after = np.concatenate([still, vehicle]), np.concatenate([still, vehicle + [2, 0, 0]])
    inlier_mask = np.arange(len(before)) < NUM_RIGHT
    votes = votes_on(unit(before), unit(after @ TURN.T + STEP.translation), inlier_mask)
    assert votes.num_other > 50 and votes.on_one_side
    assert which_repeat([votes] * 5) == [False] * 5
    assert not votes_on(*matches(40)).on_one_side


def test_wrong_matches_agree_on_none():
    for seed in range(10):
        votes = votes_on(*matches(0, seed))
        assert votes.num_other < 12 and not votes.are_for_another(0.1)


def test_a_swap_of_the_views_changes_no_votes():
    first, second, inlier_mask = matches(40)
    back = Pose(TURN.T, -TURN.T @ STEP.translation)
    here, there = votes_on(first, second, inlier_mask), votes_on(second, first, inlier_mask, back)
    assert here.num_left == there.num_left
    np.testing.assert_allclose(here[:2], there[:2], atol=4)


@pytest.mark.parametrize("view", [0, 1])
def test_a_turn_of_a_camera_changes_no_votes(view):
    *bearings, inlier_mask = matches(40)
    turned = rotation_from_vector([0.3, -1.2, 0.7])
    pose = Pose(STEP.rotation @ turned.T, STEP.translation)
    if view:
        pose = Pose(turned @ STEP.rotation, turned @ STEP.translation)
    before = votes_on(*bearings, inlier_mask)
    bearings[view] = bearings[view] @ turned.T
    np.testing.assert_allclose(votes_on(*bearings, inlier_mask, pose)[:2], before[:2], atol=4)


def test_what_the_camera_carries_has_no_votes():
    first, second, inlier_mask = matches(0)
    carried = unit(np.random.default_rng(1).normal(size=(300, 3)))
    first, second = np.concatenate([first, carried]), np.concatenate([second, carried])
    votes = votes_on(first, second, np.append(inlier_mask, np.zeros(300, dtype=bool)))
    assert votes.num_other < 12 and votes.num_left <= NUM_WRONG


def test_matches_that_are_all_inliers_leave_no_votes():
    first, second, _ = matches(0)
    votes = votes_on(first[:NUM_RIGHT], second[:NUM_RIGHT], np.ones(NUM_RIGHT, dtype=bool))
    assert votes.num_other <= 0 and votes.num_left == 0
    assert not votes.are_for_another(0.0)


@pytest.mark.parametrize(("farthest", "expected"), [(8.0, False), (40.0, True)])
def test_a_street_has_things_near_and_far(farthest, expected):
    rng = np.random.default_rng(0)
    points = unit(rng.normal(size=(200, 3))) * np.geomspace(2.0, farthest, 200)[:, None]
    rows = np.column_stack([np.arange(200)] * 2)
    bearings = unit(points), unit(points @ TURN.T + STEP.translation)
    assert is_in_the_open(PosedPair.of((0, 1), STEP, rows, bearings)) is expected
    few = PosedPair.of((0, 1), STEP, rows[::25], bearings)
    assert not is_in_the_open(few)


def test_where_many_pairs_repeat_less_is_enough():
    clear, some, none = (DirectionVotes(100, num, 100) for num in (30, 12, 5))
    assert which_repeat([clear, some, none]) == [True, False, False]
    assert which_repeat([clear] * 3 + [some, none]) == [True] * 3 + [True, False]
    assert which_repeat([clear] * 3 + [some] + [none] * 20) == [True] * 3 + [False] * 21
    in_the_open = clear._replace(in_the_open=True)
    assert which_repeat([clear] * 2 + [in_the_open] * 3) == [False] * 5
    assert which_repeat([clear] * 3 + [in_the_open] * 4) == [True] * 7
    on_one_side = some._replace(on_one_side=True)
    assert which_repeat([clear] * 3 + [on_one_side]) == [True] * 4
    assert which_repeat([]) == []
