# SPDX-License-Identifier: BSD-3-Clause
"""What the surroundings say goes into the verdicts of a folder, together with its triangles."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from epi360.jobs.graph.place_verdict import PLACE_AGREES, PLACE_CONFIRMED, PlaceVerdict
from epi360.jobs.matching.pair_verdicts import PairVerdict, checked, without_copies
from epi360.poses import Pose, rotation_from_vector

PLACES = {"a": (0, 0, 0), "b": (2, 0, 0), "c": (2, 0, 3), "d": (0, 0.5, 3), "e": (9, 0, 0)}


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
    judged = checked(verdicts, places, is_level=False)
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
    judged = checked(verdicts, places, is_level=False)
    told = [verdict.probability for verdict in judged]
    assert told == pytest.approx([0.99 * 0.2, 0.99 * 0.995, 0.99])


def test_a_pair_that_alone_joins_two_groups_is_believed_where_its_surroundings_were_compared():
    verdicts = [replace(each, probability=0.9) for each in verdicts_of(["ab", "bc", "cd"])]
    judged = checked(verdicts, [PlaceVerdict(), None, PlaceVerdict()], is_level=False)
    assert [verdict.accepted for verdict in judged] == [True, False, True]
    assert judged[1].refused.startswith("joins two groups alone")


def test_a_pair_in_no_triangle_stays_refused():
    verdicts = verdicts_of(["ab", "bc", "cd"])
    places = [PlaceVerdict(0.6, 0.8, 30, "may show a copy of the place, as others do")]
    places += [PlaceVerdict()] * 2
    judged = checked(verdicts, places, is_level=False)
    assert [verdict.accepted for verdict in judged] == [False, True, True]
    assert judged[0].refused.startswith("may show a copy of the place")


def test_refused_pairs_do_not_speak_against_right_ones():
    verdicts = list(verdicts_of(combinations("abcd", 2)))
    wrong = Pose(np.eye(3), np.array([0.0, 1.0, 0.0]))
    verdicts[0] = PairVerdict(**{**vars(verdicts[0]), "cam2_from_cam1": wrong})
    places = [PlaceVerdict(0.0, 0.3, 30, "shows another place, for some reason")]
    places += [PlaceVerdict()] * 5
    judged = checked(tuple(verdicts), places, is_level=False)
    assert all(verdict.num_contradicted == 0 for verdict in judged)
    assert [verdict.accepted for verdict in judged] == [False, *[True] * 5]


def test_a_refused_pair_names_those_that_speak_against_it():
    verdicts = verdicts_of(["ab", "bc", "cd"])
    against = tuple((each, "f") for each in "abcde")
    place = PlaceVerdict(0.2, 0.3, 30, "shows another place, for surfaces", contradicted_by=against)
    judged = checked(verdicts, [place, PlaceVerdict(), PlaceVerdict()], is_level=False)
    assert judged[0].contradicted_by == against
    assert judged[0].warnings == ("does not fit a - f, b - f, c - f, d - f and 1 more",)
    assert not judged[1].contradicted_by and not judged[1].warnings


def test_pairs_between_two_places_name_the_pair_that_tells_them_apart():
    verdicts = list(verdicts_of(["ab", "cd", "bc", "ad"]))
    verdicts[2] = replace(verdicts[2], refused="shows another place, for surfaces differ")
    verdicts[3] = replace(verdicts[3], status="pure_rotation")
    told = without_copies(verdicts)
    assert told[3].refused.startswith("shows another place, as other pairs say")
    assert told[3].contradicted_by == (("b", "c"),)
    assert told[3].warnings == ("does not fit b - c",)


def doubted(verdict):
    """The same pair, if its inliers lay close together."""
    values = {
        "status": "concentrated_inliers",
        "doubted": verdict.cam2_from_cam1,
        "cam2_from_cam1": Pose.nan(),
        "rotation_sigma_deg": np.nan,
        "translation_sigma_deg": np.nan,
    }
    return replace(verdict, **values)


def test_surroundings_that_look_the_same_clear_a_doubted_pose():
    verdicts = list(verdicts_of(["ab", "bc", "cd"]))
    pose = verdicts[1].cam2_from_cam1
    verdicts[1] = doubted(verdicts[1])
    judged = checked(verdicts, [PlaceVerdict(0.99)] * 3, is_level=False)
    assert judged[1].accepted and judged[1].confirmed
    assert PLACE_AGREES in judged[1].warnings
    np.testing.assert_array_equal(judged[1].cam2_from_cam1.matrix(), pose.matrix())
    assert judged[1].probability == pytest.approx(0.99 * 0.99)
    assert judged[1].by_others
    assert np.isnan(judged[1].rotation_sigma_deg)  # a doubted pose has none


@pytest.mark.parametrize("is_level", [False, True])
def test_triangles_contradict_a_doubted_pose_that_is_wrong(is_level):
    verdicts = list(verdicts_of(combinations("abcd", 2)))
    turned = Pose(rotation_from_vector([0.0, 0.8, 0.0]), verdicts[0].cam2_from_cam1.translation)
    verdicts[0] = doubted(replace(verdicts[0], cam2_from_cam1=turned))
    judged = checked(verdicts, [PlaceVerdict(0.96)] * 6, is_level=is_level)
    assert judged[0].status == "concentrated_inliers"
    assert not judged[0].accepted and not judged[0].confirmed
    assert all(verdict.accepted for verdict in judged[1:])


def test_triangles_do_not_confirm_what_the_surroundings_clearly_refuse():
    verdicts = list(verdicts_of(combinations("abcd", 2)))
    verdicts[0] = doubted(verdicts[0])
    for probability, is_accepted in ((0.001, False), (0.5, True)):
        place = PlaceVerdict(probability, refused="shows another place")
        judged = checked(verdicts, [place, *[PlaceVerdict(0.99)] * 5], is_level=True)
        assert judged[0].accepted == is_accepted
        assert not judged[0].by_others


def test_a_doubted_pose_that_joins_two_groups_alone_stays_doubted():
    verdicts = list(verdicts_of(["ab", "bc", "cd"]))
    verdicts[1] = doubted(replace(verdicts[1], probability=0.7))
    judged = checked(verdicts, [PlaceVerdict(0.99)] * 3, is_level=False)
    assert judged[1].status == "concentrated_inliers" and not judged[1].confirmed


@pytest.mark.parametrize("place", [None, PlaceVerdict(0.4, refused="may show a copy")])
def test_a_doubted_pose_stays_refused_without_them(place):
    verdicts = list(verdicts_of(combinations("abcd", 2)))
    verdicts[0] = doubted(verdicts[0])
    judged = checked(verdicts, [place, *[PlaceVerdict()] * 5], is_level=False)
    assert judged[0].status == "concentrated_inliers"
    assert not judged[0].confirmed
    assert judged[0].refused == ""  # its status says why
    assert judged[0].probability == pytest.approx(0.99 * (0.4 if place else 1.0))


def test_a_refused_pose_is_as_probable_as_all_that_speaks_against_it_leaves():
    verdicts = verdicts_of(["ab", "bc", "cd"])
    refused = PlaceVerdict(0.5, refused="shows another place", held_back=2.0)
    judged = checked(verdicts, [refused, PlaceVerdict(), PlaceVerdict()], is_level=False)
    assert judged[0].probability == pytest.approx(0.99 / (1.0 + np.exp(2.0)))


def test_a_pose_that_triangles_confirm_has_the_probability_of_accepted_ones():
    verdicts = verdicts_of(combinations("abcd", 2))
    refused = PlaceVerdict(0.5, refused="shows another place", held_back=2.0)
    judged = checked(verdicts, [refused, *[PlaceVerdict()] * 5], is_level=False)
    assert judged[0].accepted and judged[0].probability == pytest.approx(0.99 * 0.95)


@pytest.mark.parametrize(
    ("status", "is_lowered"),
    [
        ("too_few_inliers", True),
        ("planar_ambiguous", True),
        ("pure_rotation", False),
        ("ok", False),
    ],
)
def test_poses_that_nobody_looked_around_are_as_rare_as_doubted_ones_are(status, is_lowered):
    verdicts = list(verdicts_of(combinations("abcd", 2)))
    doubts = [doubted(verdict) for verdict in verdicts_of(["ae", "be", "ce"])]
    alone = doubted(replace(*verdicts_of(["de"]), probability=0.5))
    alone = replace(alone, status=status)
    places = [*[PlaceVerdict()] * 6, *[PlaceVerdict(0.1, refused="may show a copy")] * 3, None]
    told = checked([*verdicts, *doubts, alone], places, is_level=False)[-1].probability
    assert told == pytest.approx(0.5 * ((2.0 + 3 * 0.1) / (2.0 + 3) if is_lowered else 1.0))
    without = checked([*verdicts, alone], [*[PlaceVerdict()] * 6, None], is_level=False)
    assert without[-1].probability == 0.5


def test_a_doubt_about_the_surroundings_is_a_warning_of_what_is_accepted():
    verdicts = verdicts_of(["ab", "bc", "cd"])
    doubt = PlaceVerdict(0.9, warnings=("little looks the same",))
    places = [doubt, replace(doubt, refused="may show a copy"), PlaceVerdict()]
    judged = checked(verdicts, places, is_level=False)
    assert [each.accepted for each in judged] == [True, False, True]
    assert [each.warnings for each in judged] == [("little looks the same",), (), ()]
    assert judged[0].probability == pytest.approx(0.99 * 0.9)
