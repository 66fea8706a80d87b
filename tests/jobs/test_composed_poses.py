# SPDX-License-Identifier: BSD-3-Clause
"""Poses of all images from those of accepted pairs, and a map that begins with them."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from colmap_graphs import panoramas_of_points
from test_mapping import aligned_errors

from epi360.jobs.graph.graph_check import groups_by
from epi360.jobs.mapping.composed_poses import composed_poses, hold_together
from epi360.jobs.matching.match_folder import PairVerdict
from epi360.poses import Pose, rotation_from_vector


def nobody(name):
    """There are no pictures: points alone say how long translations are."""


def verdicts_of(graph):
    return [
        PairVerdict(
            image1=pair.image1,
            image2=pair.image2,
            status="ok",
            cam2_from_cam1=pair.geometry.cam2_from_cam1,
            noise_deg=0.05,
            rotation_sigma_deg=0.1,
            translation_sigma_deg=0.3,
        )
        for pair in graph.pairs
    ]


def errors(composed, truth):
    """Largest error of a place, as a share of the way past all, and of a rotation in degrees."""
    placed = {name: pose.inverse() for name, pose in composed.cam_from_world.items()}
    return aligned_errors(placed, {name: truth[name].inverse() for name in placed})


def test_all_images_of_pairs_are_placed():
    truth, graph = panoramas_of_points(6)
    found = composed_poses(graph, verdicts_of(graph), nobody)
    assert set(found.cam_from_world) == set(truth)
    assert len(found.lengths) == 15
    place, rotation = errors(found, truth)
    assert place < 0.01 and rotation < 0.1


def test_a_tree_of_pairs_is_enough():
    truth, graph = panoramas_of_points(6)
    first = graph.pairs[0].image1
    star = replace(graph, pairs=tuple(p for p in graph.pairs if first in (p.image1, p.image2)))
    found = composed_poses(star, verdicts_of(star), nobody)
    assert set(found.cam_from_world) == set(truth)
    assert errors(found, truth)[0] < 0.02


@pytest.mark.parametrize("sigma_deg", [0.1, 0.0])
def test_one_wrong_pair_among_many_moves_nothing_far(sigma_deg):
    """However sure it is of itself."""
    truth, graph = panoramas_of_points(6)
    pair, *others = graph.pairs
    pose = pair.geometry.cam2_from_cam1
    wrong = Pose(rotation_from_vector([0.0, 0.7, 0.0]) @ pose.rotation, -pose.translation)
    geometry = replace(pair.geometry, cam2_from_cam1=wrong)
    bent = replace(graph, pairs=(replace(pair, geometry=geometry), *others))
    first, *others = verdicts_of(bent)
    first = replace(first, rotation_sigma_deg=sigma_deg, translation_sigma_deg=sigma_deg)
    found = composed_poses(bent, [first, *others], nobody)
    place, rotation = errors(found, truth)
    assert place < 0.02 and rotation < 1.0


def test_pairs_that_are_not_accepted_are_left_out():
    _, graph = panoramas_of_points(6)
    verdicts = [replace(each, refused="shows another place") for each in verdicts_of(graph)]
    assert not composed_poses(graph, verdicts, nobody).cam_from_world
    assert not composed_poses(graph, verdicts_of(graph)[:1], nobody).cam_from_world


@pytest.mark.parametrize("count", [2, 3])
def test_two_images_are_no_map(count):
    _, graph = panoramas_of_points(count)
    found = composed_poses(graph, verdicts_of(graph), nobody)
    assert len(found.cam_from_world) == (0 if count == 2 else 3)


def test_of_many_pairs_those_are_kept_that_hold_the_images_together():
    pairs = [(ends, 200) for ends in combinations("abcdefgh", 2)]
    for most in (7, 14, 27, 28, 40):
        rows = hold_together(pairs, most)
        assert len(rows) == min(most, 28) and rows == sorted(rows)
        groups = groups_by(pairs[row][0] for row in rows)
        assert len(set(groups.values())) == 1 and len(groups) == 8


def test_the_pairs_with_most_inliers_hold_images_together():
    pairs = [(ends, 200 if "a" in ends else 20) for ends in combinations("abcde", 2)]
    star = [row for row, (ends, _) in enumerate(pairs) if "a" in ends]
    assert hold_together(pairs, 4) == star
    assert hold_together([*pairs[5:], *pairs[:5]], 4) == [(row + 5) % 10 for row in star]


def test_where_too_few_pairs_would_hold_the_images_together_none_are_kept():
    """The weakest ones lead from room to room: without them every room is alone."""
    pairs = [(ends, 200) for ends in combinations("abcde", 2)]
    assert hold_together(pairs, 3) == []


def test_a_folder_of_many_pairs_is_placed_by_some_of_them(monkeypatch):
    truth, graph = panoramas_of_points(8)
    monkeypatch.setattr("epi360.jobs.mapping.composed_poses.MOST_PAIRS", 14)
    found = composed_poses(graph, verdicts_of(graph), nobody)
    assert set(found.cam_from_world) == set(truth)
    assert 7 <= len(found.lengths) <= 14
    assert errors(found, truth)[0] < 0.02


def test_who_waits_for_lengths_is_told():
    _, graph = panoramas_of_points(4)
    told = []
    composed_poses(graph, verdicts_of(graph), nobody, progress=lambda *each: told.append(each))
    assert told == [("lengths", count, 6) for count in range(7)]


def test_a_rig_has_a_unit_of_its_own():
    _, graph = panoramas_of_points(4)
    rig = replace(graph, cam_from_rig={"theta": Pose(np.eye(3), np.zeros(3))})
    assert not composed_poses(rig, verdicts_of(rig), nobody).cam_from_world


def test_of_two_groups_the_larger_one_is_placed():
    truth, graph = panoramas_of_points(7)
    names = list(truth)
    inside = [{*names[:4]}, {*names[4:]}]
    pairs = tuple(p for p in graph.pairs if any({p.image1, p.image2} <= one for one in inside))
    apart = replace(graph, pairs=pairs)
    unsure = [
        replace(each, rotation_sigma_deg=np.nan, translation_sigma_deg=np.nan)
        for each in verdicts_of(apart)
    ]
    found = composed_poses(apart, unsure, nobody)
    assert set(found.cam_from_world) == inside[0]
    assert errors(found, truth)[0] < 0.02
