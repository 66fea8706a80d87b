# SPDX-License-Identifier: BSD-3-Clause
"""Images before and after missing frames are joined, except where the place repeats itself."""

import numpy as np
import pytest
from equal_doors import CAMERA, panoramas, write_panoramas

from epi360.features.warped_patches import Panorama
from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.jobs.mapping import past_gap
from epi360.jobs.mapping.past_gap import cut_where_the_place_repeats
from epi360.jobs.matching.match_folder import match_images
from epi360.jobs.matching.match_result import load_matches_and_colors
from epi360.jobs.matching.pair_verdicts import PairVerdict
from epi360.poses import Pose

NAMES = ["frame2.png", "frame9.png", "frame10.png", "frame11.png"]
ALONG = Pose(np.eye(3), np.array([0.0, 0.0, 1.0]))


def graph_of(*pairs):
    """Graph in which each pair has as many inliers as its third number says."""
    keypoints = np.tile([100.0, 50.0], (40, 1))
    images = {name: MatchedImage(name, "pano", keypoints) for name in NAMES}
    matched = []
    for first, second, count in pairs:
        inliers = np.tile(np.arange(count)[:, None], 2)
        geometry = TwoViewGeometry("ok", ALONG, inliers)
        matched.append(MatchedPair(NAMES[first], NAMES[second], inliers, geometry))
    return MatchGraph({"pano": CAMERA}, images, tuple(matched))


def verdicts_of(graph, refused=()):
    return [
        PairVerdict(
            status="ok", image1=pair.image1, image2=pair.image2, cam2_from_cam1=ALONG,
            refused="another place" if number in refused else "",
        )
        for number, pair in enumerate(graph.pairs)
    ]  # fmt: skip


def names_of(graph):
    return [(pair.image1, pair.image2) for pair in graph.pairs]


@pytest.fixture
def asked(monkeypatch):
    """Inliers of the pairs that are asked; those with an even number show a corridor."""
    counts = []

    def is_even(pair, panoramas):
        counts.append(len(pair.keypoints[0]))
        return len(pair.keypoints[0]) % 2 == 0

    monkeypatch.setattr(past_gap, "_repeats", is_even)
    return counts


def cut(graph, gaps=("frame10.png",), **kwargs):
    return cut_where_the_place_repeats(graph, verdicts_of(graph, **kwargs), gaps, lambda name: None)


def test_only_pairs_across_the_gap_are_left_out(asked):
    graph = graph_of((0, 1, 30), (0, 2, 20), (1, 2, 22), (1, 3, 21), (2, 3, 40))
    left = cut(graph)
    assert sorted(asked) == [20, 21, 22]
    assert names_of(left) == [(NAMES[0], NAMES[1]), (NAMES[2], NAMES[3])]


def test_where_few_pairs_show_a_corridor_all_stay(asked):
    assert cut(graph_of((0, 1, 30), (0, 2, 21), (1, 2, 23), (1, 3, 22))) is None


def test_pairs_that_are_not_accepted_have_no_say(asked):
    graph = graph_of((0, 1, 30), (0, 2, 20), (1, 2, 21), (2, 3, 40))
    assert cut(graph, refused=[1]) is None and asked == [21]
    assert cut(graph, refused=[1, 2]) is None
    assert names_of(cut(graph, refused=[2])) == [(NAMES[0], NAMES[1]), (NAMES[2], NAMES[3])]


def test_each_two_parts_are_asked_by_themselves(asked):
    graph = graph_of((0, 1, 31), (0, 2, 20), (1, 2, 22), (1, 3, 33), (0, 3, 35), (2, 3, 40))
    left = cut(graph, gaps=["frame11.png", "frame9.png"])  # parts 0, 1, 1 and 2
    assert sorted(asked) == [20, 31, 33, 35, 40]
    assert names_of(left) == [(NAMES[1], NAMES[2]), (NAMES[0], NAMES[3])]


def test_the_strongest_pairs_are_asked(asked, monkeypatch):
    monkeypatch.setattr(past_gap, "_MOST_ASKED", 2)
    assert cut(graph_of((0, 2, 7), (0, 3, 9), (1, 2, 20), (1, 3, 22))) is not None
    assert sorted(asked) == [20, 22]


def test_images_that_are_no_panoramas_show_no_corridor():
    assert cut(graph_of((0, 2, 20), (1, 2, 22))) is None


def test_a_rendered_corridor_is_cut(tmp_path):
    images = write_panoramas(tmp_path)
    run = match_images(images, tmp_path / "matched")
    graph, _ = load_matches_and_colors(tmp_path / "matched")
    assert any(each.accepted for each in run.verdicts)
    panorama_of = {name: Panorama.of(picture) for name, (_, picture) in panoramas().items()}.get
    left = cut_where_the_place_repeats(graph, run.verdicts, ["b.png"], panorama_of)
    assert names_of(left) == [("b.png", "c.png")]
