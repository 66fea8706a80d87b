# SPDX-License-Identifier: BSD-3-Clause
"""Pairs whose surroundings look different are refused, by made evidence."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from epi360.jobs.graph.place_check import (
    ANOTHER_PLACE,
    COPY,
    PlaceVerdict,
    judge_places,
    leave_a_doubt,
)
from epi360.jobs.graph.place_evidence import Evidence, Sightings
from epi360.jobs.graph.surface_evidence import (
    HIDDEN,
    OWN,
    UNKNOWN,
    VISIBLE,
    Sibling,
    SurfaceSightings,
    surfaces_ratio,
)
from epi360.places.own_evidence import OwnEvidence
from epi360.places.same_place import DOUBT, ONE_WALL, same_place
from epi360.places.shared_points import PosedPair
from epi360.poses import Pose, rotation_from_vector

NUM_CELLS = 20
NOBODY = np.empty(0, np.int64)


def shows(over_others=0.0, over_copies=0.0, *, as_in_homes=None, **details):
    """What a pair shows, by both sets of weights unless other ratios are given."""
    ratios = as_in_homes or (over_others, over_copies)
    return OwnEvidence(over_others, over_copies, as_in_homes=ratios, **details)


# What pairs of one room show by themselves.
ALL_GROWS, LITTLE_GROWS, NOTHING_GROWS = shows(5.0, 6.0), shows(1.0, 1.0), shows()


def posed(images, *, turn=None):
    """A pair of which only the images and the rotation matter."""
    pose = Pose(np.eye(3) if turn is None else turn, [0.0, 0.0, 1.0])
    return PosedPair(images, pose, (NOBODY,) * 2, (np.empty((0, 3)),) * 2, 0.1, 0.1, 0.1)


def judged(images, evidence):
    return judge_places([posed(pair) for pair in images], evidence).verdicts


def sightings(rng, witnesses, share, *, num=200, beyond=-0.1):
    """Points that some pairs know, of which a share is found; all are visible by default."""
    count = num if len(witnesses) else 0
    places = np.arange(count) % NUM_CELLS
    same = rng.random(NUM_CELLS) < share  # what lies together is one surface
    found = np.where(same[places], rng.random(count) < 0.97, rng.random(count) < 0.1)
    names = rng.choice(witnesses, count) if count else np.empty(0, np.int64)
    return Sightings(
        names.astype(np.int64),
        places,
        np.zeros(count, np.int64),
        found,
        np.array([OWN]),
        np.full((count, 1), beyond),
    )


def nothing():
    return sightings(np.random.default_rng(0), [], 1.0)


def no_surfaces():
    return surfaces_of([], 0.0)


def surfaces_of(witnesses, ratio, *, num=600, hidden=VISIBLE):
    """Cells that some pairs know, in so many parts of the view, all with one ratio."""
    count = num if len(witnesses) else 0
    return SurfaceSightings(
        np.resize(np.array([*witnesses, 0], np.int32)[: max(len(witnesses), 1)], count),
        np.arange(count).astype(np.int16),
        np.full(count, ratio, np.float32),
        np.array([OWN]),
        np.full((count, 1), hidden, np.int8),
    )


def evidence_on(pairs, shares, *, seed=0, one_sided=(), silent=(), **options):
    """All pairs that share an image witness for each other; right ones show it by themselves."""
    rng = np.random.default_rng(seed)
    found = []
    for row, (pair, share) in enumerate(zip(pairs, shares, strict=True)):
        sides = []
        for side in (0, 1):
            near = [k for k, other in enumerate(pairs) if k != row and pair[side] in other]
            is_silent = row in silent or (side == 1 and row in one_sided)
            sides.append(nothing() if is_silent else sightings(rng, near, share, **options))
        for made, offset in zip(sides, (0, 1000), strict=True):
            made.cells[:] += offset
        surfaces = (no_surfaces(), no_surfaces())
        own = ALL_GROWS if share > 0.9 and row not in silent else NOTHING_GROWS
        found.append(Evidence((sides[0], sides[1]), surfaces, own))
    return found


def twin_rooms():
    """Two rooms of four panoramas; all pairs, and which are within a room."""
    pairs = list(combinations(range(8), 2))
    return pairs, np.array([a // 4 == b // 4 for a, b in pairs])


@pytest.mark.parametrize("seed", range(10))
def test_where_all_looks_the_same_nothing_is_refused(seed):
    pairs = list(combinations(range(6), 2))
    verdicts = judged(pairs, evidence_on(pairs, [1.0] * len(pairs), seed=seed))
    assert not any(verdict.refused for verdict in verdicts)
    assert min(verdict.share for verdict in verdicts) > 0.8


@pytest.mark.parametrize("share", [0.3, 0.6])
@pytest.mark.parametrize("seed", range(5))
def test_pairs_of_twin_rooms_are_refused_and_hardly_any_of_one_room(share, seed):
    pairs, is_right = twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, share), seed=seed)
    verdicts = judged(pairs, found)
    kept = np.array([not verdict.refused for verdict in verdicts])
    assert not kept[~is_right].any()
    assert np.sum(~kept[is_right]) <= 1
    assert all(each.refused.startswith((ANOTHER_PLACE, COPY)) for each in verdicts if each.refused)


@pytest.mark.parametrize("seed", range(5))
def test_twin_rooms_stay_apart_where_pairs_show_nothing_by_themselves(seed):
    images, is_right = twin_rooms()
    order = np.random.default_rng(seed).permutation(len(images))
    images, is_right = [images[row] for row in order], is_right[order]
    found = evidence_on(images, np.where(is_right, 1.0, 0.5), seed=seed)
    found = [replace(each, own=NOTHING_GROWS) for each in found]
    refused = np.array([bool(verdict.refused) for verdict in judged(images, found)])
    assert refused[~is_right].all()


def test_a_pair_about_which_nothing_is_known_is_refused_only_where_copies_are():
    pairs, is_right = twin_rooms()
    told = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    assert judged(pairs, told)[0].refused.startswith(COPY)
    verdicts = judged(pairs, evidence_on(pairs, [1.0] * len(pairs), silent=[0]))
    assert not verdicts[0].refused and np.isnan(verdicts[0].share)


def test_what_only_one_of_both_views_shows_speaks_for_no_pair():
    pairs, is_right = twin_rooms()
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
    pairs, is_right = twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    for own, is_enough in (
        (shows(8.0, 0.0), False),  # not another place, but maybe a copy
        (shows(0.0, 5.0), False),
        (shows(8.0, 5.0), True),
    ):
        found[0] = replace(found[0], own=own)
        assert bool(judged(pairs, found)[0].refused) != is_enough


def test_surfaces_of_other_pairs_speak_for_and_against_a_pair():
    pairs, is_right = twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    told = []
    for ratio in (-3.0, 0.0, 2.0):
        found[0] = replace(found[0], surfaces=(surfaces_of([1, 2], ratio),) * 2)
        told.append(judged(pairs, found)[0].probability)
    assert told[0] < told[1] - 0.1 and told[1] + 0.1 < told[2]


def test_what_moves_is_no_copy_where_most_pairs_are_in_the_open():
    pairs, is_right = twin_rooms()
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


TRUSTED = np.ones(4, dtype=bool)


def test_surfaces_alone_say_only_so_much():
    for ratio, limit in ((-3.8, -1.0), (1.7, 1.0)):
        assert surfaces_ratio((surfaces_of([1], ratio, num=6000),) * 2, TRUSTED) == limit


@pytest.mark.parametrize("hidden", [HIDDEN, UNKNOWN])
def test_surfaces_that_may_be_hidden_say_nothing(hidden):
    assert surfaces_ratio((surfaces_of([1], -3.0, hidden=hidden),) * 2, TRUSTED) == 0.0


def test_surfaces_of_pairs_that_are_not_believed_say_nothing():
    sides = (surfaces_of([1], -3.0),) * 2
    assert surfaces_ratio(sides, TRUSTED) == -1.0
    assert surfaces_ratio(sides, np.array([True, False, True, True])) == 0.0


def test_surfaces_of_one_of_both_views_say_nothing():
    for ratio in (-3.0, 1.7):
        assert surfaces_ratio((surfaces_of([1], ratio), no_surfaces()), TRUSTED) == 0.0


def test_the_reason_counts_places():
    pairs, is_right = twin_rooms()
    verdicts = judged(pairs, evidence_on(pairs, np.where(is_right, 1.0, 0.3)))
    worst = verdicts[int(np.argmin(is_right))]
    assert f"of {worst.num_places} parts of the views" in worst.refused
    assert worst.probability < 0.01
    # Pairs within the rooms say so, and none that is refused itself.
    ends = set(pairs[int(np.argmin(is_right))])
    assert all(is_right[row] and ends & set(pairs[row]) for row in worst.against)
    assert len(worst.against) > 2
    assert not any(each.against for each in verdicts if not each.refused)


def test_the_reason_names_surfaces_where_they_alone_speak_against_a_pair():
    pairs, is_right = twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, 0.4), silent=[0])
    for ratio, why in (
        (-3.8, "for surfaces differ"),
        (0.0, "and too little of what"),
    ):
        found[0] = replace(found[0], surfaces=(surfaces_of([1, 2], ratio, num=6000),) * 2)
        verdict = judged(pairs, found)[0]
        assert why in verdict.refused
        assert verdict.against == ((1, 2) if ratio < 0.0 else ())


def test_the_reason_names_pairs_that_say_the_same():
    """Panorama 0 in the other room: one pair alone would do, those that say the same are wrong."""
    pairs, is_right = twin_rooms()
    found = evidence_on(pairs, np.where(is_right, 1.0, 0.4))
    across = [row for row, pair in enumerate(pairs) if pair[0] == 0 and pair[1] > 3]
    for row in across:
        said = tuple(
            Sibling(other, pairs.index((pairs[row][1], pairs[other][1])))
            for other in across
            if pairs[other][1] > pairs[row][1]
        )
        found[row] = replace(found[row], siblings=said)
    best = across[0]
    silent = evidence_on(pairs, [1.0] * len(pairs), silent=[best])[best]
    found[best] = replace(silent, siblings=found[best].siblings, own=shows(3.0, 3.0))
    assert "pairs that say the same" in judged(pairs, found)[best].refused


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
    images = list(combinations(range(8), 2))
    owns = [shows(3.0, -1.2)] * 14 + [shows(3.0, 2.0)] * 14
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


@pytest.mark.parametrize(
    ("own", "held_back"),
    [
        (shows(8.0, -3.0), 0.0),
        (shows(-2.0, 50.0), 2.0),
        (shows(-50.0, 50.0), 10.0),  # no more than this counts
        (shows(-2.0, -2.0), np.log((np.exp(2.0) + np.exp(2.0)) / (1.0 + np.exp(2.0)))),
        (shows(8.0, 8.0, on_floor=True), 3.5),
        (shows(-2.0, on_one_wall=True), 3.5),
        (shows(is_known=False), 0.0),
    ],
)
def test_all_that_speaks_against_a_refused_pose_counts_in_its_probability(own, held_back):
    pairs = list(combinations(range(6), 2))
    judge = judge_places([posed(pair) for pair in pairs], evidence_on(pairs, [1.0] * len(pairs)))
    (verdict,) = judge.on_doubted([Evidence((nothing(), nothing()), own=own)])
    assert verdict.held_back == pytest.approx(held_back, abs=1e-4)
    odds = [each / (1.0 - each) for each in (verdict.probability, verdict.if_refused)]
    assert odds[1] == pytest.approx(odds[0] * np.exp(-held_back), rel=1e-3)


def test_what_is_known_to_be_wrong_or_right_stays_so():
    told = [PlaceVerdict(each, held_back=3.0).if_refused for each in (0.0, 0.5, 1.0)]
    assert told == pytest.approx([0.0, 1.0 / (1.0 + np.exp(3.0)), 1.0])


def test_one_of_few_pairs_must_be_probable_by_itself_and_triangles_do_not_help():
    pairs, is_right = twin_rooms()
    few = [pair for pair, right in zip(pairs, is_right, strict=True) if right][:3]
    silent = evidence_on(few, np.ones(3), silent=[0, 1, 2])
    for own, is_refused, why in (
        (shows(8.0, 8.0), False, ""),
        (shows(8.0, -1.0), False, ""),
        (shows(8.0, -1.3), True, "may show a copy of the place"),  # 0.93 if compared alone
        (shows(8.0, -4.0), True, "may show a copy of the place"),
        (shows(-4.0, 8.0), True, "shows another place"),
        (shows(0.0, 8.0, on_floor=True), True, "shows another place"),
    ):
        evidence = [replace(silent[0], own=own), *silent[1:]]
        verdict = judged(few, evidence)[0]
        assert bool(verdict.refused) == is_refused
        assert verdict.refused.startswith(why)
        assert not verdict.leaves_a_doubt


@pytest.mark.parametrize("is_partial", [False, True])
def test_a_part_of_the_sphere_must_be_probable_by_itself_among_many_pairs(is_partial):
    pairs = list(combinations(range(6), 2))
    own = shows(8.0, -3.0, is_partial=is_partial)
    evidence = evidence_on(pairs, np.ones(len(pairs)))
    first, *others = judged(pairs, [replace(evidence[0], own=own), *evidence[1:]])
    assert bool(first.refused) == first.by_itself == is_partial
    assert not first.leaves_a_doubt
    assert not any(each.refused for each in others)


@pytest.mark.parametrize("num_pairs", [3, 15])
def test_nothing_is_said_of_what_cannot_be_compared(num_pairs):
    pairs = list(combinations(range(6), 2))[:num_pairs]
    unknown = OwnEvidence(is_partial=True, is_known=False)
    evidence = evidence_on(pairs, np.ones(num_pairs))
    verdict = judged(pairs, [replace(evidence[0], own=unknown), *evidence[1:]])[0]
    assert not verdict.refused and not verdict.warnings
    assert verdict.probability > 0.95


@pytest.mark.parametrize(
    ("own", "warnings"),
    [
        (shows(8.0, 8.0), ()),
        (shows(8.0, -0.5), (DOUBT,)),
        (shows(8.0, 8.0, on_one_wall=True), (ONE_WALL,)),
    ],
)
def test_one_of_few_pairs_states_no_more_than_it_shows_by_itself(own, warnings):
    pairs, is_right = twin_rooms()
    few = [pair for pair, right in zip(pairs, is_right, strict=True) if right][:3]
    silent = evidence_on(few, np.ones(3), silent=[0, 1, 2])
    told = judged(few, [replace(each, own=own) for each in silent])
    here = same_place(own, copies_indoors=0.05).here
    for verdict in told:
        assert not verdict.refused and verdict.warnings == warnings
        assert verdict.if_accepted == verdict.probability == pytest.approx(here)
