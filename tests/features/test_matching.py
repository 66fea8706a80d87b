# SPDX-License-Identifier: BSD-3-Clause
"""Matches obey the ratio test and are mutual; the block size does not show."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from epi360 import _core
from epi360.features import Features, match_features, matching


def features_of(descriptors):
    rows = np.asarray(descriptors, np.float32).reshape(-1, 128)
    return Features(np.zeros((len(rows), 2)), rows, np.ones(len(rows)))


@pytest.fixture
def blas_alone(monkeypatch):
    """What is done on processors that the core's products were not written for."""
    monkeypatch.setattr(matching._core, "two_nearest", lambda queries, targets: None)


def unit_rows(array):
    return array / np.linalg.norm(array, axis=-1, keepdims=True)


def turned(index, other, degrees):
    """Unit descriptor in the plane of two axes, at an angle from the first."""
    row = np.zeros(128)
    row[index], row[other] = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return row


def random_pair(seed=0, num_common=300, num_other=150, noise=0.03):
    """Descriptors of which some are common up to noise, in random order."""
    rng = np.random.default_rng(seed)
    common = np.abs(rng.normal(size=(num_common, 128)))
    sets = []
    for _ in range(2):
        seen = common + noise * rng.normal(size=common.shape)
        rows = np.concatenate([seen, np.abs(rng.normal(size=(num_other, 128)))])
        sets.append(unit_rows(np.abs(rows))[rng.permutation(len(rows))])
    return features_of(sets[0]), features_of(sets[1])


def brute_force(features1, features2, ratio, mutual):
    """Straight from the definition, over all distances."""
    distances = cdist(features1.descriptors, features2.descriptors)
    nearest1, clear1 = nearest_and_clear(distances, ratio)
    nearest2, clear2 = nearest_and_clear(distances.T, ratio)
    matches = []
    for i, j in enumerate(nearest1):
        if mutual and nearest2[j] == i and (clear1[i] or clear2[j]):
            matches.append((i, j))
        if not mutual and clear1[i]:
            matches.append((i, j))
    return np.array(matches).reshape(-1, 2)


def nearest_and_clear(distances, ratio):
    """Each row's nearest, and whether it is clearly nearer than the second."""
    order = np.argsort(distances, axis=1)
    first, second = np.take_along_axis(distances, order[:, :2], axis=1).T
    return order[:, 0], first < ratio * second


def test_the_nearest_descriptor_is_the_match():
    first = features_of([turned(0, 9, 0), turned(1, 9, 0), turned(2, 9, 0)])
    second = features_of([turned(2, 8, 5), turned(0, 8, 5), turned(7, 8, 0)])
    np.testing.assert_array_equal(match_features(first, second), [[0, 1], [2, 0]])


def test_the_ratio_compares_distances_to_the_nearest_and_the_second():
    # Seen from the first set, chords of 10 and 14 degrees: a ratio of 0.715; from the second, of
    # 10 and 13 degrees: 0.770.
    first = features_of([turned(0, 1, 0), turned(0, 1, 23)])
    second = features_of([turned(0, 1, 10), turned(0, 1, -14)])
    np.testing.assert_array_equal(match_features(first, second, ratio=0.72), [[0, 0]])
    assert len(match_features(first, second, ratio=0.71)) == 0


def test_it_is_enough_to_be_distinctive_in_one_of_the_images():
    alone = features_of([turned(0, 1, 0), turned(5, 6, 0)])
    rivals = features_of([turned(0, 1, 10), turned(0, 1, -11)])
    np.testing.assert_array_equal(match_features(alone, rivals), [[0, 0]])
    np.testing.assert_array_equal(match_features(rivals, alone), [[0, 0]])
    assert len(match_features(alone, rivals, mutual=False)) == 0


def test_two_rivals_for_one_target_are_settled_by_mutuality():
    first = features_of([turned(0, 1, 6), turned(0, 1, 2), turned(5, 6, 0)])
    second = features_of([turned(0, 1, 0), turned(5, 6, 3)])
    np.testing.assert_array_equal(match_features(first, second), [[1, 0], [2, 1]])
    np.testing.assert_array_equal(
        match_features(first, second, mutual=False), [[0, 0], [1, 0], [2, 1]]
    )


def test_a_set_matches_itself_row_by_row():
    features, _ = random_pair()
    everything = np.repeat(np.arange(len(features))[:, None], 2, axis=1)
    np.testing.assert_array_equal(match_features(features, features), everything)


@pytest.mark.parametrize("mutual", [True, False])
@pytest.mark.parametrize("ratio", [0.6, 0.8, 0.99])
@pytest.mark.parametrize("sizes", [(300, 150), (5, 2), (1, 1)])
def test_matches_are_those_of_the_definition(sizes, ratio, mutual):
    first, second = random_pair(1, *sizes, noise=0.4)
    found = match_features(first, second, ratio=ratio, mutual=mutual)
    assert found.dtype == np.int64
    # Descriptors are rounded to 2^-11, which moves a ratio by less than half a percent.
    certain = brute_force(first, second, 0.995 * ratio, mutual)
    possible = brute_force(first, second, 1.005 * ratio, mutual)
    rows = {tuple(row) for row in found.tolist()}
    assert {tuple(row) for row in certain} <= rows <= {tuple(row) for row in possible}


def test_every_mutual_pair_is_a_match_without_a_ratio():
    first, second = random_pair(1, noise=0.4)
    expected = brute_force(first, second, 1.0, mutual=True)
    np.testing.assert_array_equal(match_features(first, second, ratio=1.0), expected)


def test_products_of_descriptors_are_exact_in_any_order():
    first, second = (matching.rounded_descriptors(each.descriptors) for each in random_pair(11))
    exact = first.astype(np.float64) @ second.astype(np.float64).T
    np.testing.assert_array_equal(first @ second.T, exact)
    order = np.random.default_rng(12).permutation(128)
    np.testing.assert_array_equal(first[:, order] @ second[:, order].T, exact)


@pytest.mark.parametrize("rows_per_block", [1, 7, 449, 450, 451])
def test_where_blocks_end_does_not_matter(blas_alone, monkeypatch, rows_per_block):
    first, second = random_pair(2)
    expected = brute_force(first, second, 0.8, mutual=True)
    monkeypatch.setattr(matching, "_BLOCK_BYTES", 4 * len(second) * rows_per_block)
    np.testing.assert_array_equal(match_features(first, second), expected)
    assert len(expected) > 250


@pytest.mark.usefixtures("blas_alone")
def test_more_descriptors_than_one_block_holds_are_all_matched():
    rng = np.random.default_rng(3)
    rows = unit_rows(np.abs(rng.normal(size=(4000, 128))))
    order = rng.permutation(4000)
    assert matching._BLOCK_BYTES < 4 * 4000**2
    matches = match_features(features_of(rows), features_of(rows[order]))
    np.testing.assert_array_equal(matches[:, 0], np.arange(4000))
    np.testing.assert_array_equal(order[matches[:, 1]], np.arange(4000))


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize(
    ("num1", "num2", "size"),
    [(1, 1, 128), (5, 2, 128), (513, 700, 128), (1000, 31, 129), (3, 1025, 64), (0, 5, 128),
     (5, 0, 128), (0, 0, 128), (600, 600, 1), (40, 30, 511)],
)  # fmt: skip
def test_the_core_finds_the_same_as_blas(num1, num2, size, signed):
    rng = np.random.default_rng(num1 + num2)
    rows = rng.normal(size=(num1 + num2, size))
    units = unit_rows(rows if signed else np.abs(rows)).astype(np.float32)
    queries, targets = units[:num1], units[num1:]
    queries = np.concatenate([queries, targets[:20], queries[:5]])  # some are equal
    targets = np.concatenate([targets, queries[:20], targets[-5:]])
    found = _core.two_nearest(queries, targets)
    if found is None:
        pytest.skip("this processor or compiler has no products of whole numbers")
    rounded = (matching.rounded_descriptors(each) for each in (queries, targets))
    expected = matching._two_nearest_by_blas(*rounded)
    for name, value in zip(("nearest", "best", "second", "others"), found, strict=True):
        assert value.dtype == getattr(expected, name).dtype
        np.testing.assert_array_equal(value, getattr(expected, name))


@pytest.mark.parametrize("value", [1.01, -40.0, float("nan"), float("inf")])
def test_the_core_leaves_descriptors_of_another_length_to_blas(value):
    rows = np.eye(128, dtype=np.float32)
    strange = rows.copy()
    strange[3, 7] = value
    assert _core.two_nearest(strange, rows) is None
    assert _core.two_nearest(rows, strange) is None
    assert _core.two_nearest(rows[:, :64], rows) is None


def test_matches_of_two_threads_are_those_of_one():
    first, second = random_pair(13, 900, 600)
    assert len(first) // 2 * len(second) > matching._WORTH_A_THREAD
    found = match_features(first, second)
    np.testing.assert_array_equal(found, matching.look(first, second).matches())


def test_matches_are_one_to_one_and_ascend_in_the_first():
    matches = match_features(*random_pair(4))
    assert (np.diff(matches[:, 0]) > 0).all()
    assert len(np.unique(matches[:, 1])) == len(matches)


def test_permuting_a_set_permutes_the_matches():
    first, second = random_pair(5)
    order = np.random.default_rng(6).permutation(len(second))
    expected = match_features(first, second)
    found = match_features(first, features_of(second.descriptors[order]))
    np.testing.assert_array_equal(np.stack([found[:, 0], order[found[:, 1]]], axis=1), expected)


def test_swapping_the_sets_swaps_the_matches():
    first, second = random_pair(7, noise=0.4)
    rows = first.descriptors
    twins = unit_rows(rows[:60] + 0.01 * np.random.default_rng(8).normal(size=(60, 128)))
    first = features_of(np.concatenate([rows, twins]))  # rivals in the first set only
    swapped = match_features(second, first)[:, ::-1]
    np.testing.assert_array_equal(swapped[np.argsort(swapped[:, 0])], match_features(first, second))


@pytest.mark.parametrize("mutual", [True, False])
@pytest.mark.parametrize("num_rows", [2, 7, 33, 200, 201, 203, 1000])
def test_two_equal_candidates_are_no_match(num_rows, mutual):
    rows = unit_rows(np.abs(np.random.default_rng(9).normal(size=(num_rows, 128))))
    doubled = features_of(np.concatenate([rows, rows]))
    # Their products round to more or less than 1, not all alike: the blocks of a matrix product
    # end elsewhere with another number of rows or threads.
    assert len(match_features(doubled, doubled, mutual=mutual)) == 0
    assert len(match_features(features_of(rows), doubled, mutual=False)) == 0


@pytest.mark.parametrize("sizes", [(0, 0), (0, 5), (5, 0), (5, 1), (1, 5), (1, 1)])
def test_without_a_second_candidate_there_are_no_matches(sizes):
    sets = [features_of(np.eye(128)[:count]) for count in sizes]
    matches = match_features(*sets)
    assert matches.shape == (0, 2)
    assert matches.dtype == np.int64


@pytest.mark.parametrize("ratio", [0.0, -0.5, 1.5, float("nan")])
def test_a_ratio_out_of_range_is_refused(ratio):
    with pytest.raises(ValueError, match="ratio must be in"):
        match_features(*random_pair(num_common=2, num_other=1), ratio=ratio)


@pytest.mark.parametrize(
    ("num1", "num2"), [(200, 150), (450, 150), (200, 600), (450, 600), (0, 0), (1, 1), (0, 300)]
)
def test_a_closer_look_is_the_same_as_looking_at_all_at_once(num1, num2):
    first, second = random_pair(4)
    num1, num2 = min(num1, len(first)), min(num2, len(second))
    at_once = matching.look(first, second)
    before = matching.look(first.first(num1), second.first(num2))
    closer = matching.look(first, second, before)
    for name in ("nearest", "best", "second", "others"):
        np.testing.assert_array_equal(getattr(closer, name), getattr(at_once, name))


def test_of_equal_descriptors_a_closer_look_takes_the_same_as_looking_at_all_at_once():
    first, second = random_pair(5)
    twice = features_of(np.concatenate([second.descriptors, second.descriptors[::-1]]))
    doubled = features_of(np.concatenate([first.descriptors, first.descriptors]))
    before = matching.look(doubled.first(len(first)), twice.first(len(second)))
    closer, at_once = matching.look(doubled, twice, before), matching.look(doubled, twice)
    for name in ("nearest", "best", "second", "others"):
        np.testing.assert_array_equal(getattr(closer, name), getattr(at_once, name))


def test_a_closer_look_multiplies_only_what_is_new(monkeypatch):
    first, second = random_pair(6)
    before = matching.look(first.first(100), second.first(80))
    sizes = []
    two_nearest = matching._two_nearest

    def counted(queries, targets):
        sizes.append(len(queries) * len(targets))
        return two_nearest(queries, targets)

    monkeypatch.setattr(matching, "_two_nearest", counted)
    matching.look(first, second, before)
    assert sum(sizes) == len(first) * len(second) - 100 * 80


@pytest.mark.parametrize("wrong", [None, np.zeros((5, 128), np.float32)])
def test_what_are_no_features_is_refused(wrong):
    features = Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), np.zeros(0))
    with pytest.raises(ValueError, match="features2 must be Features, as extract_features gives"):
        match_features(features, wrong)
