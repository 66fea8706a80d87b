# SPDX-License-Identifier: BSD-3-Clause
"""Panoramas are put together surest first, by made pairs and made evidence."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from epi360.jobs.graph import place_groups
from epi360.jobs.graph.surface_evidence import Sibling
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector

NOBODY = np.empty(0, np.int64)
# Where ratios depend on nobody, hearsay is what is known, and a share of it is added.
HEARD = 1.6


def turned(degrees):
    return rotation_from_vector([0.0, np.radians(degrees), 0.0])


def pair_of(images, degrees=0.0, *, sigma_deg=0.1):
    """A pair of which only the images and the rotation matter, about the vertical."""
    pose = Pose(turned(degrees), [0.0, 0.0, 1.0])
    return PosedPair(images, pose, (NOBODY,) * 2, (np.empty((0, 3)),) * 2, 0.1, sigma_deg, 0.1)


def told_of(siblings, witnesses):
    return [
        place_groups.Testimony(links, asked)
        for links, asked in zip(siblings, witnesses, strict=True)
    ]


def groups_of(pairs, ratios, least, siblings=None):
    """Pairs whose ratios depend on nobody."""
    links = siblings or [()] * len(pairs)
    told = told_of(links, [set()] * len(pairs))
    return place_groups.put_together(pairs, told, lambda row, _: ratios[row], least)


def test_panoramas_are_joined_by_what_is_sure_enough():
    pairs = [pair_of(images) for images in ((0, 1), (1, 2), (2, 3), (4, 5))]
    groups = groups_of(pairs, [5.0, 0.5, 2.0, 1.0], 1.0)
    assert groups.joined.tolist() == [True, False, True, True]
    np.testing.assert_allclose(
        groups.ratios, np.array([5.0, 0.5, 2.0, 1.0]) * [HEARD, 1, HEARD, HEARD]
    )


def test_without_pairs_there_are_no_groups():
    groups = groups_of([], [], 0.0)
    assert len(groups.joined) == len(groups.ratios) == 0
    assert (groups.num_contradicting, groups.num_loops) == (0, 0)


def test_pairs_beyond_those_that_join_the_panoramas_of_groups_close_loops():
    chain, ring = [(0, 1), (1, 2), (2, 3)], [(4, 5), (5, 6), (4, 6), (6, 5)]
    for images, num_loops in ((chain, 0), (ring, 2), (chain + ring, 2)):
        pairs = [pair_of(each) for each in images]
        groups = groups_of(pairs, [5.0] * len(pairs), -np.inf)
        assert (groups.num_contradicting, groups.num_loops) == (0, num_loops)
    apart = groups_of([pair_of((0, 1)), pair_of((1, 2)), pair_of((0, 2))], [-5.0] * 3, 0.0)
    assert apart.num_loops == 0


def test_a_pair_that_turns_a_panorama_otherwise_than_surer_ones_contradicts_them():
    pairs = [pair_of((0, 1), 30), pair_of((1, 2), 40), pair_of((0, 2), 70), pair_of((2, 0), 90)]
    groups = groups_of(pairs, [5.0, 4.0, 3.0, 2.0], 0.0)
    assert groups.joined.tolist() == [True, True, True, False]
    assert groups.ratios.tolist() == [5.0 * HEARD, 4.0 * HEARD, 3.0, -np.inf]
    assert {row: sorted(way) for row, way in groups.ways.items()} == {3: [0, 1]}
    assert (groups.num_contradicting, groups.num_loops) == (1, 2)


@pytest.mark.parametrize("sigma_deg, is_kept", [(0.1, False), (4.0, True)])
def test_a_loop_may_be_as_far_open_as_its_pairs_are_unsure(sigma_deg, is_kept):
    angles = [(0, 1, 0), (1, 2, 0), (2, 3, 0), (0, 3, 15)]
    pairs = [pair_of((a, b), angle, sigma_deg=sigma_deg) for a, b, angle in angles]
    assert groups_of(pairs, [5.0, 5.0, 5.0, 4.0], 0.0).joined[3] == is_kept


def all_between(first, second):
    return [(a, b) for a in first for b in second]


def test_pairs_that_say_the_same_are_weighed_together():
    pairs = [pair_of(images) for images in [(0, 1), *all_between((0, 1), (2,))]]
    ratios = [5.0, 0.6, 0.6]
    linked = [(), (Sibling(2, via=0),), (Sibling(1, via=0),)]
    assert groups_of(pairs, ratios, 1.0).joined.tolist() == [True, False, False]
    groups = groups_of(pairs, ratios, 1.0, linked)
    assert groups.joined.all()
    # Two that are correlated say less than twice as much.
    assert groups.ratios[1] == groups.ratios[2] == pytest.approx(HEARD * 2 * 0.6 / 1.15)


def test_they_say_the_same_only_if_what_leads_from_one_to_the_other_is_joined():
    pairs = [pair_of(images) for images in [(0, 1), *all_between((0, 1), (2,))]]
    linked = [(), (Sibling(2, via=0),), (Sibling(1, via=0),)]
    assert not groups_of(pairs, [0.5, 0.6, 0.6], 1.0, linked).joined.any()


def test_one_poor_pose_among_good_ones_is_accepted_with_them_and_not_heard():
    pairs = [
        pair_of(images) for images in [*combinations((0, 1, 2), 2), *all_between((0, 1, 2), (3,))]
    ]
    linked = [()] * 3 + [
        tuple(Sibling(3 + other, via) for other, via in links)
        for links in (((1, 0), (2, 1)), ((0, 0), (2, 2)), ((0, 1), (1, 2)))
    ]
    groups = groups_of(pairs, [9.0, 9.0, 9.0, 3.0, 3.0, -40.0], 0.5, linked)
    assert groups.joined.tolist() == [True] * 5 + [False]
    assert groups.ratios[3] == groups.ratios[4] == groups.ratios[5] > 0.5


def copies():
    """Two rooms of three panoramas that are copies: pairs, and which are right."""
    images = list(combinations(range(6), 2))
    is_right = np.array([a // 3 == b // 3 for a, b in images])

    def ratio_of(row, joined):
        """Pairs within a room know what the other room lacks; pairs across know what both have."""
        near = [k for k in np.flatnonzero(joined) if set(images[k]) & set(images[row]) and k != row]
        if is_right[row]:
            return 1.5 + 0.5 * len(near)
        return 1.0 + sum(-2.0 if is_right[k] else 3.0 for k in near)

    return [pair_of(pair) for pair in images], is_right, ratio_of


def test_rooms_that_are_copies_stay_apart_though_their_pairs_witness_for_each_other():
    pairs, is_right, ratio_of = copies()
    everyone = np.ones(len(pairs), dtype=bool)
    assert min(ratio_of(row, everyone) for row in np.flatnonzero(~is_right)) > 1.0
    others = [set(range(len(pairs))) - {row} for row in range(len(pairs))]
    told = told_of([()] * len(pairs), others)
    groups = place_groups.put_together(pairs, told, ratio_of, 1.0)
    assert groups.joined.tolist() == is_right.tolist()
    assert groups.ratios[~is_right].max() < 0.0


def test_what_is_joined_is_heard_again_when_more_is_known():
    """The first of two pairs looks good alone, until the other knows better."""
    pairs = [pair_of((0, 1)), pair_of((1, 2))]

    def ratio_of(row, joined):
        return 5.0 if row == 1 else -20.0 if joined[1] else 9.0

    told = told_of([()] * 2, [{1}, {0}])
    groups = place_groups.put_together(pairs, told, ratio_of, 1.0)
    assert groups.ratios.tolist() == [-20.0, 5.0 * HEARD]


@pytest.mark.parametrize("is_implied", [True, False])
def test_a_pair_that_looks_poor_at_last_is_accepted_only_if_joined_ones_imply_it(is_implied):
    pairs = [pair_of(images) for images in ((0, 1), (1, 2), (0, 2))]
    links = [(), (Sibling(2, via=0),), (Sibling(1, via=0),)] if is_implied else [()] * 3

    def ratio_of(row, joined):
        return (5.0, 4.5, -9.0 if joined[1] else 4.0)[row]

    told = told_of(links, [{1}] * 3)
    groups = place_groups.put_together(pairs, told, ratio_of, 1.0)
    assert groups.ratios[2] == (groups.ratios[1] if is_implied else -9.0)
    assert groups.ratios[1] > 4.0


@pytest.mark.parametrize("witness", [0, 1])
def test_what_becomes_known_is_heard_at_once(witness):
    """The first pair joins two groups, the second lies within; the third hears one of them."""
    pairs = [pair_of(images) for images in ((0, 1), (0, 1), (0, 2))]

    def ratio_of(row, joined):
        return (5.0, 4.0, 3.0 * joined[witness])[row]

    told = told_of([()] * 3, [set(), set(), {witness}])
    groups = place_groups.put_together(pairs, told, ratio_of, 1.0)
    assert groups.joined.all()
    np.testing.assert_allclose(groups.ratios, [5.0 * HEARD, 4.0, 3.0 * HEARD])


def test_where_nothing_is_known_hearsay_decides():
    pairs = [pair_of((0, 1), 90), pair_of((0, 2)), pair_of((1, 2))]

    def ratio_of(row, joined):
        if row == 0:
            return -3.0 * joined[1:].sum()
        return 2.0 * joined[3 - row] - joined[0]

    told = told_of([()] * 3, [{1, 2}, {0, 2}, {0, 1}])
    groups = place_groups.put_together(pairs, told, ratio_of, 0.0)
    assert groups.joined.tolist() == [False, True, True]
    assert groups.ratios[0] == -np.inf


def random_world(rng, num):
    """Rotations of panoramas, all pairs of which agree."""
    rotations = [rotation_from_vector(rng.normal(size=3)) for _ in range(num)]
    pairs = []
    for a, b in combinations(range(num), 2):
        pose = Pose(rotations[b] @ rotations[a].T, [0.0, 0.0, 1.0])
        pair = PosedPair((a, b), pose, (NOBODY,) * 2, (np.empty((0, 3)),) * 2, 0.1, 0.1, 0.1)
        pairs.append(pair if rng.random() < 0.5 else swapped(pair))
    return pairs


def swapped(pair):
    return replace(pair, images=pair.images[::-1], cam2_from_cam1=pair.cam2_from_cam1.inverse())


@pytest.mark.parametrize("seed", range(10))
def test_panoramas_that_are_turned_anyhow_agree(seed):
    rng = np.random.default_rng(seed)
    pairs = random_world(rng, 9)
    groups = groups_of(pairs, rng.uniform(0, 5, len(pairs)), -1.0)
    assert groups.joined.all()


@pytest.mark.parametrize("seed", range(5))
def test_numbers_of_panoramas_mean_nothing(seed):
    rng = np.random.default_rng(seed)
    pairs = random_world(rng, 8)
    off = rotation_from_vector([0.0, np.radians(8.3), 0.0])  # about what chains may be off
    bent = [
        replace(pair, cam2_from_cam1=Pose(off @ pair.cam2_from_cam1.rotation, [0.0, 0.0, 1.0]))
        if rng.random() < 0.4
        else pair
        for pair in pairs
    ]
    ratios = rng.permutation(np.linspace(0.0, 6.0, len(bent)))
    expected = groups_of(bent, ratios, -1.0)
    assert 7 <= expected.joined.sum() < len(bent)
    names = rng.permutation(8)
    renamed = [replace(pair, images=tuple(int(names[k]) for k in pair.images)) for pair in bent]
    np.testing.assert_array_equal(groups_of(renamed, ratios, -1.0).joined, expected.joined)


@pytest.mark.parametrize("seed", range(5))
def test_neither_the_order_of_pairs_nor_that_of_their_images_matters(seed):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-180, 180, 8)
    images = list(combinations(range(8), 2))
    ratios = rng.permutation(np.linspace(-3, 6, len(images)))
    off = np.where(rng.random(len(images)) < 0.4, rng.uniform(30, 330, len(images)), 0.0)
    pairs = [
        pair_of((a, b), angles[b] - angles[a] + o) for (a, b), o in zip(images, off, strict=True)
    ]
    expected = groups_of(pairs, ratios, 0.5)
    assert np.isneginf(expected.ratios).any()
    order = rng.permutation(len(images))
    told = []
    for row in order:
        told.append(swapped(pairs[row]) if rng.random() < 0.5 else pairs[row])
    found = groups_of(told, ratios[order], 0.5)
    np.testing.assert_array_equal(found.joined, expected.joined[order])
    np.testing.assert_allclose(found.ratios, expected.ratios[order])
