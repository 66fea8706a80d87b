# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from exact_matches import exact_matches

from epi360.epipolar import (
    EightPointSolution,
    angular_residuals,
    cheirality_mask,
    eight_point,
    essential_from_pose,
    observation_matrix,
    paper_residuals,
    pose_from_essential,
    sampson_residuals,
    tangent_sampson_residuals,
    triangulate,
)
from epi360.poses import Pose

B1, B2, POSE, _ = exact_matches(0, 12)
E = essential_from_pose(POSE)
FUNCTIONS = {
    "observation_matrix": observation_matrix,
    "eight_point": eight_point,
    "triangulate": lambda b1, b2: triangulate(b1, b2, POSE),
    "cheirality_mask": lambda b1, b2: cheirality_mask(b1, b2, POSE),
    "pose_from_essential": lambda b1, b2: pose_from_essential(E, b1, b2),
    "paper_residuals": lambda b1, b2: paper_residuals(E, b1, b2),
    "angular_residuals": lambda b1, b2: angular_residuals(E, b1, b2),
    "sampson_residuals": lambda b1, b2: sampson_residuals(E, b1, b2),
}


def with_row(bearings, row, value):
    changed = bearings.copy()
    changed[row] = value
    return changed


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(
    ("b1", "b2", "message"),
    [
        (B1[:, :2], B2, r"bearings1 must have shape \(N, 3\), got \(12, 2\)"),
        (B1, B2[0], r"bearings2 must have shape \(N, 3\), got \(3,\)"),
        (B1, B2[:-1], "bearings1 and bearings2 must have the same length, got 12 and 11"),
        (with_row(B1, 5, np.inf), B2, "bearings1 must be finite .* row 5 is infinite"),
        (B1, with_row(B2, 7, -np.inf), "bearings2 must be finite .* row 7 is infinite"),
        (B1, with_row(B2, 2, 0.0), "bearings2 must have non-zero length .* row 2"),
    ],
)
def test_every_function_refuses_bad_bearings_and_names_them(name, b1, b2, message):
    with pytest.raises(ValueError, match=message):
        FUNCTIONS[name](b1, b2)


def arrays_of(answer):
    """Arrays of an answer: one row a match, but for an essential matrix or a pose."""
    if isinstance(answer, Pose):
        return [answer.matrix()]
    if isinstance(answer, EightPointSolution):
        return [answer.E]
    return list(answer) if isinstance(answer, tuple) else [answer]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_missing_row_is_nan_or_false_and_changes_nothing_else(name):
    present = np.arange(len(B1)) != 5
    answers = arrays_of(FUNCTIONS[name](with_row(B1, 5, np.nan), B2))
    without_row = arrays_of(FUNCTIONS[name](B1[present], B2[present]))
    for answer, expected in zip(answers, without_row, strict=True):
        if len(answer) == len(B1):
            missing, answer = answer[5], answer[present]
            assert not missing if answer.dtype == bool else np.isnan(missing).all()
        np.testing.assert_allclose(answer, expected, atol=1e-12)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_lists_and_single_precision_give_the_same_answer(name):
    rounded1, rounded2 = B1.astype(np.float32), B2.astype(np.float32)
    answers = arrays_of(FUNCTIONS[name](rounded1.tolist(), rounded2))
    doubles = arrays_of(FUNCTIONS[name](rounded1.astype(float), rounded2.astype(float)))
    for answer, expected in zip(answers, doubles, strict=True):
        np.testing.assert_array_equal(answer, expected)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_masked_row_is_a_missing_one(name):
    hidden = np.zeros(B1.shape, dtype=bool)
    hidden[3] = True
    answers = arrays_of(FUNCTIONS[name](np.ma.array(B1, mask=hidden), B2))
    missing = arrays_of(FUNCTIONS[name](np.where(hidden, np.nan, B1), B2))
    for answer, expected in zip(answers, missing, strict=True):
        np.testing.assert_array_equal(answer, expected)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1.0, 0.0, 0.0])])
def test_a_matrix_near_no_essential_one_is_refused(matrix):
    with pytest.raises(ValueError, match="E must have rank 2 or more"):
        pose_from_essential(matrix, B1, B2)


@pytest.mark.parametrize("name", sorted(set(FUNCTIONS) - {"eight_point"}))
def test_no_matches_at_all_give_no_rows_or_a_pose_of_the_matrix(name):
    answer = FUNCTIONS[name](np.empty((0, 3)), np.empty((0, 3)))
    if isinstance(answer, Pose):
        np.testing.assert_allclose(abs(np.sum(essential_from_pose(answer) * E)), 2, atol=1e-12)
        return
    full = arrays_of(FUNCTIONS[name](B1, B2))
    for array, with_rows in zip(arrays_of(answer), full, strict=True):
        assert array.shape == (0, *with_rows.shape[1:])


@pytest.mark.parametrize("length", [1e-300, 1e-12, 1e12, 1e300])
def test_bearings_of_any_length_become_directions(length):
    A = observation_matrix(length * B1, B2)
    np.testing.assert_allclose(A, observation_matrix(B1, B2), atol=1e-15)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (np.ones(11), r"weights must have shape \(12,\), got \(11,\)"),
        (np.ones((12, 1)), r"weights must have shape \(12,\), got \(12, 1\)"),
        (-np.ones(12), "weights must be finite and not negative"),
        (np.full(12, np.nan), "weights must be finite and not negative"),
        (np.full(12, np.inf), "weights must be finite and not negative"),
    ],
)
def test_eight_point_refuses_bad_weights(weights, message):
    with pytest.raises(ValueError, match=message):
        eight_point(B1, B2, weights=weights)


def test_tangent_sampson_refuses_bad_bearings_too():
    J = np.zeros((12, 3, 2))
    with pytest.raises(ValueError, match="bearings2 must be finite"):
        tangent_sampson_residuals(E, B1, with_row(B2, 0, np.inf), J, J)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("wrong", ["words", [[1, 2], [3]], B1 + 1j, POSE])
def test_what_are_no_numbers_is_refused_in_one_sentence(name, wrong):
    with pytest.raises(ValueError, match=r"bearings1 must be real numbers of shape \(N, 3\)"):
        FUNCTIONS[name](wrong, B2)
