"""Which pairs go into a map: ambiguous ones join no groups of images."""

from types import SimpleNamespace

import numpy as np
import pytest

from epi360.cameras import Equirectangular
from epi360.interop.match_graph import MatchedImage, MatchedPair, MatchGraph, TwoViewGeometry
from epi360.jobs.mapping.map_pairs import without_doubtful
from epi360.poses import Pose

POSE = Pose(np.eye(3), np.array([1.0, 0.0, 0.0]))


def graph_of(statuses):
    """A graph of images by name, with pairs of the given statuses and no matches."""
    names = sorted({name for pair in statuses for name in pair})
    images = {name: MatchedImage(name, "panorama", np.zeros((0, 2))) for name in names}
    nothing = np.zeros((0, 2), np.int64)
    pairs = tuple(
        MatchedPair(first, second, nothing, TwoViewGeometry(status, POSE, nothing))
        for (first, second), status in statuses.items()
    )
    return MatchGraph({"panorama": Equirectangular(8, 4)}, images, pairs)


def kept(statuses):
    found = without_doubtful(graph_of(statuses), SimpleNamespace(verdicts=()))
    return {(pair.image1, pair.image2) for pair in found.pairs}


ROOMS = {("a1", "a2"): "ok", ("b1", "b2"): "ok"}


def test_a_carpet_joins_no_two_rooms():
    assert kept({**ROOMS, ("a1", "b1"): "planar_ambiguous"}) == set(ROOMS)


def test_a_carpet_joins_no_two_rooms_through_an_image_without_other_pairs():
    carpets = {("a1", "x"): "planar_ambiguous", ("b1", "x"): "planar_ambiguous"}
    assert kept({**ROOMS, **carpets}) == set(ROOMS)


@pytest.mark.parametrize("status", ["ok", "pure_rotation"])
def test_a_pair_that_is_sure_joins_two_rooms(status):
    statuses = {**ROOMS, ("a1", "b1"): status, ("a2", "b2"): "planar_ambiguous"}
    assert kept(statuses) == set(statuses)


def test_ambiguous_pairs_stay_within_a_room_and_for_an_image_of_one_room():
    statuses = {
        **ROOMS,
        ("a2", "a3"): "ok",
        ("a1", "a3"): "planar_ambiguous",
        ("b1", "x"): "planar_ambiguous",
        ("b2", "x"): "planar_ambiguous",
    }
    assert kept(statuses) == set(statuses)
