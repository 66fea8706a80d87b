# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from epi360 import Pose
from epi360.odometry.frame_result import FrameTracks, shared_rows
from epi360.odometry.key_frames import SparseMap
from epi360.odometry.similarity import Similarity
from epi360.poses import rotation_from_vector

HERE = Pose(np.eye(3), np.zeros(3))


def tracks_of(index, ids):
    ids = np.array(ids)
    bearings = np.tile([0.0, 0.0, 1.0], (len(ids), 1))
    return FrameTracks(index, ids, bearings, np.zeros((len(ids), 2)))


def map_with(*seen):
    sparse_map = SparseMap()
    for index, ids in enumerate(seen):
        sparse_map.add_key_frame(tracks_of(index, ids), HERE)
    return sparse_map


def place(sparse_map, ids):
    sparse_map.set_positions(np.array(ids), np.arange(3.0 * len(ids)).reshape(-1, 3))


def test_identities_may_come_in_any_order():
    sparse_map = map_with([9000, 9001])
    place(sparse_map, [9000, 9001])
    place(sparse_map, [3, 100_000])
    assert sparse_map.ids.tolist() == [3, 9000, 9001, 100_000]
    np.testing.assert_array_equal(sparse_map.positions_of(np.array([9001])), [[3.0, 4.0, 5.0]])
    assert np.isnan(sparse_map.positions_of(np.array([50]))).all()


def test_only_landmarks_with_a_place_are_observed():
    sparse_map = map_with([1, 2, 3], [2, 3, 4])
    place(sparse_map, [2, 4])
    places, ids, _ = sparse_map.observations([0, 1])
    assert (places.tolist(), ids.tolist()) == ([0, 1, 1], [2, 2, 4])
    assert sparse_map.is_free(np.array([1, 2])).tolist() == [True, False]


def test_joined_tracks_are_one_landmark_which_a_key_frame_sees_once():
    sparse_map = map_with([1, 2], [1, 7], [8, 9])
    place(sparse_map, [1, 2, 7])
    sparse_map.join(np.array([7]), np.array([1]))
    sparse_map.join(np.array([8]), np.array([7]))
    assert sparse_map.landmarks_of(np.array([1, 7, 8])).tolist() == [1, 1, 1]
    places, ids, _ = sparse_map.observations([0, 1, 2])
    assert list(zip(places.tolist(), ids.tolist(), strict=True)) == [(0, 1), (0, 2), (1, 1), (2, 1)]
    assert len(sparse_map.ids) == 2


def test_landmark_that_two_tracks_show_is_shared_once():
    rows1, rows2 = shared_rows(np.array([5, 3, 5, 9]), np.array([9, 5, 1]))
    assert list(zip(rows1.tolist(), rows2.tolist(), strict=True)) == [(0, 1), (3, 0)]


def test_landmark_that_three_frames_disagree_with_is_gone_for_good():
    sparse_map = map_with([1, 2])
    place(sparse_map, [1, 2])
    for _ in range(3):
        sparse_map.count_agreement(np.array([1, 2]), np.array([True, False]))
    assert sparse_map.ids.tolist() == [1]
    assert not sparse_map.is_free(np.array([2]))[0]
    assert 2 not in sparse_map.add_key_frame(tracks_of(1, [1, 2]), HERE).ids


def test_landmark_that_agrees_as_often_as_not_stays():
    sparse_map = map_with([1])
    place(sparse_map, [1])
    for agrees in (False, True) * 10:
        sparse_map.count_agreement(np.array([1]), np.array([agrees]))
    assert sparse_map.ids.tolist() == [1]


def new_identities(first):
    return lambda count: np.arange(first, first + count)


def test_a_map_that_is_taken_in_keeps_its_landmarks_apart():
    """Both maps have a track 2, which is not the same point."""
    own, other = map_with([1, 2]), SparseMap()
    other.add_key_frame(tracks_of(5, [2, 3]), HERE)
    place(own, [1, 2])
    other.set_positions(np.array([2, 3]), np.full((2, 3), [[7.0, 8.0, 9.0]]))
    renaming = own.take_in(other, np.array([2]), new_identities(100))
    assert renaming.of(np.array([1, 2, 3])).tolist() == [1, 100, 3]
    assert own.ids.tolist() == [1, 2, 3, 100]
    np.testing.assert_array_equal(own.positions_of(np.array([2, 100])), [[3, 4, 5], [7, 8, 9]])
    places, ids, _ = own.observations([0, 1])
    assert list(zip(places.tolist(), ids.tolist(), strict=True)) == [
        (0, 1),
        (0, 2),
        (1, 100),
        (1, 3),
    ]


def test_joined_and_removed_landmarks_stay_so_in_the_map_that_takes_them_in():
    own, other = map_with([1, 2, 8]), SparseMap()
    other.add_key_frame(tracks_of(5, [2, 4, 6]), HERE)
    other.join(np.array([4]), np.array([2]))
    other.remove(np.array([6]))
    place(own, [1])
    own.take_in(other, np.array([2]), new_identities(100))
    assert own.landmarks_of(np.array([4, 2])).tolist() == [100, 2]
    assert own.is_free(np.array([6, 8])).tolist() == [False, True]


def test_key_frames_of_both_maps_are_in_the_order_of_their_frames():
    own, other = SparseMap(), SparseMap()
    for index in (0, 3, 9):
        own.add_key_frame(tracks_of(index, [index]), HERE)
    for index in (5, 7):
        other.add_key_frame(tracks_of(index, [index]), HERE)
    own.take_in(other, np.array([2]), new_identities(100))
    assert [(each.index, each.chain) for each in own.key_frames] == [
        (0, 0),
        (3, 0),
        (5, 5),
        (7, 5),
        (9, 0),
    ]
    own.add_key_frame(tracks_of(10, [10]), HERE)
    assert own.key_frames[-1].chain == 0


def test_another_world_of_other_units_moves_key_frames_and_landmarks():
    sparse_map = map_with([1])
    place(sparse_map, [1])
    turn = rotation_from_vector([0.1, 0.2, 0.3])
    sparse_map.key_frames[0].translation = np.array([1.0, 0.0, 0.0])
    (bearing,) = sparse_map.positions_of(np.array([1])) + [[1.0, 0.0, 0.0]]
    sparse_map.move_world(Similarity(3.0, turn, np.array([5.0, 6.0, 7.0])))
    key_frame = sparse_map.key_frames[0]
    np.testing.assert_allclose(key_frame.center, 3.0 * turn @ [-1.0, 0.0, 0.0] + [5, 6, 7])
    (point,) = sparse_map.positions_of(np.array([1]))
    seen = key_frame.rotation @ point + key_frame.translation
    np.testing.assert_allclose(seen, 3.0 * bearing)
    assert key_frame.growth == pytest.approx(3.0)
