# SPDX-License-Identifier: BSD-3-Clause
"""Many pairs at once give what each pair gives alone, on any number of threads."""

import threading
import time
from dataclasses import fields

import numpy as np
import pytest
from noisy_problems import noisy_scene

from epi360 import RansacOptions, estimate_relative_pose, estimate_relative_poses
from epi360.estimation.robust import estimate_timed_poses

SIZES = [200, 0, 37, 4, 900, 80, 8, 120]  # more than the search looks at, too few, none


def pairs_of(sizes):
    scenes = [
        noisy_scene(seed, 0.2, 0.3, num_matches=size) if size else noisy_scene(0, num_matches=1)
        for seed, size in enumerate(sizes)
    ]
    return [
        (scene.bearings1[:size], scene.bearings2[:size])
        for scene, size in zip(scenes, sizes, strict=True)
    ]


PAIRS = pairs_of(SIZES)
OFFSETS = np.concatenate([[0], np.cumsum(SIZES)])
JOINED = tuple(np.concatenate([pair[view] for pair in PAIRS]) for view in range(2))


def split(array):
    return [array[a:b] for a, b in zip(OFFSETS[:-1], OFFSETS[1:], strict=True)]


def assert_same_bits(found, expected):
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        for field in fields(a):
            x, y = getattr(a, field.name), getattr(b, field.name)
            if field.name == "cam2_from_cam1":
                np.testing.assert_array_equal(x.matrix(), y.matrix())
            elif field.name == "alternatives":
                assert len(x) == len(y)
                for one, other in zip(x, y, strict=True):
                    np.testing.assert_array_equal(one.matrix(), other.matrix())
            else:
                np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("num_threads", [None, 1, 2, 5])
def test_each_pair_is_what_a_single_call_gives_on_any_number_of_threads(num_threads):
    alone = [estimate_relative_pose(b1, b2, seed=7) for b1, b2 in PAIRS]
    assert {result.status for result in alone} >= {"ok", "too_few_matches"}
    together = estimate_relative_poses(PAIRS, seed=7, num_threads=num_threads)
    assert_same_bits(together, alone)
    joined = estimate_relative_poses(*JOINED, offsets=OFFSETS, seed=7, num_threads=num_threads)
    assert_same_bits(joined, alone)


def test_the_alternatives_of_a_plane_are_those_of_a_single_call():
    plane = noisy_scene(13, 0.1, 0.3, layout="plane")
    alone = estimate_relative_pose(plane.bearings1, plane.bearings2)
    assert alone.status == "planar_ambiguous" and len(alone.alternatives) == 1
    together = estimate_relative_poses([(plane.bearings1, plane.bearings2)] * 2)
    assert_same_bits(together, [alone, alone])


def test_results_have_the_length_and_order_of_the_pairs():
    results = estimate_relative_poses(PAIRS)
    assert [result.num_matches for result in results] == SIZES
    assert results[1].status == results[3].status == "too_few_matches"
    assert all(result.success for result in (results[0], results[4]))


def test_all_options_reach_every_pair():
    change = {
        "inlier_threshold_deg": 0.9,
        "residual": "angular",
        "options": RansacOptions(minimal_solver="eight_point", max_iterations=200),
        "seed": -3,
    }
    alone = [estimate_relative_pose(b1, b2, **change) for b1, b2 in PAIRS]
    assert_same_bits(estimate_relative_poses(PAIRS, **change), alone)


def test_weights_and_scores_belong_to_their_pair():
    rng = np.random.default_rng(0)
    weights, scores = rng.uniform(0.0, 1.0, OFFSETS[-1]), rng.normal(size=OFFSETS[-1])
    weights[::9], scores[5::17] = 0.0, np.nan
    alone = [
        estimate_relative_pose(b1, b2, weights=w, match_scores=s)
        for (b1, b2), w, s in zip(PAIRS, split(weights), split(scores), strict=True)
    ]
    listed = estimate_relative_poses(PAIRS, weights=split(weights), match_scores=split(scores))
    assert_same_bits(listed, alone)
    joined = estimate_relative_poses(*JOINED, offsets=OFFSETS, weights=weights, match_scores=scores)
    assert_same_bits(joined, alone)


@pytest.mark.parametrize("name", ["weights", "match_scores"])
def test_all_pairs_have_weights_or_none_has(name):
    values = [np.ones(size) for size in SIZES]
    values[3] = None
    with pytest.raises(ValueError, match=f"{name} must have an array for every pair .* pair 3"):
        estimate_relative_poses(PAIRS, **{name: values})


def test_no_pairs_make_no_results():
    assert estimate_relative_poses([]) == []
    assert estimate_relative_poses(np.zeros((0, 3)), np.zeros((0, 3)), offsets=[0]) == []
    assert estimate_relative_poses([], weights=[], match_scores=[]) == []


def test_pairs_may_come_from_a_generator_and_as_lists():
    expected = estimate_relative_poses(PAIRS[2:4])
    assert_same_bits(estimate_relative_poses(pair for pair in PAIRS[2:4]), expected)
    lists = [[b1.tolist(), b2.tolist()] for b1, b2 in PAIRS[2:4]]
    assert_same_bits(estimate_relative_poses(lists), expected)


def test_missing_rows_are_those_of_their_pair():
    b1 = JOINED[0].copy()
    b1[[1, 5, 201]] = np.nan
    results = estimate_relative_poses(b1, JOINED[1], offsets=OFFSETS)
    assert np.flatnonzero(np.isnan(results[0].residuals_rad)).tolist() == [1, 5]
    assert np.flatnonzero(np.isnan(results[2].residuals_rad)).tolist() == [1]
    assert results[0].warnings[0].startswith("2 of 200 matches are missing")


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.inf, r"pair 2: bearings2 must be finite .* row 4 is infinite"),
        (0.0, r"pair 2: bearings2 must have non-zero length .* row 4 is zero"),
    ],
)
def test_a_bad_row_is_named_with_its_pair(value, message):
    b2 = JOINED[1].copy()
    b2[OFFSETS[2] + 4] = value
    with pytest.raises(ValueError, match=message):
        estimate_relative_poses(JOINED[0], b2, offsets=OFFSETS)
    pairs = list(zip(split(JOINED[0]), split(b2), strict=True))
    with pytest.raises(ValueError, match=message):
        estimate_relative_poses(pairs)


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ((np.ones((4, 3)), np.ones((5, 3))), "pair 1: .* must have the same length, got 4 and 5"),
        ((np.ones((4, 2)), np.ones((4, 2))), r"pair 1: bearings1 must have shape \(N, 3\)"),
        ((np.ones((4, 3)),), "pair 1: "),
        (3, "pair 1: "),
    ],
)
def test_a_pair_of_wrong_shape_is_named(pair, message):
    with pytest.raises(ValueError, match=message):
        estimate_relative_poses([PAIRS[0], pair])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"offsets": [0, 200, 100, len(JOINED[0])]}, "offsets must rise from 0 to the length"),
        ({"offsets": [1, len(JOINED[0])]}, "offsets must rise .* got 1 to 1349 for 1349 and 1349"),
        ({"offsets": [0, 1000]}, "offsets must rise .* got 0 to 1000 for 1349 and 1349 rows"),
        ({"offsets": [0.0, 1349.0]}, r"offsets must be integers of shape \(P \+ 1,\), got float64"),
        ({"offsets": []}, r"offsets must be integers of shape \(P \+ 1,\)"),
        ({"offsets": [[0, 1349]]}, r"offsets must be integers .* got int64 \(1, 2\)"),
        ({"bearings2": None}, "offsets need bearings1 and bearings2 as two arrays"),
        ({"bearings2": JOINED[1][:-1]}, "got 0 to 1349 for 1349 and 1348 rows"),
        ({"weights": np.ones(3)}, r"weights must have shape \(1349,\), got \(3,\)"),
        ({"match_scores": np.ones(3)}, r"match_scores must have shape \(1349,\), got \(3,\)"),
    ],
)
def test_wrong_joined_arrays_are_refused(change, message):
    arguments = {"bearings1": JOINED[0], "bearings2": JOINED[1], "offsets": OFFSETS} | change
    with pytest.raises(ValueError, match=message):
        estimate_relative_poses(**arguments)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_threads": 0}, "num_threads must be a positive integer, got 0"),
        ({"num_threads": -2}, "num_threads must be a positive integer, got -2"),
        ({"num_threads": 2.0}, "num_threads must be a positive integer, got 2.0"),
        ({"weights": [np.ones(3)]}, "weights must have one array for each of 8 pairs, got 1"),
        ({"match_scores": []}, "match_scores must have one array for each of 8 pairs, got 0"),
        ({"weights": [np.ones(3)] * 8}, r"pair 0: weights must have shape \(200,\), got \(3,\)"),
        ({"bearings2": np.ones((3, 3))}, "bearings2 must come with offsets"),
        ({"residual": "tangent_sampson"}, "its Jacobians go with estimate_relative_pose"),
        ({"residual": "l2"}, "residual must be one of .* got 'l2'"),
        ({"inlier_threshold_deg": 90.0}, r"inlier_threshold_deg must be \"auto\" or in \(0, 45\]"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        estimate_relative_poses(PAIRS, **options)


def test_something_that_is_no_sequence_of_pairs_is_refused():
    with pytest.raises(ValueError, match=r"pairs must be a sequence of .*, got 3"):
        estimate_relative_poses(3)


def test_other_python_threads_run_during_a_long_call():
    # Random matches take all iterations: some 0.1 s a pair.
    rng = np.random.default_rng(0)
    pairs = [(rng.normal(size=(300, 3)), rng.normal(size=(300, 3))) for _ in range(6)]
    done, steps = threading.Event(), []

    def work():
        while not done.is_set():
            steps.append(time.perf_counter())
            time.sleep(0.001)

    helper = threading.Thread(target=work)
    helper.start()
    start = time.perf_counter()
    estimate_relative_poses(pairs, num_threads=1)
    stop = time.perf_counter()
    done.set()
    helper.join()
    during = [step for step in steps if start < step < stop]
    assert stop - start > 0.05
    assert len(during) > 10  # of some hundred: a call that holds the lock leaves one or two


def test_each_pair_may_have_its_own_seed():
    seeds = [2**64 - 1, 0, 3, 4, 5, 6, -7, 8]
    alone = [
        estimate_relative_pose(b1, b2, seed=seed)
        for (b1, b2), seed in zip(PAIRS, seeds, strict=True)
    ]
    assert_same_bits(estimate_relative_poses(PAIRS, seed=seeds, num_threads=3), alone)
    joined = estimate_relative_poses(*JOINED, offsets=OFFSETS, seed=np.array(seeds, dtype=object))
    assert_same_bits(joined, alone)
    shifted = estimate_relative_poses(PAIRS, seed=[seed + 1 for seed in seeds])
    assert any(
        a.num_iterations != b.num_iterations or (a.residuals_rad != b.residuals_rad).any()
        for a, b in zip(shifted, alone, strict=True)
    )


@pytest.mark.parametrize("seed", [[1, 2], [], [0.5] * 8, 0.5])
def test_seeds_are_one_or_one_for_each_pair(seed):
    with pytest.raises((TypeError, ValueError), match="one for each of 8 pairs|integer"):
        estimate_relative_poses(PAIRS, seed=seed)


def test_the_time_of_each_pair_comes_with_the_same_results():
    bearings1, bearings2 = zip(*PAIRS, strict=True)
    seeds = list(range(8))
    results, seconds = estimate_timed_poses(
        bearings1, bearings2, num_threads=2, options=RansacOptions(), seeds=seeds
    )
    assert_same_bits(results, estimate_relative_poses(PAIRS, seed=seeds))
    assert len(seconds) == 8
    assert all(0.0 <= each < 10.0 for each in seconds)
    assert seconds[4] > seconds[1]  # 900 matches, none
