# SPDX-License-Identifier: BSD-3-Clause
"""How often a wrong match of a point in a map agrees with a pose by chance."""

import numpy as np
import pytest
from seen_points import directions

from epi360.estimation.absolute_evidence import chance_of_agreement


@pytest.mark.parametrize("num_matches", [2, 49, 50, 173])
def test_chance_is_the_share_of_exchanged_partners_in_the_densest_circle(num_matches):
    rng = np.random.default_rng(num_matches)
    bearings, seen = (directions(rng, num_matches) + [0.0, 0.0, 2.0] for _ in range(2))
    bearings, seen = (
        each / np.linalg.norm(each, axis=1, keepdims=True) for each in (bearings, seen)
    )
    gate = np.radians(3.0)
    angles = np.array(
        [
            np.arccos(np.clip(bearings[i] @ seen[j], -1.0, 1.0))
            for i in range(num_matches)
            for j in range(num_matches)
            if i != j
        ]
    )
    area = 1.0 - np.cos(gate)
    densities = [0.5]
    densities += [np.mean(angles < r) / (1.0 - np.cos(r)) for r in np.radians([3, 5, 10, 20])]
    assert chance_of_agreement(bearings, seen, gate) == pytest.approx(max(densities) * area)


def test_partners_of_their_own_are_no_chance():
    bearings = directions(np.random.default_rng(0), 120)
    assert chance_of_agreement(bearings, bearings, np.radians(0.1)) < 0.001
    assert chance_of_agreement(bearings[:1], bearings[:1], 0.1) == 1.0
