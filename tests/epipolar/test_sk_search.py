# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from exact_matches import any_turn, disturbed, exact_matches

from epi360.epipolar import SkCost, eight_point, paper_residuals, search_sk
from epi360.epipolar.sk_search import line_search
from epi360.synthetic import two_view_scene


def scene(seed, outliers=0.2, layout="room", num_matches=200):
    found = two_view_scene(
        seed, num_matches=num_matches, layout=layout, kappa=500, outlier_ratio=outliers
    )
    return found.bearings1, found.bearings2


def best_of_grid(cost):
    return min(cost.at(u) for u in np.linspace(-4.0, 4.0, 41))


def test_the_cost_is_the_sum_of_residuals_of_the_normalised_eight_point():
    b1, b2 = scene(0)
    E = eight_point(b1, b2, (1.0, 0.3)).E
    expected = np.abs(paper_residuals(E, b1, b2)).sum()
    cost = SkCost(b1, b2)
    np.testing.assert_allclose(cost(1.0, 0.3), expected, rtol=1e-10)
    np.testing.assert_allclose(cost(7.0, -2.1), expected, rtol=1e-10)
    assert cost.num_evaluations == 2


@pytest.mark.parametrize("search", ["line", "lm"])
@pytest.mark.parametrize("layout", ["room", "cone"])
@pytest.mark.parametrize("outliers", [0.0, 0.2, 0.5])
def test_the_search_is_never_worse_than_the_plain_8pa(search, layout, outliers):
    for seed in range(5):
        b1, b2 = scene(seed, outliers, layout)
        S, K, value, evaluations = search_sk(b1, b2, search)
        cost = SkCost(b1, b2)
        np.testing.assert_allclose(cost(S, K), value, rtol=1e-9)
        assert value <= cost(1.0, 1.0)
        assert evaluations <= (15 if search == "line" else 100)


def test_the_line_search_finds_the_best_of_a_dense_grid_more_often_than_lm():
    above = {"line": [], "lm": []}
    for seed in range(20):
        for layout, outliers in (("room", 0.5), ("cone", 0.2)):
            b1, b2 = scene(seed, outliers, layout)
            best = best_of_grid(SkCost(b1, b2))
            for search, found in above.items():
                found.append(search_sk(b1, b2, search)[2] > 1.014 * best)
    # Of 100 scenes of each kind: 3 % against 21 %.
    assert np.mean(above["line"]) < 0.1
    assert np.mean(above["lm"]) > np.mean(above["line"])


def test_a_parabola_is_solved_to_the_width_of_its_last_bracket():
    for lowest in (-2.1, -1.0, 0.1, 0.5, 1.7):
        u, value = line_search(lambda u, at=lowest: 3.0 + (u - at) ** 2)
        # Two steps inside 1e-3 of the lowest point are golden sections.
        assert abs(u - lowest) < 1e-6 and abs(value - 3.0) < 1e-12


def test_the_search_goes_one_step_beyond_either_end_of_its_grid():
    seen = []

    def falling(u):
        seen.append(u)
        return -u

    assert line_search(falling) == (4.0, -4.0) and len(seen) == 9
    assert line_search(lambda u: u)[0] == -5.0
    u, _ = line_search(lambda u: (u - 2.6) ** 2)
    assert abs(u - 2.6) < 1e-6


def test_of_equal_values_the_one_without_normalisation_is_kept():
    assert line_search(lambda u: 1.0) == (0.0, 1.0)


@pytest.mark.parametrize("search", ["line", "lm"])
def test_sk_follows_swapped_views_and_turns_about_z_but_no_others(search):
    b1, b2, _, _ = exact_matches(0, 100)
    b2 = disturbed(b2, 3.0, 0)
    E = eight_point(b1, b2, "sk", sk_search=search).E

    def apart(other):
        return min(np.abs(other - E).max(), np.abs(other + E).max())

    # The cost is the sine in view 2: a swap changes it, so both ends are close, not equal.
    assert apart(eight_point(b2, b1, "sk", sk_search=search).E.T) < 0.1
    c, s = np.cos(1.0), np.sin(1.0)
    z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = eight_point(b1 @ z.T, b2 @ z.T, "sk", sk_search=search).E
    # The search sees the same costs but for rounding, which derivatives of step 1e-6 amplify.
    assert apart(z.T @ turned @ z) < (1e-9 if search == "line" else 1e-4)
    turn = any_turn(1)
    turned = eight_point(b1 @ turn.T, b2 @ turn.T, "sk", sk_search=search).E
    assert apart(turn.T @ turned @ turn) > 1e-3


def test_eight_matches_are_searched_without_a_null_space_of_two():
    b1, b2, pose, _ = exact_matches(3, 8)
    for search in ("line", "lm"):
        S, K, value, _ = search_sk(b1, b2, search)
        assert value < 1e-9 and S != 0.0 and K != 0.0


def test_the_search_refuses_unknown_names_and_too_few_matches():
    b1, b2 = scene(0)
    with pytest.raises(ValueError, match="sk_search must be one of line, lm, got 'newton'"):
        search_sk(b1, b2, "newton")
    with pytest.raises(ValueError, match="at least 8 matches, got 7"):
        search_sk(b1[:7], b2[:7])
