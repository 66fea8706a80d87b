# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360 import Pose
from epi360.features.binary_features import BinaryFeatures
from epi360.odometry.loop_closure import LoopClosure
from epi360.odometry.map_parts import Connection, PartOfMap
from epi360.odometry.pose_graph import PoseGraphEdge, diagonal_information
from epi360.odometry.relocalization import MappedView
from epi360.odometry.similarity import Similarity
from epi360.poses import rotation_from_vector

# Two maps of one place: their worlds, in metres, in the unit of each.
OWN_FROM_METRES = Similarity(2.0, rotation_from_vector([0.0, 0.3, 0.0]), np.array([1.0, 0.0, 4.0]))
OTHER_FROM_METRES = Similarity(0.5, rotation_from_vector([0.1, 0.0, 0.2]), np.array([0.0, 3, 0]))
POINTS = np.array([[2.0, 0.0, 1.0], [-2.0, 0.5, 0.0], [0.0, 1.0, -2.0]])


def view(number, place, map_from_metres):
    """Key frame of a camera at a place, as a map has it that is in units of its own."""
    camera = Similarity(1.0, rotation_from_vector([0.0, 0.1 * number, 0.0]), np.zeros(3))
    at_place = Similarity(1.0, np.eye(3), -np.array(place))
    pose = (camera @ at_place @ map_from_metres.inverse()).pose()
    points = map_from_metres.apply(POINTS)
    return MappedView(number, pose, BinaryFeatures(np.zeros((0, 3)), np.zeros((0, 32))), points)


def connection(old_place, new_place, off=(0.0, 0.0, 0.0), grown=1.0):
    """What is found of two key frames, off by so many metres, and by a factor of the scale."""
    old, new = view(0, old_place, OTHER_FROM_METRES), view(1, new_place, OWN_FROM_METRES)
    metres_from_new = (Similarity.from_pose(new.cam_from_world) @ OWN_FROM_METRES).inverse()
    metres_from_old = (Similarity.from_pose(old.cam_from_world) @ OTHER_FROM_METRES).inverse()
    moved = Similarity(grown, np.eye(3), np.array(off))
    new_from_old = metres_from_new.inverse() @ moved @ metres_from_old
    information = diagonal_information(0.01, 0.01, 0.02)
    loop = LoopClosure(0, 1, new_from_old, information, 50, 20, "ok")
    return Connection.of(loop, new, old, 0.012, is_sure=True)


def test_a_connection_takes_one_world_to_the_other():
    found = connection((0.0, 0.0, 0.0), (0.2, 0.0, 0.1)).other_from_own
    expected = OTHER_FROM_METRES @ OWN_FROM_METRES.inverse()
    assert found.scale == pytest.approx(expected.scale)
    np.testing.assert_allclose(found.apply(POINTS), expected.apply(POINTS), atol=1e-12)


@pytest.mark.parametrize(
    ("off", "grown", "agrees"),
    [
        ((0.0, 0.0, 0.0), 1.0, True),
        ((0.03, 0.0, 0.0), 1.02, True),  # noise of points that are two metres away
        ((0.5, 0.0, 0.0), 1.0, False),  # another place that looks alike
        ((0.0, 0.0, 0.0), 1.08, False),
    ],
)
def test_two_connections_of_the_same_maps_must_agree(off, grown, agrees):
    first = connection((0.0, 0.0, 0.0), (0.2, 0.0, 0.1))
    second = connection((0.6, 0.0, 0.0), (0.7, 0.0, 0.2), off, grown)
    assert second.agrees_with(first) == agrees


def test_the_scale_of_two_connections_is_their_mean():
    place = (0.0, 0.0, 0.0), (0.2, 0.0, 0.1)
    first, second = connection(*place), connection(*place, grown=1.04)
    mean = second.with_scale_of_both(first)
    scales = [each.other_from_own.scale for each in (first, mean, second)]
    assert scales[1] == pytest.approx(np.sqrt(scales[0] * scales[2]))
    assert mean.loop.new_from_old.pose().matrix() == pytest.approx(
        second.loop.new_from_old.pose().matrix()
    )


def test_loops_of_a_part_have_the_numbers_and_units_of_the_whole():
    part = PartOfMap({0: 4, 1: 9}, 2.0)
    edge = PoseGraphEdge(
        0,
        1,
        Similarity.from_pose(Pose(np.eye(3), np.zeros(3))),
        diagonal_information(0.1, 0.2, 0.3),
    )
    i, j, information = part.ends_of(edge)
    assert (i, j) == (4, 9)
    np.testing.assert_allclose(information, diagonal_information(0.1, 0.4, 0.3))
    assert part.renumbered({1: "picture"}) == {9: "picture"}
