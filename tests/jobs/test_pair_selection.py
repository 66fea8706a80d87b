# SPDX-License-Identifier: BSD-3-Clause
"""Which pairs are matched."""

from pathlib import Path

import pytest

from epi360.jobs.folder.image_set import SourceImage
from epi360.jobs.pairs.pair_selection import (
    dense_pairs,
    is_dense,
    names_count_up,
    said_unused,
    select_pairs,
    ways_of,
)
from epi360.jobs.records.match_store import Verdict


def images(count):
    return [SourceImage(f"{k}.jpg", Path(f"{k}.jpg"), "c") for k in range(count)]


def rig(num_frames):
    return [
        SourceImage(f"{camera}/{k}.jpg", Path("x"), camera, frame=str(k))
        for camera in ("left", "right")
        for k in range(num_frames)
    ]


def test_exhaustive_is_every_pair_once():
    how, pairs = select_pairs(images(5), "exhaustive", 10)
    assert how == "exhaustive"
    assert len(pairs) == len({frozenset(pair) for pair in pairs}) == 10


def ways(**found):
    """Ways that find these pairs, and say how many partners they were asked for."""
    return {
        name: lambda count, known, name=name, pairs=pairs: (
            f"{name}, {count}",
            [pair for pair in pairs if pair not in known],
        )
        for name, pairs in found.items()
    }


def test_few_images_are_matched_exhaustively_and_a_long_sequence_with_what_looks_alike():
    assert select_pairs(images(30), "auto", 10)[0] == "exhaustive"
    how, pairs = select_pairs(images(31), "auto", 10, 20, ways(retrieval=[(0, 1), (0, 30)]))
    assert how == ("31 images whose names count up: sequential, 10 neighbours; retrieval, 10")
    assert len(pairs) == len(set(pairs)) < 31 * 13
    assert (0, 30) in pairs


def test_numbers_of_partners_that_auto_has_no_use_for_are_named():
    rooms, given = [SourceImage("a.jpg", Path("x"), "c")], {"overlap": 5, "neighbors": 7}
    assert said_unused(images(30), "auto", given) == "; overlap and neighbors not used"
    assert said_unused([*images(31), *rooms], "auto", given) == "; overlap not used"
    assert said_unused(images(31), "auto", given) == ""
    assert said_unused(images(30), "auto", {"overlap": None, "neighbors": None}) == ""


def test_many_images_without_an_order_are_matched_with_what_looks_alike():
    rooms = [SourceImage(f"{name}.jpg", Path("x"), "c") for name in "ab"]
    how, pairs = select_pairs([*images(31), *rooms], "auto", 10, 20, ways(retrieval=[(4, 32)]))
    assert how == "33 images whose names do not count up: retrieval, 20"
    assert pairs == [(4, 32)]


@pytest.mark.parametrize(
    ("names", "is_sequence"),
    [
        (["a1.jpg", "a2.jpg", "a10.jpg"], True),
        (["walk/f1.jpg", "walk/f2.jpg", "garden/g1.jpg"], True),
        (["a1.jpg", "b2.jpg"], False),
        (["a1.jpg", "kitchen.jpg"], False),
        (["home1/hall.jpg", "home1/bath.jpg"], False),
    ],
)
def test_names_count_up_where_they_differ_in_a_number_only(names, is_sequence):
    assert names_count_up([SourceImage(n, Path(n), "c") for n in names]) is is_sequence


def test_frames_of_a_rig_are_a_sequence_whatever_their_names():
    assert names_count_up(rig(3))


def test_ways_are_combined_and_each_pair_comes_once():
    more = ways(retrieval=[(0, 9), (3, 4)], near=[(0, 9), (0, 8)])
    how, pairs = select_pairs(images(10), "retrieval, sequential,near", 1, 7, more)
    assert how == "sequential, 1 neighbours; near, 7; retrieval, 7"
    assert len(pairs) == len(set(pairs))
    assert set(pairs) == {*select_pairs(images(10), "sequential", 1)[1], (0, 9), (0, 8)}


@pytest.mark.parametrize("pairs", ["retrieval,exhaustive", "near,auto", "sequential,pairs.txt"])
def test_what_goes_with_no_other_way_is_refused(pairs):
    with pytest.raises(ValueError, match="pairs must be a file, auto, exhaustive, or some of"):
        ways_of(pairs)


def test_a_path_is_a_file_even_if_it_has_the_name_of_a_way():
    assert ways_of(Path("retrieval")) == ()


def test_some_pairs_of_a_few_images_are_looked_at_first_and_connect_each_in_many_ways():
    pairs = dense_pairs(images(30), "auto")
    assert set(pairs) <= set(select_pairs(images(30), "auto", 10)[1])
    assert len(pairs) == len(set(pairs)) == 157
    for index in range(30):
        assert sum(index in pair for pair in pairs) >= 7
    assert dense_pairs(images(16), "auto")


def test_no_pairs_are_looked_at_first_where_others_were_asked_for_or_the_order_says_nothing():
    assert dense_pairs(images(30), "exhaustive") == []
    assert dense_pairs(images(31), "auto") == []  # a sequence anyway
    assert dense_pairs(images(15), "auto") == []
    assert dense_pairs(rig(10), "auto") == []


@pytest.mark.parametrize(
    ("last", "dense"),
    [
        (Verdict(status="ok", num_inliers=100), True),
        (Verdict(status="pure_rotation", num_inliers=400), True),
        (Verdict(status="ok", num_inliers=99), False),
        (Verdict(status="too_few_inliers", num_inliers=400), False),
    ],
)
def test_a_sequence_is_dense_only_if_every_pair_has_many_inliers(last, dense):
    assert is_dense([Verdict(status="ok", num_inliers=1000), last]) is dense


def test_a_sequence_pairs_neighbours_and_a_few_farther_ahead():
    _, pairs = select_pairs(images(40), "sequential", 3)
    assert [b for a, b in pairs if a == 5] == [6, 7, 8, 11, 17, 29]
    assert [b for a, b in pairs if a == 38] == [39]
    assert len(pairs) == len(set(pairs))


def test_a_rig_pairs_each_camera_with_itself_and_with_the_other_a_moment_apart():
    chosen = rig(6)
    _, pairs = select_pairs(chosen, "sequential", 2)
    named = {frozenset((chosen[a].name, chosen[b].name)) for a, b in pairs}
    assert len(named) == len(pairs)
    for wanted in (
        {"left/0.jpg", "right/0.jpg"},
        {"left/0.jpg", "right/1.jpg"},
        {"right/0.jpg", "left/1.jpg"},
        {"left/0.jpg", "left/2.jpg"},
        {"right/0.jpg", "right/4.jpg"},
    ):
        assert frozenset(wanted) in named
    assert frozenset({"left/0.jpg", "right/2.jpg"}) not in named
    assert frozenset({"left/0.jpg", "left/3.jpg"}) not in named


def test_a_file_names_the_pairs_in_their_order(tmp_path):
    path = tmp_path / "pairs.txt"
    path.write_text("2.jpg 0.jpg\n0.jpg 1.jpg\n0.jpg 2.jpg\n")
    how, pairs = select_pairs(images(3), path, 10)
    assert pairs == [(2, 0), (0, 1)]
    assert "pairs.txt" in how


def test_an_unknown_image_in_the_file_is_named(tmp_path):
    path = tmp_path / "pairs.txt"
    path.write_text("2.jpg elsewhere/9.jpg\n")
    with pytest.raises(ValueError, match=r"elsewhere/9\.jpg"):
        select_pairs(images(3), path, 10)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="none.txt"):
        select_pairs(images(3), tmp_path / "none.txt", 10)
