# SPDX-License-Identifier: BSD-3-Clause
"""Which images of a map hang on one pair."""

from itertools import combinations, pairwise

import pytest

from epi360.jobs.mapping.lone_branches import Branch, lone_branches


def alone(names):
    """Every image is a moment of its own."""
    return {name: name for name in names}


def all_of(names):
    return list(combinations(names, 2))


def test_a_room_and_a_chain_that_leads_out_of_it():
    pairs = [*all_of("abcd"), ("e", "d"), ("e", "f"), ("f", "g"), ("b", "x")]
    assert lone_branches(pairs, alone("abcdefgx")) == (
        Branch(("e", "d"), ("e", "f", "g")),
        Branch(("b", "x"), ("x",)),
    )


def test_two_rooms_with_one_pair_between_them():
    pairs = [*all_of("abcd"), *all_of("xyz"), ("a", "x")]
    assert lone_branches(pairs, alone("abcdxyz")) == (Branch(("a", "x"), ("x", "y", "z")),)


@pytest.mark.parametrize("pairs", [[], all_of("abc"), [*pairwise("abcdef"), ("f", "a")]])
def test_where_every_image_has_two_ways_nothing_hangs(pairs):
    assert lone_branches(pairs, alone("abcdef")) == ()


def test_images_that_are_not_in_the_map_join_nothing():
    pairs = [*all_of("abc"), ("c", "d"), ("d", "x"), ("x", "a")]
    assert lone_branches(pairs, alone("abcdx")) == ()
    assert lone_branches(pairs, alone("abcd")) == (Branch(("c", "d"), ("d",)),)


def test_the_images_of_a_rig_hang_together():
    frames = {"left/0": 0, "right/0": 0, "left/1": 1, "right/1": 1, "left/2": 2, "right/2": 2}
    within = [(f"left/{k}", f"right/{k}") for k in range(3)]
    between = [("left/0", "left/1"), ("right/0", "right/1"), ("left/1", "left/2")]
    assert lone_branches([*within, *between], frames) == (
        Branch(("left/1", "left/2"), ("left/2", "right/2")),
    )
    assert lone_branches([*within, *between, ("right/2", "left/0")], frames) == ()


def test_a_chain_hangs_on_both_pairs_of_one_of_its_images():
    found = lone_branches(list(pairwise("abcde")), alone("abcde"))
    assert sum(len(branch.images) for branch in found) == 4


def test_a_long_chain_is_quick():
    names = [f"{k:05d}" for k in range(20_000)]
    (branch,) = lone_branches([*all_of(names[:3]), *pairwise(names[2:])], alone(names))
    assert len(branch.images) == 19_997
