# SPDX-License-Identifier: BSD-3-Clause
"""What is said about a pair for its surroundings, and the reason, by made evidence."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from made_surroundings import (
    evidence_on,
    judged,
    nothing,
    pairs_of_twin_rooms,
    posed,
    shows,
    surfaces_of,
)

from epi360.jobs.graph.place_check import judge_places
from epi360.jobs.graph.place_evidence import Evidence
from epi360.jobs.graph.place_verdict import PlaceVerdict
from epi360.jobs.graph.surface_evidence import Sibling
from epi360.places.own_evidence import OwnEvidence
from epi360.places.same_place import DOUBT, ONE_WALL, same_place


def test_the_reason_counts_places():
    pairs, is_right = pairs_of_twin_rooms()
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
    pairs, is_right = pairs_of_twin_rooms()
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
    pairs, is_right = pairs_of_twin_rooms()
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


@pytest.mark.parametrize(
    ("own", "held_back"),
    [
        (shows(8.0, -3.0), 0.0),
        (shows(-2.0, 50.0), 2.0),
        (shows(-50.0, 50.0), 10.0),  # no more than this counts
        (shows(-2.0, -2.0), np.log((np.exp(2.0) + np.exp(2.0)) / (1.0 + np.exp(2.0)))),
        (shows(8.0, 8.0, inliers_on_floor=True), 3.5),
        (shows(-2.0, on_one_wall=True), 3.5),
        (shows(is_known=False), 0.0),
    ],
)
def test_all_that_speaks_against_a_refused_pose_counts_in_its_probability(own, held_back):
    pairs = list(combinations(range(12), 2))
    judge = judge_places([posed(pair) for pair in pairs], evidence_on(pairs, [1.0] * len(pairs)))
    (verdict,) = judge.on_doubted([Evidence((nothing(), nothing()), own=own)])
    assert verdict.held_back == pytest.approx(held_back, abs=1e-4)
    odds = [each / (1.0 - each) for each in (verdict.probability, verdict.if_refused)]
    assert odds[1] == pytest.approx(odds[0] * np.exp(-held_back), rel=1e-3)


def test_what_is_known_to_be_wrong_or_right_stays_so():
    told = [PlaceVerdict(each, held_back=3.0).if_refused for each in (0.0, 0.5, 1.0)]
    assert told == pytest.approx([0.0, 1.0 / (1.0 + np.exp(3.0)), 1.0])


def test_one_of_few_pairs_must_be_probable_by_itself_and_triangles_do_not_help():
    pairs, is_right = pairs_of_twin_rooms()
    few = [pair for pair, right in zip(pairs, is_right, strict=True) if right][:3]
    silent = evidence_on(few, np.ones(3), silent=[0, 1, 2])
    for own, is_refused, why in (
        (shows(8.0, 8.0), False, ""),
        (shows(8.0, -1.0), False, ""),
        (shows(8.0, -1.3), True, "may show a copy of the place"),  # 0.93 if compared alone
        (shows(8.0, -4.0), True, "may show a copy of the place"),
        (shows(-4.0, 8.0), True, "shows another place"),
        (shows(0.0, 8.0, inliers_on_floor=True), True, "shows another place"),
    ):
        evidence = [replace(silent[0], own=own), *silent[1:]]
        verdict = judged(few, evidence)[0]
        assert bool(verdict.refused) == is_refused
        assert verdict.refused.startswith(why)
        assert not verdict.leaves_a_doubt


@pytest.mark.parametrize(("num_pairs", "is_refused"), [(59, True), (60, False)])
def test_from_sixty_pairs_on_the_others_may_speak_for_one(num_pairs, is_refused):
    pairs = list(combinations(range(12), 2))[:num_pairs]
    evidence = evidence_on(pairs, np.ones(num_pairs))
    first, *others = judged(pairs, [replace(evidence[0], own=shows(8.0, -3.0)), *evidence[1:]])
    assert bool(first.refused) == first.by_itself == is_refused
    assert not any(each.refused for each in others)


@pytest.mark.parametrize("is_partial", [False, True])
def test_a_part_of_the_sphere_must_be_probable_by_itself_among_many_pairs(is_partial):
    pairs = list(combinations(range(12), 2))
    own = shows(8.0, -3.0, is_partial=is_partial)
    evidence = evidence_on(pairs, np.ones(len(pairs)))
    first, *others = judged(pairs, [replace(evidence[0], own=own), *evidence[1:]])
    assert bool(first.refused) == first.by_itself == is_partial
    assert not first.leaves_a_doubt
    assert not any(each.refused for each in others)


@pytest.mark.parametrize("num_pairs", [3, 66])
def test_nothing_is_said_of_what_cannot_be_compared(num_pairs):
    pairs = list(combinations(range(12), 2))[:num_pairs]
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
    pairs, is_right = pairs_of_twin_rooms()
    few = [pair for pair, right in zip(pairs, is_right, strict=True) if right][:3]
    silent = evidence_on(few, np.ones(3), silent=[0, 1, 2])
    told = judged(few, [replace(each, own=own) for each in silent])
    here = same_place(own, copies_indoors=0.05).here
    for verdict in told:
        assert not verdict.refused and verdict.warnings == warnings
        assert verdict.if_accepted == verdict.probability == pytest.approx(here)
