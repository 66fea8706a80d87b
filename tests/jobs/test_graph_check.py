# SPDX-License-Identifier: BSD-3-Clause
"""Pairs that nothing else confirms must be more probable than others."""

from dataclasses import replace

import numpy as np
import pytest

from epi360.jobs.graph.graph_check import GraphVerdict, check_graph, closing, links
from epi360.jobs.matching.match_folder import MatchRun, PairVerdict
from epi360.jobs.records.match_store import Verdict
from epi360.poses import Pose
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv

ONLY = "with a probability of only"
# Four corners of a square, and a fifth camera behind the last.
PLACES = {"a": (0, 0, 0), "b": (2, 0, 0), "c": (2, 0, 3), "d": (0, 0.5, 3), "e": (1, 0, 7)}


def verdict_of(name1, name2, **values):
    step = np.subtract(PLACES[name1], PLACES[name2])  # all cameras look the same way
    pose = Pose(np.eye(3), step / np.linalg.norm(step))
    made = {"rotation_sigma_deg": 0.1, "translation_sigma_deg": 0.2, "probability": 0.9}
    return Verdict(**{"status": "ok", "cam2_from_cam1": pose, **made, **values})


def refusals(verdicts, *, is_level=False):
    pairs = [tuple(name) for name in verdicts]
    found = check_graph(pairs, list(verdicts.values()), is_level=is_level)
    return {"".join(pair): each.refused for pair, each in zip(pairs, found, strict=True)}


def graph(names, **changed):
    return {name: verdict_of(*name, **changed.get(name, {})) for name in names.split()}


@pytest.mark.parametrize(
    ("edges", "expected"),
    [
        ("", ""),
        ("ab", "ab"),
        ("ab bc cd", "ab bc cd"),
        ("ab bc ca", ""),
        ("ab bc ca cd de ef fd", "cd"),
        ("ab bc ca xy", "xy"),
        ("ab bc cd da ae bf fg gb", "ae"),
    ],
)
def test_links_are_the_edges_in_no_cycle(edges, expected):
    listed = [tuple(edge) for edge in edges.split()]
    assert ["".join(listed[row]) for row in links(listed)] == expected.split()


@pytest.mark.parametrize("seed", range(20))
def test_without_a_link_its_ends_are_apart_and_without_another_edge_they_are_not(seed):
    rng = np.random.default_rng(seed)
    nodes = [str(k) for k in range(12)]
    edges = [(a, b) for a in nodes for b in nodes if a < b and rng.random() < 0.13]
    found = links(edges)
    for row, (start, end) in enumerate(edges):
        reached, others = {start}, edges[:row] + edges[row + 1 :]
        for _ in nodes:
            reached |= {b for a, b in others if a in reached}
            reached |= {a for a, b in others if b in reached}
        assert (end not in reached) == (row in found)


def test_a_pair_that_alone_joins_two_groups_needs_a_higher_probability():
    pairs = graph("ab bc ac cd de")
    pairs["cd"] = replace(pairs["cd"], probability=0.9157)
    pairs["de"] = replace(pairs["de"], probability=0.95)
    found = refusals(pairs)
    assert (
        found.pop("cd")
        == "joins two groups alone, with a probability of only 0.915 by its own matches"
    )
    assert set(found.values()) == {""}


def test_a_probability_that_is_not_known_refuses_nothing():
    assert set(refusals(graph("ab cd", ab={"probability": np.nan})).values()) == {
        "", f"joins two groups alone, {ONLY} 0.9 by its own matches",
    }  # fmt: skip
    lost = {"ab": Verdict(status="too_few_inliers", probability=0.1)}
    assert refusals(lost) == {"ab": ""}


def test_a_contradicted_pair_closes_no_cycle():
    pairs = graph("ab bc ac ad bd cd de be")  # de and be hang together by b and d
    turned = Pose(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([1.0, 0, 0]))
    pairs["ab"] = replace(pairs["ab"], cam2_from_cam1=turned)
    names = [tuple(name) for name in pairs]
    found = dict(zip(pairs, check_graph(names, list(pairs.values()), is_level=False), strict=True))
    assert found["ab"].contradicted
    (sentence,) = found["ab"].doubts(pairs["ab"])
    assert sentence == "does not fit b - c, a - c, a - d, b - d"
    assert not any(each.refused for each in found.values())
    del pairs["bc"], pairs["bd"], pairs["ac"], pairs["be"]  # only ab now holds b
    assert refusals(pairs)["ab"].startswith("joins two groups alone")


FLOOR = {"floor_share": 0.98, "probability": 0.998}


def test_in_a_level_folder_a_floor_alone_is_not_enough():
    pairs = graph("ab bc cd da", ab=FLOOR)
    assert refusals(pairs)["ab"] == ""
    found = refusals(pairs, is_level=True)
    assert (
        found["ab"] == "lies on the floor only, with a probability of only 0.998 by its own matches"
    )
    assert found["bc"].startswith("joins two groups alone")  # the circle is open now


@pytest.mark.parametrize(
    ("pairs", "values"),
    [
        ("ab bc cd da", {**FLOOR, "probability": 0.999}),
        ("ab bc cd da", {**FLOOR, "floor_share": 0.96}),
        ("ab bc cd da", {**FLOOR, "floor_share": np.nan}),
        ("ab bc ac", FLOOR),
    ],
    ids=["probable", "walls too", "no panorama", "a triangle closes"],
)
def test_a_floor_is_enough_where_more_speaks_for_it(pairs, values):
    assert set(refusals(graph(pairs, ab=values), is_level=True).values()) == {""}


def test_the_table_and_the_summary_say_why_a_pair_is_refused(tmp_path):
    found = GraphVerdict(refused="lies on the floor only, with a probability of only 0.9")
    (warning,) = found.doubts(verdict_of("a", "b"))
    assert warning == "all inliers lie on the floor, and printed floors repeat from room to room"
    pair = PairVerdict(status="ok", image1="a", image2="b", probability=0.9, **vars(found))
    assert not pair.accepted
    run = MatchRun(
        folder=tmp_path,
        how="exhaustive",
        images=("a", "b"),
        verdicts=(pair,),
        unreadable={},
        num_found=0,
    )
    assert "Rejected      1 lies on the floor only\n" in describe_match(run)
    assert f'no,"{found.refused}"' in pairs_csv(run).decode()


def doubted(name1, name2, **values):
    """A verdict whose pose is not believed, though it is probable."""
    return replace(
        verdict_of(name1, name2),
        **{
            "status": "concentrated_inliers",
            "doubted": verdict_of(name1, name2).cam2_from_cam1,
            "cam2_from_cam1": Pose.nan(),
            "rotation_sigma_deg": np.nan,
            "translation_sigma_deg": np.nan,
            "probability": 0.96,
            **values,
        },
    )


def confirmed(verdicts, *, is_level=True):
    pairs = [tuple(name) for name in verdicts]
    found = check_graph(pairs, list(verdicts.values()), is_level=is_level)
    return [name for name, each in zip(verdicts, found, strict=True) if each.confirmed]


def test_triangles_confirm_a_pose_that_is_not_believed():
    pairs = {**graph("bc ab cd da"), "ac": doubted("a", "c")}
    names = [tuple(name) for name in pairs]
    found = check_graph(names, list(pairs.values()), is_level=True)[-1]
    assert found == GraphVerdict(num_triangles=2, confirmed=True)
    (sentence,) = found.doubts(pairs["ac"])
    assert sentence.endswith("the pose is accepted because triangles close with it")
    assert confirmed(pairs, is_level=False) == []


@pytest.mark.parametrize(
    "changed",
    [
        {"doubted": verdict_of("c", "a").cam2_from_cam1},
        {"doubted": Pose.nan()},
        {"probability": 0.59},
        {"probability": np.nan},
    ],
    ids=["backwards", "no pose", "not probable", "not known"],
)
def test_other_poses_stay_doubted(changed):
    assert confirmed({**graph("ab bc cd da"), "ac": doubted("a", "c", **changed)}) == []


def test_a_pose_that_is_less_probable_needs_two_triangles():
    two, one = graph("ab bc cd da"), graph("ab bc", ab={"probability": 0.9995})
    for probability, num_triangles in ((0.94, 2), (0.61, 2), (0.96, 1)):
        pairs = two if num_triangles == 2 else {**one, "bc": verdict_of("b", "c", probability=1.0)}
        assert confirmed({**pairs, "ac": doubted("a", "c", probability=probability)}) == ["ac"]
    alone = {**one, "bc": verdict_of("b", "c", probability=1.0)}
    assert confirmed({**alone, "ac": doubted("a", "c", probability=0.94)}) == []


def test_only_triangles_of_accepted_pairs_confirm():
    sure = {"probability": 0.9995}
    pairs = {**graph("ab bc", ab=sure, bc=sure), "ac": doubted("a", "c")}
    assert confirmed(pairs) == ["ac"]
    assert confirmed({**pairs, "bc": Verdict(status="too_few_inliers")}) == []
    assert confirmed({**pairs, "bc": verdict_of("b", "c", probability=0.94)}) == []  # a weak link
    assert confirmed({**pairs, "bc": verdict_of("b", "c", **FLOOR)}) == []
    assert confirmed({**pairs, "bc": doubted("b", "c")}) == []
    del pairs["bc"]
    assert confirmed(pairs) == []


def test_a_pair_is_confirmed_by_triangles_that_all_close():
    verdicts = graph("ab bc cd da ac")
    pairs = [tuple(name) for name in verdicts]
    listed = list(verdicts.values())
    found = closing(pairs, listed, [0, 1, 2, 3], {4: listed[4]})
    assert {row: loop.num_triangles for row, loop in found.items()} == {4: 2}
    assert closing(pairs, listed, [0, 2], {4: listed[4]}) == {}  # in no triangle
    away = replace(listed[4], cam2_from_cam1=listed[4].cam2_from_cam1.inverse())
    assert closing(pairs, listed, [0, 1, 2, 3], {4: away}) == {}
