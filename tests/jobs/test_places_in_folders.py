# SPDX-License-Identifier: BSD-3-Clause
"""What the surroundings say goes into the verdicts of a folder, together with its triangles."""

from itertools import combinations

import numpy as np
import pytest

from epi360.jobs.graph.place_check import PLACE_CONFIRMED, PlaceVerdict
from epi360.jobs.matching import match_folder
from epi360.jobs.matching.match_folder import PairVerdict
from epi360.poses import Pose

PLACES = {"a": (0, 0, 0), "b": (2, 0, 0), "c": (2, 0, 3), "d": (0, 0.5, 3)}


def verdicts_of(names):
    found = []
    for name1, name2 in names:
        step = np.subtract(PLACES[name1], PLACES[name2])
        found.append(
            PairVerdict(
                image1=name1,
                image2=name2,
                status="ok",
                cam2_from_cam1=Pose(np.eye(3), step / np.linalg.norm(step)),
                rotation_sigma_deg=0.1,
                translation_sigma_deg=0.2,
                probability=0.99,
            )
        )
    return tuple(found)


@pytest.mark.parametrize(("probability", "is_accepted"), [(0.1, False), (0.6, True)])
def test_triangles_confirm_a_pair_that_is_refused_in_doubt(probability, is_accepted):
    verdicts = verdicts_of(combinations("abcd", 2))
    places = [PlaceVerdict(probability, 0.8, 30, "shows another place, for some reason")]
    places += [PlaceVerdict()] * (len(verdicts) - 1)
    judged = match_folder._checked(verdicts, places, is_level=False)
    assert judged[0].accepted == is_accepted
    assert (PLACE_CONFIRMED in judged[0].warnings) == is_accepted
    assert all(verdict.accepted for verdict in judged[1:])


def test_the_probability_is_that_of_the_matches_and_of_the_surroundings():
    verdicts = verdicts_of(["ab", "bc", "cd"])
    places = [
        PlaceVerdict(0.2, 0.3, 30, "shows another place"),
        PlaceVerdict(0.995),
        PlaceVerdict(),
    ]
    judged = match_folder._checked(verdicts, places, is_level=False)
    told = [verdict.probability for verdict in judged]
    assert told == pytest.approx([0.99 * 0.2, 0.99 * 0.995, 0.99])


def test_a_pair_in_no_triangle_stays_refused():
    verdicts = verdicts_of(["ab", "bc", "cd"])
    places = [PlaceVerdict(0.6, 0.8, 30, "may show a copy of the place, as others do")]
    places += [PlaceVerdict()] * 2
    judged = match_folder._checked(verdicts, places, is_level=False)
    assert [verdict.accepted for verdict in judged] == [False, True, True]
    assert judged[0].refused.startswith("may show a copy of the place")


def test_refused_pairs_do_not_speak_against_right_ones():
    verdicts = list(verdicts_of(combinations("abcd", 2)))
    wrong = Pose(np.eye(3), np.array([0.0, 1.0, 0.0]))
    verdicts[0] = PairVerdict(**{**vars(verdicts[0]), "cam2_from_cam1": wrong})
    places = [PlaceVerdict(0.0, 0.3, 30, "shows another place, for some reason")]
    places += [PlaceVerdict()] * 5
    judged = match_folder._checked(tuple(verdicts), places, is_level=False)
    assert all(verdict.num_contradicted == 0 for verdict in judged)
    assert [verdict.accepted for verdict in judged] == [False, *[True] * 5]
