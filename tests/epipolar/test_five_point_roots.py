# SPDX-License-Identifier: BSD-3-Clause
"""The five-point solver finds every real root, also where its polynomial is no ordinary one."""

import numpy as np
import pytest
from exact_matches import any_pose

from epi360 import _core
from epi360.epipolar import essential_from_pose
from epi360.poses import Pose

LINE = np.array([1.0, 2.0, 3.0]), np.array([1.0, -1.0, 0.5])
KINDS = (
    "anywhere",
    "wrong matches",
    "forward motion",
    "two equal",
    "three equal",
    "all equal",
    "three on a line",
    "on a line",
    "on a plane",
    "far away",
    "no motion",
)
# Five distinct points or a plane determine the pose up to ten essential matrices.
DETERMINED = ("anywhere", "forward motion", "three on a line", "on a plane")


def five_matches(kind, seed):
    rng = np.random.default_rng(seed)
    points, pose = rng.normal(size=(5, 3)), any_pose(seed)
    on_a_line = LINE[0] + np.outer(rng.normal(size=5), LINE[1])
    num_equal = {"two equal": 2, "three equal": 3, "all equal": 5}.get(kind, 1)
    points[:num_equal] = points[0]
    num_on_line = {"three on a line": 3, "on a line": 5}.get(kind, 0)
    points[:num_on_line] = on_a_line[:num_on_line]
    if kind == "on a plane":
        points[:, 2] = 2.0
    if kind == "far away":
        points *= 1e8
    if kind == "forward motion":
        pose = Pose(np.eye(3), [0.0, 0.0, 1.0])
    if kind == "no motion":
        pose = Pose(np.eye(3), np.zeros(3))
    seen = points @ pose.rotation.T + pose.translation
    if kind == "wrong matches":
        seen = rng.normal(size=(5, 3))
    return unit(points), unit(seen), pose


def unit(vectors):
    return np.ascontiguousarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def normalised(matrices):
    return [np.sqrt(2.0) * E / np.linalg.norm(E) for E in matrices]


def distance(E, other):
    """Difference of two essential matrices of one norm, up to sign."""
    return min(np.abs(E - other).max(), np.abs(E + other).max())


@pytest.mark.parametrize("kind", KINDS)
def test_every_solution_fits_the_matches_and_is_an_essential_matrix(kind):
    for seed in range(40):
        b1, b2, _ = five_matches(kind, seed)
        solutions = _core.five_point(b1, b2)
        assert (1 if kind in DETERMINED else 0) <= len(solutions) <= 10
        for E in normalised(solutions):
            np.testing.assert_allclose(np.einsum("ij,jk,ik->i", b2, E, b1), 0.0, atol=1e-14)
            # Up to 1e-5 where two roots meet; others are refused by the solver.
            singular = np.linalg.svd(E)[1]
            np.testing.assert_allclose(singular, [1.0, 1.0, 0.0], atol=1e-5)


@pytest.mark.parametrize("kind", DETERMINED)
def test_the_truth_is_among_the_solutions(kind):
    for seed in range(100):
        b1, b2, pose = five_matches(kind, seed)
        truth = essential_from_pose(pose)
        # Five points of a plane have a double root, which halves the digits.
        atol = 1e-5 if kind == "on a plane" else 1e-7
        assert min(distance(E, truth) for E in normalised(_core.five_point(b1, b2))) < atol


def test_solutions_are_distinct_and_come_in_pairs():
    counts = []
    for seed in range(200):
        b1, b2, _ = five_matches("anywhere", seed)
        solutions = normalised(_core.five_point(b1, b2))
        for k, E in enumerate(solutions):
            assert all(distance(E, other) > 1e-7 for other in solutions[:k])
        counts.append(len(solutions))
    # Complex roots of a real polynomial of degree ten come in pairs, so the real ones do.
    assert all(count % 2 == 0 for count in counts)
    # Nister (2004): 4.55 on average, for random motions and points.
    assert 3.5 < np.mean(counts) < 5.5


@pytest.mark.parametrize("kind", ["anywhere", "on a plane", "three on a line"])
def test_the_order_of_the_matches_does_not_matter(kind):
    num_alone = num_all = 0
    for seed in range(40):
        b1, b2, _ = five_matches(kind, seed)
        order = np.random.default_rng(seed).permutation(5)
        solutions = normalised(_core.five_point(b1, b2))
        shuffled = normalised(_core.five_point(b1[order], b2[order]))
        # Rounding may lose both of two roots that nearly meet, never one that stands alone.
        alone = [E for E in solutions if sum(distance(E, other) < 1e-3 for other in solutions) == 1]
        for E in alone:
            assert min(distance(E, other) for other in shuffled) < 1e-4
        num_alone, num_all = num_alone + len(alone), num_all + len(solutions)
    assert num_alone > 0.9 * num_all > 150  # measured: all of 188 to 207


def test_swapping_the_views_transposes_the_solutions():
    for seed in range(40):
        b1, b2, pose = five_matches("anywhere", seed)
        backward = normalised(_core.five_point(b2, b1))
        truth = essential_from_pose(pose).T
        assert len(backward) == len(_core.five_point(b1, b2))
        assert min(distance(E, truth) for E in backward) < 1e-7
