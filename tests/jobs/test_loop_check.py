# SPDX-License-Identifier: BSD-3-Clause
"""Triangles of pairs tell which accepted pose is wrong."""

import csv
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from rendered_views import NAMES, image_set, write_views

from epi360.jobs.graph import loop_check
from epi360.jobs.graph.loop_check import LoopVerdict, check_loops
from epi360.jobs.mapping.map_folder import map_images
from epi360.jobs.matching.match_folder import MatchOptions, match_images
from epi360.jobs.matching.match_job import MatchJob
from epi360.jobs.records.match_store import VERDICTS, Verdict
from epi360.poses import Pose, rotation_from_vector
from epi360.report.match_table import describe_match
from epi360.report.pairs_table import pairs_csv

SQUARE = {"a": (0, 0, 0), "b": (2, 0, 0), "c": (2, 0, 3), "d": (0, 1, 3)}
CLOSED, ALONE = LoopVerdict(1, 0), LoopVerdict()


def cameras(positions, seed=0):
    """Cameras at these positions, each turned at random."""
    rng = np.random.default_rng(seed)
    rotations = [rotation_from_vector(rng.normal(size=3)) for _ in positions]
    return {
        name: Pose(R, -R @ np.asarray(position, dtype=float))
        for (name, position), R in zip(positions.items(), rotations, strict=True)
    }


def verdict_of(pose, rotation_sigma_deg=0.1, translation_sigma_deg=0.2):
    return Verdict(
        status="ok",
        cam2_from_cam1=Pose(pose.rotation, pose.translation / np.linalg.norm(pose.translation)),
        rotation_sigma_deg=rotation_sigma_deg,
        translation_sigma_deg=translation_sigma_deg,
    )


def graph(positions, pairs=None, seed=0):
    """Right verdicts of these pairs, by default of all."""
    cam_from_world = cameras(positions, seed)
    return {
        (name1, name2): verdict_of(cam_from_world[name2] @ cam_from_world[name1].inverse())
        for name1, name2 in pairs or combinations(positions, 2)
    }


def turned(verdict, degrees, axis=(0, 1, 0)):
    """Verdict with a wrong rotation; the direction stays."""
    R = rotation_from_vector(np.radians(degrees) * np.asarray(axis, dtype=float))
    pose = verdict.cam2_from_cam1
    return replace(verdict, cam2_from_cam1=Pose(R @ pose.rotation, pose.translation))


def redirected(verdict, direction):
    pose = Pose(verdict.cam2_from_cam1.rotation, np.asarray(direction) / np.linalg.norm(direction))
    return replace(verdict, cam2_from_cam1=pose)


def checked(verdicts):
    loops = check_loops(list(verdicts), list(verdicts.values()))
    return dict(zip(verdicts, loops, strict=True))


def test_right_pairs_support_each_other():
    assert set(checked(graph(SQUARE)).values()) == {LoopVerdict(2, 0)}


def test_a_wrong_rotation_is_contradicted_and_its_triangles_no_longer_count():
    pairs = graph(SQUARE)
    pairs["a", "b"] = turned(pairs["a", "b"], 8)
    loops = checked(pairs)
    witnesses = tuple(key for key in pairs if key not in [("a", "b"), ("c", "d")])
    assert loops.pop(("a", "b")) == LoopVerdict(2, 2, True, contradicted_by=witnesses)
    assert loops.pop(("c", "d")) == LoopVerdict(2, 0)
    assert set(loops.values()) == {CLOSED}


@pytest.mark.parametrize("wrong", [(0, 1, 0), (-1, 0, 0)], ids=["out of the plane", "backwards"])
def test_a_wrong_direction_is_contradicted(wrong):
    pairs = graph(SQUARE)
    b_from_world = cameras(SQUARE)["b"].rotation  # which is to the right of a
    pairs["a", "b"] = redirected(pairs["a", "b"], -b_from_world @ np.asarray(wrong, dtype=float))
    loops = checked(pairs)
    assert [key for key, loop in loops.items() if loop.contradicted] == [("a", "b")]
    assert loops["a", "b"].num_contradicted == 2


@pytest.mark.parametrize(
    "positions",
    [
        {"a": (0, 0, 0), "b": (1, 0, 0), "c": (3, 0, 0)},
        {"a": (0, 0, 0), "b": (1, 0, 0), "c": (1e-6, 1e-6, 0)},
    ],
    ids=["straight on", "there and back"],
)
def test_a_walk_on_a_line_closes(positions):
    noise = np.radians(0.1) * np.random.default_rng(1).normal(size=(3, 3))
    pairs = {
        key: redirected(verdict, verdict.cam2_from_cam1.translation + error)
        for (key, verdict), error in zip(graph(positions).items(), noise, strict=True)
    }
    assert set(checked(pairs).values()) == {CLOSED}


def test_one_open_triangle_puts_all_three_in_doubt_and_contradicts_none():
    pairs = graph(SQUARE, [("a", "b"), ("b", "c"), ("a", "c"), ("c", "d")])
    pairs["a", "b"] = turned(pairs["a", "b"], 90)
    loops = checked(pairs)
    assert loops.pop(("c", "d")) == ALONE
    assert list(loops.values()) == [LoopVerdict(1, 1)] * 3
    assert all(loop.doubtful for loop in loops.values())


def test_one_open_triangle_is_enough_where_both_other_pairs_close_elsewhere():
    positions = {**SQUARE, "e": (5, 0, 1)}
    sides = [("a", "b"), ("b", "c"), ("a", "c"), ("b", "d"), ("a", "d"), ("b", "e"), ("c", "e")]
    pairs = graph(positions, sides)
    pairs["a", "c"] = turned(pairs["a", "c"], 20)
    assert [key for key, loop in checked(pairs).items() if loop.contradicted] == [("a", "c")]


def test_wrong_pairs_come_to_light_one_after_the_other():
    sides = [*combinations("abcd", 2), ("a", "e"), ("b", "e"), ("d", "e")]
    pairs = graph({**SQUARE, "e": (5, 0, 1)}, sides)
    for key in [("a", "b"), ("b", "c")]:  # a, b is in three open triangles, b, c in two
        pairs[key] = turned(pairs[key], 40)
    contradicted = [key for key, loop in checked(pairs).items() if loop.contradicted]
    assert contradicted == [("a", "b"), ("b", "c")]


def test_a_pair_is_not_blamed_for_the_wrong_one_beside_it():
    sides = ["ab", "bc", "ac", "bd", "ad", "af", "bf", "be", "ce"]
    sides += [end + name for name in "gh" for end in "bd"]
    sides += [end + name for name in "ij" for end in "ad"]
    rng = np.random.default_rng(2)
    positions = {name: rng.uniform(-3, 3, size=3) for name in "abcdefghij"}
    pairs = graph(positions, [tuple(side) for side in sides])
    pairs["b", "c"] = turned(pairs["b", "c"], 40)
    pairs["a", "b"] = turned(pairs["a", "b"], 1.2)  # small errors add up in the triangle a, b, d
    axis = pairs["b", "d"].cam2_from_cam1.rotation @ (0, 1, 0)
    pairs["b", "d"] = turned(pairs["b", "d"], 1.2, axis)
    loops = checked(pairs)
    assert loops["a", "b"] == LoopVerdict(2, 1)
    assert [key for key, loop in loops.items() if loop.contradicted] == [("b", "c")]


def test_an_error_is_held_against_the_uncertainty_of_the_poses():
    pairs = graph(SQUARE)
    pairs["b", "c"] = turned(pairs["b", "c"], 8)
    assert checked(pairs)["b", "c"].contradicted
    pairs["b", "c"] = replace(pairs["b", "c"], rotation_sigma_deg=2.0)
    assert checked(pairs)["b", "c"] == LoopVerdict(2, 0)


def test_less_than_a_degree_contradicts_nothing_however_certain_the_poses_are():
    pairs = {
        key: replace(verdict, rotation_sigma_deg=1e-3, translation_sigma_deg=1e-3)
        for key, verdict in graph(SQUARE).items()
    }
    pairs["b", "c"] = turned(pairs["b", "c"], 0.9)
    assert set(checked(pairs).values()) == {LoopVerdict(2, 0)}


def test_only_accepted_pairs_take_part():
    pairs = graph(SQUARE)
    pairs["a", "b"] = Verdict(status="too_few_inliers")
    pairs["c", "d"] = replace(turned(pairs["c", "d"], 90), status="planar_ambiguous")
    assert set(checked(pairs).values()) == {ALONE}
    assert checked({}) == {}


def wrong_graph(share, num_images=14, seed=3):
    """All pairs of cameras in a room, a share of them with poses at random; and which."""
    rng = np.random.default_rng(seed)
    pairs = graph({f"{i:02d}": rng.uniform(-3, 3, size=3) for i in range(num_images)}, seed=seed)
    chosen = rng.permutation(len(pairs))[: round(share * len(pairs))]
    wrong = {list(pairs)[index] for index in chosen}
    for key in wrong:
        pose = turned(pairs[key], rng.uniform(10, 180), rng.normal(size=3))
        pairs[key] = redirected(pose, rng.normal(size=3))
    return pairs, wrong


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
def test_wrong_pairs_are_found_among_many_and_no_other(share):
    pairs, wrong = wrong_graph(share)
    assert {key for key, loop in checked(pairs).items() if loop.contradicted} == wrong


def test_the_order_of_pairs_their_direction_and_the_names_do_not_matter():
    pairs, _ = wrong_graph(0.3, num_images=8)
    loops = checked(pairs)
    rng = np.random.default_rng(0)
    renamed = dict(zip(sorted({n for key in pairs for n in key}), "hbgcfdea", strict=True))
    other, expected = {}, {}
    for index in rng.permutation(len(pairs)):
        key = name1, name2 = list(pairs)[index]
        verdict = pairs[key]
        if rng.random() < 0.5:
            name1, name2 = name2, name1
            verdict = replace(verdict, cam2_from_cam1=verdict.cam2_from_cam1.inverse())
        other[renamed[name1], renamed[name2]] = verdict
        expected[renamed[name1], renamed[name2]] = with_witnesses(loops[key], renamed)
    found = {key: with_witnesses(loop, dict(zip(renamed.values(), renamed.values(), strict=True)))
             for key, loop in checked(other).items()}  # fmt: skip
    assert found == expected


def with_witnesses(loop, names):
    """The verdict with the pairs that contradict it under these names, in no order."""
    pairs = {frozenset(names[name] for name in pair) for pair in loop.contradicted_by}
    return replace(loop, contradicted_by=pairs)


def test_the_frame_of_each_camera_does_not_matter():
    pairs, _ = wrong_graph(0.3, num_images=8)
    rng = np.random.default_rng(5)
    new_from_old = {
        name: Pose(rotation_from_vector(rng.normal(size=3)), np.zeros(3))
        for name in {name for key in pairs for name in key}
    }
    other = {
        (name1, name2): replace(
            verdict,
            cam2_from_cam1=new_from_old[name2]
            @ verdict.cam2_from_cam1
            @ new_from_old[name1].inverse(),
        )
        for (name1, name2), verdict in pairs.items()
    }
    assert checked(other) == checked(pairs)


def test_triangles_are_counted_the_same_in_blocks(monkeypatch):
    pairs, _ = wrong_graph(0.2)
    whole = checked(pairs)
    monkeypatch.setattr(loop_check, "_BLOCK", 7)
    assert checked(pairs) == whole


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([("a", "b"), ("b", "a")], "paired twice"),
        ([("a", "a"), ("b", "a")], "two images"),
        ([("a", "b")], "got 1 and 2"),
    ],
)
def test_bad_pairs_are_refused(pairs, message):
    with pytest.raises(ValueError, match=message):
        check_loops(pairs, [Verdict(status="ok"), Verdict(status="ok")])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Four views of a room, and where they were matched."""
    folder = tmp_path_factory.mktemp("views")
    write_views(folder)
    match_images(image_set(folder), folder / "out")
    return folder


@pytest.fixture
def wrong_pair(monkeypatch):
    """The second view to the third is 15 degrees wrong, and accepted all the same."""
    verify = MatchJob.verify

    def verify_badly(job, pairs):
        finished, num_found = verify(job, pairs)
        keys = job.keys_of((1, 2))
        return {**finished, keys: turned(finished[keys], 15)}, num_found

    monkeypatch.setattr(MatchJob, "verify", verify_badly)
    return NAMES[1], NAMES[2]


def test_the_table_and_the_summary_tell_which_pair_is_contradicted(folder, wrong_pair):
    run = match_images(image_set(folder), folder / "out")
    rows = list(csv.DictReader(pairs_csv(run).decode().splitlines()))
    rejected = [row for row in rows if row["accepted"] == "no"]
    assert [(row["image1"], row["image2"]) for row in rejected] == [wrong_pair]
    assert rejected[0]["status"] == "refused"
    assert rejected[0]["reason"] == "contradicted by other pairs"
    assert (rejected[0]["num_triangles"], rejected[0]["num_contradicted"]) == ("2", "2")
    assert {row["num_contradicted"] for row in rows if row["accepted"] == "yes"} == {"0"}
    assert "1 did not fit other pairs (contradicted by other pairs)" in describe_match(run)


def test_a_triangle_that_does_not_close_is_a_warning(folder, wrong_pair, tmp_path):
    (tmp_path / "pairs.txt").write_text(
        "".join(f'"{a}" "{b}"\n' for a, b in combinations(NAMES[:3], 2)), encoding="utf-8"
    )
    options = MatchOptions(pairs=tmp_path / "pairs.txt")
    run = match_images(image_set(folder), folder / "out", options)
    assert [verdict.accepted for verdict in run.verdicts] == [True] * 3
    assert all("triangles" in verdict.warnings[-1] for verdict in run.verdicts)


@pytest.mark.parametrize("num_triangles", [1, 2])
def test_a_pair_that_two_triangles_contradict_stays_out_of_the_map(
    folder, monkeypatch, num_triangles
):
    pycolmap = pytest.importorskip("pycolmap")
    wrong_pair = (NAMES[1], NAMES[2])
    found = LoopVerdict(num_triangles, num_triangles, contradicted=True)
    monkeypatch.setattr(
        "epi360.jobs.graph.graph_check.check_loops",
        lambda pairs, _: [found if pair == wrong_pair else ALONE for pair in pairs],
    )
    (folder / "out" / VERDICTS).unlink(missing_ok=True)  # they do not know of `found`
    run = map_images(image_set(folder), folder / "out")
    assert len(run.models[0].reconstruction.images) == 4
    with pycolmap.Database.open(folder / "out" / "database.db") as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        for pair in combinations(NAMES, 2):
            assert database.exists_two_view_geometry(*(ids[name] for name in pair)) == (
                pair != wrong_pair or num_triangles == 1
            )
