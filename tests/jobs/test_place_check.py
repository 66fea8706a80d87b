# SPDX-License-Identifier: BSD-3-Clause
"""Pairs whose surroundings look different are refused, by made evidence."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from made_surroundings import (
    LITTLE_GROWS,
    NOTHING_GROWS,
    evidence_on,
    judged,
    nothing,
    pairs_of_twin_rooms,
    posed,
    shows,
    sightings,
    surfaces_of,
)

from epi360.jobs.graph.place_check import judge_places, leave_a_doubt
from epi360.jobs.graph.place_evidence import Evidence
from epi360.jobs.graph.place_verdict import ANOTHER_PLACE, COPY
from epi360.poses import rotation_from_vector


@pytest.mark.parametrize("seed", range(10))
def test_where_all_looks_the_same_nothing_is_refused(seed):
    pairs = list(combinations(range(6), 2))
    verdicts = judged(pairs, evidence_on(pairs, [1.0] * len(pairs), seed=seed))
    assert not any(verdict.refused for verdict in verdicts)
    assert min(verdict.share for verdict in verdicts) > 0.8


@pytest.mark.parametrize("share", [0.3, 0.6])
@pytest.mark.parametrize("seed", range(5))
def test_pairs_of_twin_rooms_are_refused_and_hardly_any_of_one_room(share, seed):
    pairs, is_right = pairs_of_twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, share), seed=seed)
    verdicts = judged(pairs, found)
    kept = np.array([not verdict.refused for verdict in verdicts])
    assert not kept[~is_right].any()
    assert np.sum(~kept[is_right]) <= 1
    assert all(each.refused.startswith((ANOTHER_PLACE, COPY)) for each in verdicts if each.refused)


@pytest.mark.parametrize("seed", range(5))
def test_twin_rooms_stay_apart_where_pairs_show_nothing_by_themselves(seed):
    images, is_right = pairs_of_twin_rooms()
    order = np.random.default_rng(seed).permutation(len(images))
    images, is_right = [images[row] for row in order], is_right[order]
    found = evidence_on(images, np.where(is_right, 1.0, 0.5), seed=seed)
    found = [replace(each, own=NOTHING_GROWS) for each in found]
    refused = np.array([bool(verdict.refused) for verdict in judged(images, found)])
    assert refused[~is_right].all()


def test_a_pair_about_which_nothing_is_known_is_refused_only_where_copies_are():
    pairs, is_right = pairs_of_twin_rooms()
    told = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    assert judged(pairs, told)[0].refused.startswith(COPY)
    verdicts = judged(pairs, evidence_on(pairs, [1.0] * len(pairs), silent=[0]))
    assert not verdicts[0].refused and np.isnan(verdicts[0].share)


def test_what_only_one_of_both_views_shows_speaks_for_no_pair():
    pairs, is_right = pairs_of_twin_rooms()
    shares = np.where(is_right, 1.0, 0.4)
    found = evidence_on(pairs, shares, one_sided=[0])
    found[0] = replace(found[0], own=LITTLE_GROWS)
    assert judged(pairs, found)[0].refused.startswith(COPY)
    found = evidence_on(pairs, shares)
    found[0] = replace(found[0], own=LITTLE_GROWS)
    assert not judged(pairs, found)[0].refused


def test_a_pair_that_turns_its_panoramas_otherwise_than_surer_ones_is_refused():
    images = list(combinations(range(4), 2))
    found = evidence_on(images, [1.0] * len(images))
    upside_down = np.diag([-1.0, -1.0, 1.0])
    pairs = [posed(pair) for pair in images]
    pairs[2] = posed(images[2], turn=upside_down)
    found[2] = replace(found[2], own=NOTHING_GROWS)
    verdicts = judge_places(pairs, found).verdicts
    assert "turn its panoramas otherwise" in verdicts[2].refused
    assert_leads(images[2], [images[row] for row in verdicts[2].against])
    assert verdicts[2].probability == 0.0
    assert [bool(verdict.refused) for verdict in verdicts] == [row == 2 for row in range(6)]


def assert_leads(ends, way):
    """Pairs that lead from one panorama to another."""
    links = [set(pair) for pair in way]
    assert links
    at = {ends[0]}
    for _ in range(len(links)):
        (link,) = [each for each in links if each & at][:1]
        links.remove(link)
        at = link - at
    assert at == {ends[1]}


def test_points_that_something_may_hide_say_nothing():
    pairs = list(combinations(range(5), 2))
    found = evidence_on(pairs, [0.2] * len(pairs), beyond=0.5)
    assert {verdict.num_places for verdict in judged(pairs, found)} == {0}


def test_somebody_who_walks_about_does_not_refuse_pairs():
    pairs = list(combinations(range(6), 2))
    found = evidence_on(pairs, [0.92] * len(pairs))
    assert not any(verdict.refused for verdict in judged(pairs, found))


def test_what_a_pair_shows_by_itself_counts_where_nobody_else_knows_anything():
    pairs, is_right = pairs_of_twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    for own, is_enough in (
        (shows(8.0, 0.0), False),  # not another place, but maybe a copy
        (shows(0.0, 5.0), False),
        (shows(8.0, 5.0), True),
    ):
        found[0] = replace(found[0], own=own)
        assert bool(judged(pairs, found)[0].refused) != is_enough


def test_surfaces_of_other_pairs_speak_for_and_against_a_pair():
    pairs, is_right = pairs_of_twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    told = []
    for ratio in (-3.0, 0.0, 2.0):
        found[0] = replace(found[0], surfaces=(surfaces_of([1, 2], ratio),) * 2)
        told.append(judged(pairs, found)[0].probability)
    assert told[0] < told[1] - 0.1 and told[1] + 0.1 < told[2]


def test_what_moves_is_no_copy_where_most_pairs_are_in_the_open():
    pairs, is_right = pairs_of_twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    outdoors = [replace(each, own=replace(each.own, in_the_open=True)) for each in found]
    differs = shows(8.0, 1.0, in_the_open=True)  # as if its owners had put other things there
    in_a_home, in_a_street = (
        judged(pairs, [replace(folder[0], own=differs), *folder[1:]])[0]
        for folder in (found, outdoors)
    )
    assert in_a_home.refused.startswith(COPY) and not in_a_street.refused


def doubted(share):
    """Evidence on a further pair, by pairs of both of its panoramas."""
    rng = np.random.default_rng(5)
    sides = sightings(rng, [0, 1], share), sightings(rng, [3, 4], share)
    return Evidence(sides, own=shows(2.4, 2.4))


def test_doubted_poses_are_judged_by_what_the_others_know():
    pairs = list(combinations(range(4), 2))
    found = evidence_on(pairs, [1.0] * len(pairs))
    told = [doubted(1.0), doubted(0.6), Evidence((nothing(), nothing()))]
    verdicts = judge_places([posed(pair) for pair in pairs], found).on_doubted(told)
    assert [bool(verdict.refused) for verdict in verdicts] == [False, True, True]
    assert verdicts[-1].probability == pytest.approx(0.5)  # half of them are wrong


@pytest.mark.parametrize("row", range(6))
def test_one_wrong_pair_is_refused_wherever_it_stands(row):
    images = list(combinations(range(4), 2))
    found = evidence_on(images, [0.3 if k == row else 1.0 for k in range(6)])
    found = [replace(each, own=NOTHING_GROWS) for each in found]
    assert leave_a_doubt([posed(pair) for pair in images], found)
    assert [bool(verdict.refused) for verdict in judged(images, found)] == [
        k == row for k in range(6)
    ]


def test_where_all_looks_the_same_no_doubt_is_left():
    images = list(combinations(range(6), 2))
    assert not leave_a_doubt([posed(pair) for pair in images], evidence_on(images, [1.0] * 15))


def test_what_pictures_leave_open_is_no_sign_of_copies_where_nothing_contradicts():
    """Half of the pairs look a little more like copies than like one room."""
    images = list(combinations(range(12), 2))
    owns = [shows(3.0, -1.2)] * 33 + [shows(3.0, 2.0)] * 33
    found = [Evidence((nothing(), nothing()), own=own) for own in owns]
    assert not any(each.refused for each in judged(images, found))


def with_turned_pairs(num_turned, own):
    """Pairs of eight panoramas, and more that turn them in all ways, with what they show."""
    images = list(combinations(range(8), 2))
    owns = [own if 9 <= row < 14 else shows(8.0, 5.0) for row in range(len(images))]
    turns = [rotation_from_vector([0.0, 0.8 * (row + 1), 0.0]) for row in range(num_turned)]
    pairs = [posed(pair) for pair in images]
    pairs += [posed(pair, turn=turn) for pair, turn in zip(images[14:], turns, strict=False)]
    owns += [shows(3.0, -1.0)] * num_turned
    return pairs, [Evidence((nothing(), nothing()), own=own) for own in owns]


@pytest.mark.parametrize("num_turned", [0, 4, 8, 14])
def test_where_loops_contradict_pairs_are_weighed_as_in_homes_with_copies(num_turned):
    """With five loops added, 4 of 30 are no sign of copies, and 8 of 34 are one."""
    pairs, found = with_turned_pairs(num_turned, shows(6.0, 4.0, as_in_homes=(3.0, -3.0)))
    refused = np.array([bool(each.refused) for each in judge_places(pairs, found).verdicts])
    assert refused[9:14].tolist() == [num_turned >= 8] * 5
    assert not refused[:9].any() and not refused[14:28].any()
    assert refused[28:].all()


def test_few_loops_do_not_say_that_there_are_copies():
    """A chain of ten panoramas and one pair that contradicts it."""
    images = [(row, row + 1) for row in range(10)]
    pairs = [*map(posed, images), posed((0, 2), turn=rotation_from_vector([0.0, 1.0, 0.0]))]
    owns = [shows(6.0, 4.0, as_in_homes=(3.0, -3.0))] * 10 + [shows(3.0, -1.0)]
    found = [Evidence((nothing(), nothing()), own=own) for own in owns]
    refused = [bool(each.refused) for each in judge_places(pairs, found).verdicts]
    assert refused == [False] * 10 + [True]


def test_pairs_on_one_wall_do_not_say_that_pictures_are_clear():
    images = list(combinations(range(8), 2))
    wall = shows(3.0, 3.0, as_in_homes=(8.0, 8.0), on_one_wall=True)
    owns = [wall] * 4 + [shows(6.0, 4.0, as_in_homes=(3.0, -3.0))] * 24
    found = [Evidence((nothing(), nothing()), own=own) for own in owns]
    assert not any(each.refused for each in judged(images, found))


@pytest.mark.parametrize("are_clear", [False, True])
def test_clear_pictures_are_weighed_as_in_homes(are_clear):
    images = list(combinations(range(8), 2))
    clear = shows(8.0, 7.0, as_in_homes=(8.0, 9.0 if are_clear else 5.0))
    differs = shows(8.0, 7.0, as_in_homes=(8.0, -4.0))
    found = [Evidence((nothing(), nothing()), own=own) for own in [differs] * 8 + [clear] * 20]
    refused = [bool(each.refused) for each in judged(images, found)]
    assert refused[:8] == [are_clear] * 8 and not any(refused[8:])


@pytest.mark.parametrize("num_clear", [0, 1])
def test_of_few_pairs_one_shows_that_pictures_are_clear(num_clear):
    """What a copy shows is weighed as in homes, if another pair of the folder shows what it is."""
    sees_all = shows(8.0, 7.0, as_in_homes=(8.0, 9.0 if num_clear else 5.0))
    owns = [sees_all, shows(8.0, 1.0, as_in_homes=(8.0, -4.0))]
    found = [Evidence((nothing(), nothing()), own=own) for own in owns]
    refused = [bool(each.refused) for each in judged([(0, 1), (1, 2)], found)]
    assert refused == [False, num_clear == 1]


@pytest.mark.parametrize(("num_clear", "is_refused"), [(2, False), (3, True)])
def test_of_many_pairs_a_tenth_must_show_it(num_clear, is_refused):
    images = list(combinations(range(8), 2))
    clear, not_clear = (shows(8.0, 7.0, as_in_homes=(8.0, told)) for told in (9.0, 5.0))
    differs = shows(8.0, 7.0, as_in_homes=(8.0, -4.0))
    owns = [differs] * 4 + [clear] * num_clear + [not_clear] * (24 - num_clear)
    found = [Evidence((nothing(), nothing()), own=own) for own in owns]
    assert [bool(each.refused) for each in judged(images, found)][:4] == [is_refused] * 4


def test_an_empty_folder_leaves_no_doubt():
    assert not leave_a_doubt([], [])


@pytest.mark.parametrize(
    ("over_others", "over_copies", "of_all"),
    [(10.0, 3.0, 3.69), (3.0, 10.0, 3.69), (4.0, 4.0, 4.0), (0.0, 10.0, 0.69), (6.0, -4.0, -3.31)],
)
def test_half_of_the_wrong_poses_are_those_of_copies(over_others, over_copies, of_all):
    pairs = list(combinations(range(6), 2))
    judge = judge_places([posed(pair) for pair in pairs], evidence_on(pairs, [1.0] * len(pairs)))
    told = Evidence((nothing(), nothing()), own=shows(over_others, over_copies))
    (verdict,) = judge.on_doubted([told])
    odds = np.log(verdict.probability / (1 - verdict.probability))
    assert odds == pytest.approx(of_all, abs=0.01)
